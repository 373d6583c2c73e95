"""Any accelerations that keep the grasps, with forces that move the object so, come back from their torques."""

import numpy as np
import pytest

from holdfast import forward_dynamics, inverse_dynamics
from holdfast.dynamics.closed.chain_motion import pseudo_gravity
from holdfast.dynamics.closed.stacked import Stacked
from tests.dynamics.problems import motion_of
from tests.systems.problems import random_problem, relative_gap

OPTIONS = {
    "rigid": {"grasps": "rigid", "joints": (7, 6, 8)},
    "mixed": {"grasps": ("rigid", "hinge", "softfinger", "ball"), "joints": (6, 7, 7, 8)},
    "balls": {"grasps": "ball", "joints": (4, 5, 6)},
}


@pytest.mark.parametrize("kind", OPTIONS)
@pytest.mark.parametrize("seed", range(5))
def test_identity(kind, seed):
    """forward(inverse(qdd, f)) = (qdd, f) for random consistent accelerations and transmissible forces."""
    p = random_problem(seed, moving_base=True, **OPTIONS[kind])
    s, rng = Stacked(motion_of(p)), np.random.default_rng(seed)
    n = p.chain.joint_count

    # K (J qdd + Jdot qd - A alpha - a + g) = 0
    rows, gap = s.K @ np.hstack([s.J, -s.A]), s.K @ (s.a - s.g - s.Jdot_qd)
    x = 10 * rng.normal(size=n + 6)
    x = x + np.linalg.lstsq(rows, gap - rows @ x, rcond=None)[0]
    qdd, alpha = x[:n], x[n:]

    # A^T f = M(C) alpha + b, f = K^T lambda
    to_C = s.A.T @ s.K.T
    lam = 10 * rng.normal(size=len(s.K))
    lam = lam + np.linalg.lstsq(to_C, s.M_C @ alpha + s.b - to_C @ lam, rcond=None)[0]
    f = (s.K.T @ lam).reshape(-1, 6)

    tau = inverse_dynamics(p.chain, p.state, qdd, f, p.inputs)
    result = forward_dynamics(p.chain, p.state, tau, inputs=p.inputs)
    assert relative_gap(result.qdd, qdd) < 1e-10
    assert relative_gap(result.grasp_wrench, f) < 1e-10
    assert relative_gap(result.object_acceleration, alpha + pseudo_gravity(p.chain)) < 1e-10


@pytest.mark.parametrize("seed", range(5))
def test_gauss(seed):
    """Gauss: constrained and free accelerations differ by least constraint, in the kinetic metric."""
    p = random_problem(seed, moving_base=True, **OPTIONS["mixed"])
    s = Stacked(motion_of(p))
    result = p.solved()
    forced = s.M @ (result.qdd - s.mass_solve(s.T_free))
    pushed = s.M_C @ (result.object_acceleration - pseudo_gravity(p.chain)) + s.b
    rows = s.K @ np.hstack([s.J, -s.A])
    _, sizes, Vt = np.linalg.svd(rows)
    allowed = Vt[int((sizes > 1e-10 * sizes[0]).sum()) :]
    constraint = np.r_[forced, pushed]
    assert np.abs(allowed @ constraint).max() < 1e-10 * np.abs(constraint).max()
