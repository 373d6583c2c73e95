"""Where the links are and how they move: the oracle's frames, exact derivatives, and the duality of H and H^T."""

import numpy as np
import pytest

from holdfast import Joint
from holdfast.dynamics.arm.forward_kinematics import (
    column,
    expand,
    forward_kinematics,
    jacobian,
    link_twists,
    project,
    tip_twist,
)
from holdfast.spatial import rotation
from holdfast.spatial.spatial_vector import rotate, shift_twist
from holdfast.spatial.symmetric import symmetric6
from holdfast.spatial.vector import skew
from tests.dynamics.arm.moving import displaced, moving
from tests.dynamics.problems import random_arm
from tests.oracles.arithmetic import arithmetic
from tests.oracles.arm_kinematics import link_frames
from tests.spatial.dual import slopes_of
from tests.systems import random_system
from tests.systems.problems import relative_gap
from tests.systems.random_parts import unit_vector

seeds = pytest.mark.parametrize("seed", range(6))


@seeds
def test_frames(seed):
    """(2.1b): rotation and origin of every link, revolute or prismatic, and of the tip."""
    case = random_system(seed, arms=1, moving_base=True, gravity=(1.0, -2.0, -9.0))
    given = random_arm(seed)
    at = forward_kinematics(given.arm, given.q)
    for R, reach, frame in zip(at.R, at.reach, link_frames(case["arms"][0], arithmetic(None)), strict=True):
        np.testing.assert_allclose(R, frame.R, atol=1e-14)
        np.testing.assert_allclose(at.tip.p - reach, frame.origin, atol=1e-13)
    np.testing.assert_allclose(at.tip.R, at.R[-1] @ given.arm.tip.R, atol=1e-15)


@seeds
def test_far_base_costs_no_digits(seed):
    """A base 1e9 m away leaves distances within the arm as they are, to the last bit."""
    given = random_arm(seed)
    near = forward_kinematics(given.arm, given.q)
    far = forward_kinematics(given.arm.at(type(given.arm.base)(given.arm.base.R, np.full(3, 1e9))), given.q)
    np.testing.assert_array_equal(np.array(near.reach), np.array(far.reach))


@pytest.mark.parametrize("turns", [-3, 16000])
def test_full_turns_do_nothing(turns):
    """A revolute joint is where it was after full turns; angles to 1e5 rad keep ten digits."""
    given = random_arm(2, grasps="ball")
    revolute = np.array([joint.kind == "revolute" for joint in given.arm.joints])
    turned = forward_kinematics(given.arm, given.q + 2 * np.pi * turns * revolute).tip
    tip = forward_kinematics(given.arm, given.q).tip
    assert relative_gap(turned.p, tip.p) < 1e-15 * (100 + 50 * abs(turns))
    assert np.linalg.norm(rotation.log(turned.R.T @ tip.R)) < 1e-15 * (100 + 50 * abs(turns))


@seeds
def test_twists_are_rates(seed):
    """R' = w~ R and O' = v for every link and the tip; V(0) = J qd + phi^T V(base) (2.1c); the base moves too."""
    given = random_arm(seed)
    at = forward_kinematics(given.arm, given.q)
    twists = link_twists(given.arm, at, given.qd, given.base_twist)
    later = moving(given, np.zeros(len(given.q)))
    there = forward_kinematics(later.arm, later.q)
    for R, moved_R, reach, V in zip(at.R, there.R, there.reach, twists, strict=True):
        w, v = rotate(R, V)[:3], rotate(R, V)[3:]
        np.testing.assert_allclose(slopes_of(moved_R), skew(w) @ R, atol=1e-12)
        np.testing.assert_allclose(slopes_of(there.tip.p - reach), v, atol=1e-12)
    V0 = tip_twist(given.arm, at, twists, given.base_twist)
    np.testing.assert_allclose(slopes_of(there.tip.p), V0[3:], atol=1e-12)
    np.testing.assert_allclose(slopes_of(there.tip.R), skew(V0[:3]) @ at.tip.R, atol=1e-12)
    carried = shift_twist(at.tip.p - given.arm.base.p, given.base_twist)
    np.testing.assert_allclose(V0, jacobian(given.arm, at) @ given.qd + carried, atol=1e-12)


@seeds
def test_jacobian(seed):
    """Column k is the tip's twist per unit qd_k: exact derivatives of position and rotation."""
    given = random_arm(seed)
    at = forward_kinematics(given.arm, given.q)
    J = jacobian(given.arm, at)
    assert J.shape == (6, len(given.q))
    for along, direction in zip(J.T, np.eye(len(given.q)), strict=True):
        there = forward_kinematics(given.arm, displaced(given, direction).q).tip
        np.testing.assert_allclose(slopes_of(there.p), along[3:], atol=1e-13)
        np.testing.assert_allclose(slopes_of(there.R), skew(along[:3]) @ at.tip.R, atol=1e-13)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("seed", range(4))
def test_duality(kind, seed):
    """<H f, r> = <f, H^T r>, and P H^T is the column of P."""
    rng = np.random.default_rng(seed)
    joint = Joint(kind, unit_vector(rng))
    f, r = rng.normal(size=6), rng.normal()
    twist = expand(joint, r)
    expected = np.r_[joint.axis * r, np.zeros(3)] if kind == "revolute" else np.r_[np.zeros(3), joint.axis * r]
    np.testing.assert_array_equal(twist, expected)
    assert project(joint, f) * r == pytest.approx(f @ twist, abs=1e-14)
    P = rng.normal(size=(6, 6))
    P = P + P.T
    np.testing.assert_allclose(column(joint, symmetric6(P)) * r, P @ twist, atol=1e-13)
