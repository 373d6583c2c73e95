"""A published stiff problem: bodies of grams that turn at a thousand radians a second."""

import numpy as np
import pytest

import holdfast as hf
from tests.systems.andrews import END, END_TIME, andrews, angles, drive


def test_accelerations_at_the_start():
    """The published ones of the crank and of the rod, which turns at the sum of both."""
    chain, state = andrews()
    found = hf.forward_dynamics(chain, state, drive(0.0, state, None)[0])
    assert found.qdd[0] == pytest.approx(14222.4439199541138704911625887, rel=1e-13)
    assert found.object_acceleration[2] == pytest.approx(14222.44391995411387 - 10666.83293996558540, rel=1e-13)
    assert np.abs(found.qdd[1:]).max() < 1e-9


def test_end_of_the_motion():
    """Angles within 5e-9 of the largest after two and a half turns of the crank."""
    chain, state = andrews()
    run = hf.simulate(chain, state, drive, END_TIME, 1e-3, scheme="dop853", rtol=1e-10)
    error = np.abs(angles(run.state(-1)) - np.array(END)[[0, 2, 3, 4, 5, 6]]).max() / np.abs(END).max()
    assert run.stopped is None and not run.occurrences
    assert error < 5e-9
    print(f"largest error {error:.1e} of the largest angle")
