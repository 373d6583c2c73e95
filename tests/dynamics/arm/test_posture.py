"""Where the links are: against the oracle's frames, and far from the world's origin."""

import numpy as np
import pytest

from holdfast.dynamics.arm.posture import posture
from holdfast.spatial import rotation
from tests.dynamics.problems import random_arm, relative_gap
from tests.oracles.arithmetic import arithmetic
from tests.oracles.arm_kinematics import link_frames
from tests.systems import random_system


@pytest.mark.parametrize("seed", range(6))
def test_frames(seed):
    """Rotation and origin of every link, revolute or prismatic, and of the tip."""
    case = random_system(seed, arms=1, moving_base=True, gravity=(1.0, -2.0, -9.0))
    given = random_arm(seed)
    at = posture(given.arm, given.q)
    for R, reach, frame in zip(at.R, at.reach, link_frames(case["arms"][0], arithmetic(None)), strict=True):
        np.testing.assert_allclose(R, frame.R, atol=1e-14)
        np.testing.assert_allclose(at.tip.p - reach, frame.origin, atol=1e-13)
    np.testing.assert_allclose(at.tip.R, at.R[-1] @ given.arm.tip.R, atol=1e-15)
    R = given.arm.base.R
    for E in at.E:
        R = R @ E
    np.testing.assert_allclose(R, at.R[-1], atol=1e-14)


@pytest.mark.parametrize("seed", range(4))
def test_far_base_costs_no_digits(seed):
    """A base 1e9 m away leaves distances within the arm as they are, to the last bit."""
    given = random_arm(seed)
    near = posture(given.arm, given.q)
    far = posture(given.arm.at(type(given.arm.base)(given.arm.base.R, np.full(3, 1e9))), given.q)
    for a, b in zip(near.reach, far.reach, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("turns", [1, -3, 16000])
def test_full_turns_do_nothing(turns):
    """A revolute joint is where it was after full turns; angles to 1e5 rad keep ten digits."""
    given = random_arm(2, grasps="ball")
    revolute = np.array([joint.kind == "revolute" for joint in given.arm.joints])
    turned = posture(given.arm, given.q + 2 * np.pi * turns * revolute).tip
    tip = posture(given.arm, given.q).tip
    assert relative_gap(turned.p, tip.p) < 1e-15 * (100 + 50 * abs(turns))
    assert np.linalg.norm(rotation.log(turned.R.T @ tip.R)) < 1e-15 * (100 + 50 * abs(turns))
