"""A slider with a clearance in its guide: three impacts of two corners at once, or of single ones."""

import numpy as np
import pytest

import holdfast as hf
from tests.longer import mostly_slow
from tests.systems.clearance_slider import slider_chain, true_impacts


@pytest.mark.slow
@pytest.mark.parametrize("spin", mostly_slow([0.0, 5.0, -20.0], [5.0]))
def test_three_impacts(spin):
    """Instants, corners, angles and rates after them are those of Lagrange's equations and Coulomb's law, to 1e-6."""
    *true, (fourth, *_) = true_impacts(4, spin)
    chain, state = slider_chain(spin)
    duration = (true[-1][0] + fourth) / 2.0
    run = hf.simulate(chain, state, lambda t, state, memory: (np.zeros(2), memory), duration, 1e-4, contacts="events")
    assert run.stopped is None
    assert run.touch_gap.min() >= -1e-12
    assert np.diff(run.impact).max() <= 1e-12
    touches = [one for one in run.occurrences if one.kind == "touch"]
    wanted = [(t, name) for t, names, *_ in true for name in names]
    assert [one.name.partition("/")[0] for one in touches] == [name for _, name in wanted]
    for one, (t, _) in zip(touches, wanted, strict=True):
        assert abs(one.t - t) < 1e-6 * t
    for t, _, angles, rates in true:
        after = np.flatnonzero(np.abs(run.t - t) < 1e-7)[-1]
        R = hf.Pose.from_wxyz_xyz(run.object_pose[after]).R
        found = [*run.q[after].cumsum(), np.arctan2(R[1, 0], R[0, 0])]
        np.testing.assert_allclose(found, angles, atol=1e-6)
        found = [*run.qd[after].cumsum(), run.object_twist[after, 2]]
        np.testing.assert_allclose(found, rates, atol=1e-6 * np.abs(rates).max())
