"""Internal forces do no work on the object's motion, and do not move it."""

import numpy as np
import pytest

from holdfast import forward_dynamics, inverse_dynamics
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.forces import split
from holdfast.spatial.spatial_vector import shift_twist
from tests.dynamics.problems import motion_of
from tests.laws.systems import mixed, sample


@pytest.mark.parametrize("make", [sample, mixed])
@pytest.mark.parametrize("seed", range(8))
def test_no_work_on_the_object(make, seed):
    """sum over the contacts of f_internal . V- = 0 for the object's own motion, and for any other."""
    p, result = make(seed)
    parts = split(p.chain, p.state, result.grasp_wrench)
    contacts = dict(zip(p.chain.grasps, motion_of(p).contacts, strict=True))
    for V in (p.state.object_twist, *np.random.default_rng(seed).normal(size=(3, 6))):
        powers = [parts.internal[p.chain.names.index(n)] @ shift_twist(c.offset, V) for n, c in contacts.items()]
        assert abs(sum(powers)) <= 1e-12 * max(np.abs(result.grasp_wrench).max() * np.abs(V).max(), 1.0)


@pytest.mark.parametrize("seed", range(6))
def test_squeezing_torques_do_not_move(seed):
    """Torques J^T u with A^T u = 0 and H u = 0 change the forces by u and no acceleration, and back."""
    p, result = mixed(seed)
    s = Stacked(motion_of(p))
    u = s.K.T @ np.linalg.svd(s.A.T @ s.K.T)[2][6:].T @ np.random.default_rng(seed).normal(size=len(s.K) - 6)
    squeezing = np.zeros((len(p.chain.names), 6))
    squeezing[[p.chain.names.index(name) for name in p.chain.grasps]] = u.reshape(-1, 6)
    tau = np.array(p.tau)
    ends = np.cumsum([p.chain.arms[name].joint_count for name in p.chain.grasps])[:-1]
    for name, torque in zip(p.chain.grasps, np.split(s.J.T @ u, ends), strict=True):
        tau[p.chain.joints[name]] += torque
    squeezed = forward_dynamics(p.chain, p.state, tau, inputs=p.inputs)
    assert np.abs(squeezed.qdd - result.qdd).max() < 1e-10 * np.abs(result.qdd).max()
    forces = result.grasp_wrench + squeezing
    assert np.abs(squeezed.grasp_wrench - forces).max() < 1e-10 * np.abs(forces).max()
    asked = inverse_dynamics(p.chain, p.state, result.qdd, forces, p.inputs)
    assert np.abs(asked - tau).max() < 1e-10 * np.abs(tau).max()
