"""A body that rocks between two of its points on a table: each strike leaves a known part of its rate, without end."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.world import HalfSpace, Touching

HALF, TILT = 0.1, 0.01  # m, rad


@pytest.mark.slow
def test_a_body_rocks_until_it_rests():
    """About the point that strikes, angular momentum stays: the rate falls to (J - m a^2) / (J + m a^2) of itself.

    With J = 2 m a^2 that is a third, the energy lost falls to a ninth, and there are infinitely many strikes in 0.1 s.
    """
    points = {"left": [-HALF, 0.0, 0.0], "right": [HALF, 0.0, 0.0]}
    body = hf.HeldObject(1.0, 2.0 * HALF**2 * np.eye(3))
    touching = Touching(points, {"table": HalfSpace(friction=0.5)})
    chain = hf.ClosedChain({}, body, {}, touching=touching)
    pose = [np.cos(0.5 * TILT), 0.0, -np.sin(0.5 * TILT), 0.0, 0.0, 0.0, HALF * np.sin(TILT)]
    run = hf.simulate(
        chain, hf.State([], [], pose, np.zeros(6)), lambda t, state, memory: (np.zeros(0), memory), 0.1, 0.01
    )
    assert run.stopped is None
    assert run.touch_gap.min() >= -1e-12
    lost = np.array([one.energy_change for one in run.occurrences if one.kind == "touch" and one.energy_change])
    assert len(lost) >= 4
    np.testing.assert_allclose(lost[1:-1] / lost[:-2], 1.0 / 9.0, rtol=1e-3)  # the last one comes to rest
    assert [one.kind for one in run.occurrences if "rocks" in one.text] == ["rest"]
    assert np.abs(run.object_twist[-1]).max() < 1e-12
    np.testing.assert_allclose(run.touch_force[-1, :, 2], 0.5 * -chain.gravity[2], rtol=1e-9)
    assert np.diff(run.impact).max() <= 1e-12
