"""What velocities and gravity ask for at qdd = 0, against exact derivatives of motion and energy."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import arm_motion
from holdfast.dynamics.arm.posture import posture
from holdfast.dynamics.arm.velocity import link_twists, tip_twist
from holdfast.spatial.spatial_vector import rotate
from tests.dynamics.arm.moving import displaced, moving
from tests.dynamics.problems import random_arm, relative_gap
from tests.spatial.dual import slopes_of, values_of

G = np.array([1.0, -2.0, -9.0])
seeds = pytest.mark.parametrize("seed", range(8))


@seeds
def test_tip_acceleration(seed):
    """V(0)' at qdd = 0 is Jdot qd, base acceleration and Coriolis terms in: exact derivative."""
    given = random_arm(seed)
    later = moving(given, np.zeros(len(given.q)), G)
    at = posture(later.arm, later.q)
    V0 = tip_twist(later.arm, at, link_twists(later.arm, at, later.qd, later.base_twist))
    bias = arm_motion(given).bias.tip_acceleration
    np.testing.assert_allclose(bias + np.r_[np.zeros(3), G], slopes_of(V0), atol=1e-11)


@seeds
def test_acceleration_is_linear_in_qdd(seed):
    """alpha(0) = J qdd + Jdot qd (2.1d)."""
    given = random_arm(seed)
    qdd = np.random.default_rng(seed).normal(size=len(given.q))
    later = moving(given, qdd, G)
    at = posture(later.arm, later.q)
    V0 = tip_twist(later.arm, at, link_twists(later.arm, at, later.qd, later.base_twist))
    motion = arm_motion(given)
    alpha = jacobian(given.arm, motion.at) @ qdd + motion.bias.tip_acceleration
    np.testing.assert_allclose(alpha + np.r_[np.zeros(3), G], slopes_of(V0), atol=1e-11)


@seeds
def test_lagrange(seed):
    """C = Mdot qd - 1/2 d(qd M qd)/dq + dU/dq - J_k^T w on a fixed base: Lagrange's equations."""
    given = random_arm(seed, moving_base=False)
    arm, qd = given.arm, given.qd
    C, _ = bias_torque(arm, posture(arm, given.q), arm_motion(given).bias.wrenches)
    expected = slopes_of(mass_matrix(arm, posture(arm, displaced(given, qd).q))[0]) @ qd
    for k, direction in enumerate(np.eye(len(qd))):
        at = posture(arm, displaced(given, direction).q)
        expected[k] -= 0.5 * qd @ slopes_of(mass_matrix(arm, at)[0]) @ qd
        for link, R, reach in zip(arm.links, at.R, at.reach, strict=True):
            expected[k] -= link.mass * G @ slopes_of(at.tip.p - reach + R @ link.com)
        # external wrenches: virtual work on the links' motion for a unit rate of joint k
        twists = link_twists(arm, posture(arm, given.q), direction, np.zeros(6))
        for w, R, V in zip(given.link_wrenches, at.R, twists, strict=True):
            expected[k] -= w @ rotate(values_of(R), V)
    assert relative_gap(C, expected) < 1e-12


@seeds
def test_gravity_is_an_accelerating_base(seed):
    """Gravity g and a base accelerated by -g ask for the same torques (the equivalence principle)."""
    given = random_arm(seed, moving_base=False)
    at_rest = replace(given, qd=0 * given.qd, link_wrenches=None)
    falling = replace(at_rest, base_acceleration=np.zeros(6))  # the base falls with g
    weightless = bias_torque(given.arm, posture(given.arm, given.q), arm_motion(falling).bias.wrenches)[0]
    np.testing.assert_allclose(weightless, 0, atol=1e-12)
    assert np.abs(arm_motion(at_rest).bias.tip_acceleration[3:] + G).max() < 1e-13


@seeds
def test_base_wrench_carries_all(seed):
    """At qdd = 0 the first link is given the rate of momentum: sum of all links' wrenches about its origin."""
    given = random_arm(seed)
    motion = arm_motion(given)
    at, arm = motion.at, given.arm
    _, first = bias_torque(arm, at, motion.bias.wrenches)
    total = np.zeros(6)
    for R, reach, p in zip(at.R, at.reach, motion.bias.wrenches, strict=True):
        lever = at.reach[0] - reach
        w = rotate(R, p)
        total += np.r_[w[:3] + np.cross(lever, w[3:]), w[3:]]
    assert relative_gap(rotate(at.R[0], first), total) < 1e-13


def test_no_motion_no_bias():
    """At rest, without gravity and wrenches, nothing is asked for."""
    given = random_arm(1)
    still = replace(given, qd=0 * given.qd, base_twist=np.zeros(6), base_acceleration=np.zeros(6), link_wrenches=None)
    bias = arm_motion(still).bias
    np.testing.assert_array_equal(bias.tip_acceleration, np.zeros(6))
    np.testing.assert_array_equal(np.concatenate(bias.wrenches), 0)
