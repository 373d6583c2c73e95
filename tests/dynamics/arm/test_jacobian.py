"""The tip Jacobian is the derivative of the tip's pose."""

import numpy as np
import pytest

from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.posture import posture
from holdfast.spatial import rotation
from holdfast.spatial.vector import skew
from tests.dynamics.arm.moving import displaced
from tests.dynamics.problems import random_arm
from tests.spatial.dual import slopes_of


@pytest.mark.parametrize("seed", range(8))
def test_columns(seed):
    """Column k is the tip's twist per unit qd_k: exact derivatives by position and rotation."""
    given = random_arm(seed)
    at = posture(given.arm, given.q)
    J = jacobian(given.arm, at)
    assert J.shape == (6, len(given.q))
    for column, direction in zip(J.T, np.eye(len(given.q)), strict=True):
        there = posture(given.arm, displaced(given, direction).q).tip
        np.testing.assert_allclose(slopes_of(there.p), column[3:], atol=1e-13)
        np.testing.assert_allclose(slopes_of(there.R), skew(column[:3]) @ at.tip.R, atol=1e-13)


@pytest.mark.parametrize("seed", range(3))
def test_finite_differences(seed):
    """Central differences of the posture agree to their own order."""
    given, h = random_arm(seed), 1e-6
    J = jacobian(given.arm, posture(given.arm, given.q))
    for column, direction in zip(J.T, np.eye(len(given.q)), strict=True):
        ahead, behind = (posture(given.arm, given.q + s * h * direction).tip for s in (1, -1))
        np.testing.assert_allclose((ahead.p - behind.p) / (2 * h), column[3:], atol=1e-8)
        np.testing.assert_allclose(rotation.log(ahead.R @ behind.R.T) / (2 * h), column[:3], atol=1e-8)


def test_prismatic_column():
    """A prismatic joint moves the tip along its axis and does not turn it."""
    given = random_arm(3)
    at = posture(given.arm, given.q)
    J = jacobian(given.arm, at)
    sliding = [k for k, joint in enumerate(given.arm.joints) if joint.kind == "prismatic"]
    assert sliding
    for k in sliding:
        np.testing.assert_array_equal(J[:3, k], 0)
        np.testing.assert_allclose(J[3:, k], at.R[k] @ given.arm.joints[k].axis, atol=1e-15)
