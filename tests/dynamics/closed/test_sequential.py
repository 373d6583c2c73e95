"""Algorithm `sequential`: one arm by both routes; on scalars that know no branch; exact derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import State
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.free_dynamics import articulated, tip_acceleration
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closed.tip_response import tip_response
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from tests.dynamics.problems import motion_of, random_motion
from tests.spatial.dual import duals, slopes_of, values_of
from tests.systems.problems import random_problem, relative_gap, stored

KINDS = ("rigid", "hinge", "softfinger", "ball")
OPTIONS = {"grasps": KINDS, "joints": (6, 7, 6, 8), "moving_base": True}


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("route", ["recursive", "mass_matrix"])
def test_one_arm(seed, route):
    """(4.1), (6.10): J M^-1 J^T out; back qdd = M^-1 (T' - J^T f) and Newton and Euler's base wrench for it."""
    motion = random_motion(seed)
    J, M = jacobian(motion.arm, motion.at), mass_matrix(motion.arm, motion.at)[0]
    f = 10 * np.random.default_rng(seed).normal(size=6)
    response = tip_response(motion, route)
    qdd, base = response.back_substitute(f)
    assert relative_gap(response.mobility.dense(), J @ np.linalg.solve(M, J.T)) < 1e-11
    assert (
        relative_gap(response.free_acceleration, tip_acceleration(motion, response.back_substitute(0 * f)[0])) < 1e-10
    )
    assert relative_gap(qdd, articulated(motion, motion.torque, f)) < 1e-10
    assert relative_gap(base, newton_euler(motion, qdd, f)[1]) < 1e-10


@pytest.mark.parametrize("route", ["recursive", "mass_matrix"])
@pytest.mark.parametrize("seed", range(3))
def test_derivative_keeps_the_equations(seed, route):
    """Along any change of state the equations of motion stay fulfilled: their derivatives vanish."""
    p = random_problem(seed, **OPTIONS)
    rng = np.random.default_rng(seed)
    n, given = p.chain.joint_count, p.inputs.shaped(p.chain)
    quaternion = rng.normal(size=4)
    quaternion -= p.state.object_pose[:4] * (quaternion @ p.state.object_pose[:4])
    state = State(
        duals(p.state.q, rng.normal(size=n)),
        duals(p.state.qd, rng.normal(size=n)),
        duals(p.state.object_pose, np.r_[quaternion, rng.normal(size=3)]),
        duals(p.state.object_twist, rng.normal(size=6)),
    )
    motion = chain_motion(p.chain, state, duals(p.tau, rng.normal(size=n)), given)
    found = sequential(motion, route)
    size = max(np.abs(slopes_of(x)).max() for x in (*found.qdd, *found.wrenches, found.object_acceleration))
    assert size > 10
    total = motion.body.wrench
    for arm, c, qdd, f in zip(motion.holding, motion.contacts, found.qdd, found.wrenches, strict=True):
        torques, _ = newton_euler(arm, qdd, f)
        assert np.abs(slopes_of(torques - arm.torque)).max() < 1e-9 * size
        gap = shift_twist(c.offset, found.object_acceleration) + c.a - tip_acceleration(arm, qdd) - c.g
        assert np.abs(slopes_of(c.transmitted(gap))).max() < 1e-9 * size
        total = total + shift_wrench(c.offset, f)
    rest = motion.body.inertia.apply(found.object_acceleration) + motion.body.bias - total
    assert np.abs(slopes_of(rest)).max() < 1e-9 * size
    plain = sequential(motion_of(p), route)
    assert relative_gap(values_of(np.concatenate(found.qdd)), np.concatenate(plain.qdd)) < 1e-11


@pytest.mark.parametrize("name", ["planar_3arm_6_7_6_omega_singular", "stewart_6_RRP_ball"])
def test_torques_add_up(name):
    """Response to a change of torques by dual numbers is the difference, dropped pivots or not."""
    p = stored(name)
    given, rng = p.inputs.shaped(p.chain), np.random.default_rng(0)
    change = rng.normal(size=len(p.tau))
    response = sequential(chain_motion(p.chain, p.state, duals(p.tau, change), given))
    before, after = (sequential(motion_of(replace(p, tau=p.tau + s * change))) for s in (0, 1))
    for key in ("qdd", "wrenches"):
        a, b, c = (np.concatenate(getattr(x, key)) for x in (response, before, after))
        assert relative_gap(slopes_of(a), c - b) < 1e-9
