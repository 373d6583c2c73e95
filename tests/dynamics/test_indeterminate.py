"""Where forces are not unique: accelerations are, and the smallest forces are returned."""

import numpy as np
import pytest

from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.constraint import length_scale
from tests.dynamics.problems import motion_of
from tests.oracles.maximal_kkt import solve_min_norm
from tests.systems import planar_parallelogram, planar_three_arms
from tests.systems.as_chain import as_chain
from tests.systems.problems import relative_gap

CASES = {
    "two": planar_three_arms(0, joints=(6, 6)),
    "three": planar_three_arms(1),
    "tilted": planar_three_arms(2, tilted=True),
    "crank": planar_parallelogram(0.4),
}
cases = pytest.mark.parametrize("name", CASES)


@cases
def test_accelerations_are_unique(name):
    """Accelerations and the total wrench are the least-squares oracle's; the forces satisfy every equation."""
    p, truth = as_chain(CASES[name]), solve_min_norm(CASES[name])
    result = p.solved()
    s = Stacked(motion_of(p))
    assert relative_gap(result.qdd, np.concatenate(truth["qdd"])) < 1e-9
    assert relative_gap(result.object_acceleration, truth["alpha_C"]) < 1e-9
    f = result.grasp_wrench.ravel()
    assert relative_gap(s.A.T @ f, s.A.T @ np.concatenate(truth["f"])) < 1e-9
    assert relative_gap(s.J.T @ f, s.J.T @ np.concatenate(truth["f"])) < 1e-9
    assert relative_gap(s.M @ result.qdd + s.J.T @ f, s.T_free) < 1e-9


@cases
def test_smallest_forces(name):
    """sum |moment/L|^2 + |force|^2 is least: orthogonal to all that no joint and no object feels."""
    p = as_chain(CASES[name])
    motion = motion_of(p)
    f, s = p.solved().grasp_wrench.ravel(), Stacked(motion)
    w = np.tile(np.r_[np.full(3, length_scale([c.offset for c in motion.contacts]) ** -2), np.ones(3)], len(f) // 6)
    _, sizes, Vt = np.linalg.svd(np.hstack([s.J, s.A]).T)
    null = Vt[int((sizes > 1e-9 * sizes[0]).sum()) :]
    assert len(null) == {"two": 3, "three": 6, "tilted": 6, "crank": 3}[name]
    assert np.abs(null @ (w * f)).max() < 1e-10 * np.abs(w * f).max()
