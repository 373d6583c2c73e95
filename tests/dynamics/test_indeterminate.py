"""Where forces are not unique: accelerations are, and the smallest forces are returned."""

import numpy as np
import pytest

from holdfast import METHODS, MethodNotApplicable, forward_dynamics
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.indeterminate import free_wrenches
from holdfast.dynamics.split import length_scale
from tests.dynamics.problems import motion_of, relative_gap, stored
from tests.oracles.maximal_kkt import solve_min_norm
from tests.systems import planar_parallelogram, planar_three_arms
from tests.systems.as_chain import as_chain

CASES = {
    "two": planar_three_arms(0, joints=(6, 6)),
    "three": planar_three_arms(1),
    "tilted": planar_three_arms(2, tilted=True),
    "crank": planar_parallelogram(0.4),
}
cases = pytest.mark.parametrize("name", CASES)


def weights(motion) -> np.ndarray:
    """Return the metric's weights, 1/L^2 for moments and 1 for forces."""
    length = length_scale([c.offset for c in motion.contacts])
    return np.tile(np.r_[np.full(3, length**-2), np.ones(3)], len(motion.contacts))


@cases
def test_accelerations_are_unique(name):
    """Accelerations and the total wrench are the least-squares oracle's; the forces satisfy every equation."""
    p, truth = as_chain(CASES[name]), solve_min_norm(CASES[name])
    result = forward_dynamics(p.chain, p.state, p.tau)
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
    f = forward_dynamics(p.chain, p.state, p.tau).grasp_wrench.ravel()
    s, w = Stacked(motion), weights(motion)
    _, sizes, Vt = np.linalg.svd(np.hstack([s.J, s.A]).T)
    null = Vt[int((sizes > 1e-9 * sizes[0]).sum()) :]
    assert len(null) == {"two": 3, "three": 6, "tilted": 6, "crank": 3}[name]
    assert np.abs(null @ (w * f)).max() < 1e-10 * np.abs(w * f).max()


@cases
def test_basis_of_free_wrenches(name):
    """Felt by no joint and no object, orthonormal in the metric, as many as rows without a pivot."""
    p = as_chain(CASES[name])
    motion = motion_of(p)
    N = free_wrenches(motion, length_scale([c.offset for c in motion.contacts]))
    s = Stacked(motion)
    assert np.abs(s.J.T @ N).max() < 1e-12
    assert np.abs(s.A.T @ N).max() < 1e-12
    np.testing.assert_allclose(N.T @ (weights(motion)[:, None] * N), np.eye(N.shape[1]), atol=1e-12)
    assert N.shape[1] == {"two": 3, "three": 6, "tilted": 6, "crank": 3}[name]


@pytest.mark.parametrize("name", ["rigid_2arm_7R_gravity", "mixed_4arm_all_types", "stewart_6_RRP_ball"])
def test_unique_forces(name):
    """Where forces are unique there is no free wrench."""
    assert free_wrenches(motion_of(stored(name)), 1.0).shape[1] == 0


def test_only_one_method():
    """All other algorithms refuse, naming `sequential`."""
    p = as_chain(CASES["three"])
    for method in METHODS.keys() - {"sequential"}:
        with pytest.raises(MethodNotApplicable, match=rf"^{method}: .*nullity.*try method='sequential'"):
            forward_dynamics(p.chain, p.state, p.tau, method=method, generic_rank=12)
