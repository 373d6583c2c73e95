"""Twists of links and tip are the rates of their poses."""

import numpy as np
import pytest

from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.posture import posture
from holdfast.dynamics.arm.velocity import link_twists, tip_twist
from holdfast.spatial.spatial_vector import rotate, shift_twist
from holdfast.spatial.vector import skew
from tests.dynamics.arm.moving import moving
from tests.dynamics.problems import random_arm
from tests.spatial.dual import slopes_of

seeds = pytest.mark.parametrize("seed", range(8))


@seeds
def test_twists_are_rates(seed):
    """R' = w~ R and O' = v for every link and the tip, by exact derivatives; the base moves too."""
    given = random_arm(seed)
    at = posture(given.arm, given.q)
    twists = link_twists(given.arm, at, given.qd, given.base_twist)
    later = moving(given, np.zeros(len(given.q)))
    there = posture(later.arm, later.q)
    for R, moved_R, reach, V in zip(at.R, there.R, there.reach, twists, strict=True):
        w, v = rotate(R, V)[:3], rotate(R, V)[3:]
        np.testing.assert_allclose(slopes_of(moved_R), skew(w) @ R, atol=1e-12)
        np.testing.assert_allclose(slopes_of(there.tip.p - reach), v, atol=1e-12)
    V0 = tip_twist(given.arm, at, twists)
    np.testing.assert_allclose(slopes_of(there.tip.p), V0[3:], atol=1e-12)
    np.testing.assert_allclose(slopes_of(there.tip.R), skew(V0[:3]) @ at.tip.R, atol=1e-12)


@seeds
def test_tip_twist_is_linear(seed):
    """V(0) = J qd + phi^T V(base) (2.1c)."""
    given = random_arm(seed)
    at = posture(given.arm, given.q)
    V0 = tip_twist(given.arm, at, link_twists(given.arm, at, given.qd, given.base_twist))
    carried = shift_twist(at.tip.p - given.arm.base.p, given.base_twist)
    np.testing.assert_allclose(V0, jacobian(given.arm, at) @ given.qd + carried, atol=1e-12)
