"""Internal forces do no work on the object's motion, and do not move it."""

import numpy as np
import pytest

from holdfast import forward_dynamics, split
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.spatial_vector import shift_twist
from tests.dynamics.problems import motion_of
from tests.laws.systems import mixed, sample


@pytest.mark.parametrize("make", [sample, mixed])
@pytest.mark.parametrize("seed", range(15))
def test_no_work_on_the_object(make, seed):
    """sum over the contacts of f_internal . V- = 0 for the object's own motion, and for any other."""
    p, result = make(seed)
    parts = split(p.chain, p.state, result.grasp_wrench)
    motions = [p.state.object_twist, *np.random.default_rng(seed).normal(size=(3, 6))]
    for V in motions:
        powers = []
        for c, name in zip(motion_of(p).contacts, p.chain.grasps, strict=True):
            powers.append(parts.internal[p.chain.names.index(name)] @ shift_twist(c.offset, V))
        size = np.abs(result.grasp_wrench).max() * np.abs(V).max()
        assert abs(sum(powers)) <= 1e-12 * max(size, 1.0)


@pytest.mark.parametrize("seed", range(8))
def test_the_motion_part_does_all_the_work(seed):
    """The object's equation holds with the motion part alone: M alpha + b = A^T f_motion."""
    p, result = mixed(seed)
    s = Stacked(motion_of(p))
    parts = split(p.chain, p.state, result.grasp_wrench)
    rows = [p.chain.names.index(name) for name in p.chain.grasps]
    alpha = result.object_acceleration - np.r_[np.zeros(3), p.chain.gravity]
    net = s.A.T @ parts.motion[rows].ravel()
    assert np.abs(s.M_C @ alpha + s.b - net).max() < 1e-11 * np.abs(result.grasp_wrench).max()


@pytest.mark.parametrize("seed", range(6))
def test_squeezing_torques_do_not_move(seed):
    """Torques J^T u with A^T u = 0 and H u = 0 change the forces by u and no acceleration."""
    p, result = mixed(seed)
    s = Stacked(motion_of(p))
    to_C = s.A.T @ s.K.T
    u = s.K.T @ np.linalg.svd(to_C)[2][6:].T @ np.random.default_rng(seed).normal(size=len(s.K) - 6)
    tau = np.array(p.tau)
    rows = [p.chain.names.index(name) for name in p.chain.grasps]
    for name, torque in zip(p.chain.grasps, np.split(s.J.T @ u, _ends(p)), strict=True):
        tau[p.chain.joints[name]] += torque
    squeezed = forward_dynamics(p.chain, p.state, tau, inputs=p.inputs)
    size = np.abs(result.qdd).max()
    assert np.abs(squeezed.qdd - result.qdd).max() < 1e-10 * size
    change = (squeezed.grasp_wrench - result.grasp_wrench)[rows]
    assert np.abs(change.ravel() - u).max() < 1e-10 * np.abs(squeezed.grasp_wrench).max()


def _ends(p) -> np.ndarray:
    """Return where the holding arms' joints end in their own stack."""
    return np.cumsum([p.chain.arms[name].joint_count for name in p.chain.grasps])[:-1]
