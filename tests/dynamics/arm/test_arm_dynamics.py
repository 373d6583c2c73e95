"""One arm's equations of motion: energy, Lagrange, the oracle's numbers, and four algorithms that solve them."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast.dynamics.arm.articulated import articulated_filter, tip_mobility
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics, jacobian, link_twists, tip_twist
from holdfast.dynamics.arm.free_dynamics import (
    articulated,
    composite,
    newton_euler_columns,
    three_sweep,
    tip_acceleration,
)
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import arm_motion
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.spatial.spatial_vector import rotate
from tests.dynamics.arm.moving import displaced, moving
from tests.dynamics.problems import motion_of, random_arm, random_motion
from tests.oracles.arithmetic import arithmetic
from tests.oracles.body_equations import arm_equations
from tests.oracles.maximal_kkt import base_wrench
from tests.spatial.dual import duals, slopes_of, values_of
from tests.systems import random_system
from tests.systems.problems import CASES, relative_gap, stored

G = np.array([1.0, -2.0, -9.0])
SOLVERS = [composite, newton_euler_columns, articulated, three_sweep]
solvers = pytest.mark.parametrize("solver", SOLVERS)
seeds = pytest.mark.parametrize("seed", range(6))


@seeds
def test_tip_acceleration(seed):
    """alpha(0) = J qdd + Jdot qd (2.1d) is V(0)', base acceleration and Coriolis terms in: exact derivative."""
    given = random_arm(seed)
    qdd = np.random.default_rng(seed).normal(size=len(given.q))
    later = moving(given, qdd, G)
    at = forward_kinematics(later.arm, later.q)
    V0 = tip_twist(later.arm, at, link_twists(later.arm, at, later.qd, later.base_twist), later.base_twist)
    motion = arm_motion(given)
    alpha = jacobian(given.arm, motion.at) @ qdd + motion.bias.tip_acceleration
    np.testing.assert_allclose(alpha + np.r_[np.zeros(3), G], slopes_of(V0), atol=1e-11)
    np.testing.assert_allclose(tip_acceleration(motion, qdd), alpha, atol=1e-12)


@seeds
def test_lagrange(seed):
    """C = Mdot qd - 1/2 d(qd M qd)/dq + dU/dq - J_k^T w on a fixed base: Lagrange's equations."""
    given = random_arm(seed, moving_base=False)
    arm, qd = given.arm, given.qd
    C, _ = bias_torque(arm, forward_kinematics(arm, given.q), arm_motion(given).bias.wrenches)
    expected = slopes_of(mass_matrix(arm, forward_kinematics(arm, displaced(given, qd).q))[0]) @ qd
    for k, direction in enumerate(np.eye(len(qd))):
        at = forward_kinematics(arm, displaced(given, direction).q)
        expected[k] -= 0.5 * qd @ slopes_of(mass_matrix(arm, at)[0]) @ qd
        for link, R, reach in zip(arm.links, at.R, at.reach, strict=True):
            expected[k] -= link.mass * G @ slopes_of(at.tip.p - reach + R @ link.com)
        # external wrenches: virtual work on the links' motion for a unit rate of joint k
        twists = link_twists(arm, forward_kinematics(arm, given.q), direction, np.zeros(6))
        for w, R, V in zip(given.link_wrenches, at.R, twists, strict=True):
            expected[k] -= w @ rotate(values_of(R), V)
    assert relative_gap(C, expected) < 1e-12


@seeds
def test_gravity_is_an_accelerating_base(seed):
    """Gravity g and a base accelerated by -g ask for the same torques (the equivalence principle)."""
    given = random_arm(seed, moving_base=False)
    at_rest = replace(given, qd=0 * given.qd, link_wrenches=None)
    falling = replace(at_rest, base_acceleration=np.zeros(6))  # the base falls with g
    weightless = bias_torque(given.arm, forward_kinematics(given.arm, given.q), arm_motion(falling).bias.wrenches)[0]
    np.testing.assert_allclose(weightless, 0, atol=1e-12)
    assert np.abs(arm_motion(at_rest).bias.tip_acceleration[3:] + G).max() < 1e-13


@seeds
def test_newton_euler(seed):
    """T = M qdd + C + J^T f (2.1a), and the base supports all that changes the links' momentum: the oracle's."""
    case = random_system(seed, arms=1, moving_base=True, gravity=tuple(G))
    oracle = arm_equations(case["arms"][0], np.array(case["gravity"]), arithmetic(None))
    motion = random_motion(seed)
    arm, at, rng = motion.arm, motion.at, np.random.default_rng(seed)
    qdd, f = 5 * rng.normal(size=arm.joint_count), 10 * rng.normal(size=6)
    torques, base = newton_euler(motion, qdd, f)
    C, _ = bias_torque(arm, at, motion.bias.wrenches)
    assert relative_gap(torques, mass_matrix(arm, at)[0] @ qdd + C + jacobian(arm, at).T @ f) < 1e-13
    assert relative_gap(torques, oracle.M @ qdd + oracle.bias + oracle.J.T @ f) < 1e-12
    assert relative_gap(base, base_wrench(oracle, qdd, f)) < 1e-12
    for solver in SOLVERS:  # the torques of given accelerations bring these accelerations back
        assert relative_gap(solver(motion, torques, f), qdd) < 1e-12


@pytest.mark.parametrize("joints", [1, 30, 60])
def test_short_and_long_arms(joints):
    """One joint and sixty: the four still agree."""
    motion = random_motion(0, joints=joints, grasps="ball")
    answers = [solver(motion, motion.torque, np.ones(6)) for solver in SOLVERS]
    for answer in answers[1:]:
        assert relative_gap(answer, answers[0]) < 1e-11


@solvers
@pytest.mark.parametrize("seed", range(3))
def test_derivative(seed, solver):
    """Along any dq the torques stay what they are if qdd follows: exact, through every sweep."""
    given = random_arm(seed)
    dq = np.random.default_rng(seed).normal(size=len(given.q))
    motion = arm_motion(displaced(given, dq))
    f = np.arange(6.0)
    qdd = solver(motion, duals(arm_motion(given).torque, 0.0), f)
    torques, _ = newton_euler(motion, qdd, f)
    assert np.abs(slopes_of(qdd)).max() > 1
    assert np.abs(slopes_of(torques)).max() < 1e-9 * np.abs(slopes_of(qdd)).max()
    assert relative_gap(values_of(qdd), solver(arm_motion(given), arm_motion(given).torque, f)) < 1e-12


@pytest.mark.parametrize("name", CASES)
def test_stored_arms(name):
    """Every sweep against the numbers stored with the 42 cases, which another program computed."""
    p = stored(name)
    for motion, debug in zip(motion_of(p).arms.values(), CASES[name]["debug"], strict=True):
        arm, at = motion.arm, motion.at
        found = {
            "mass_matrix": mass_matrix(arm, at)[0],
            "jacobian": jacobian(arm, at),
            "bias_torque": bias_torque(arm, at, motion.bias.wrenches)[0],
            "tip_bias_acceleration": motion.bias.tip_acceleration + np.r_[np.zeros(3), p.chain.gravity],
            "free_qdd": three_sweep(motion, motion.torque, np.zeros(6)),
            "Lambda": tip_mobility(arm, at, articulated_filter(arm, at)).rotated(at.R[-1]).dense(),
            "tip_position": at.tip.p,
        }
        assert found.keys() == debug.keys()
        for quantity, expected in debug.items():
            assert relative_gap(found[quantity], expected) < 1e-10, quantity
