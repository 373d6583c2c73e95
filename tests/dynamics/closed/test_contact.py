"""One grasp in motion: its axes, rates and biases, by exact derivatives."""

import numpy as np
import pytest

from holdfast import Grasp, Pose
from holdfast.dynamics.closed.contact import contact
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.spatial.vector import skew
from tests.spatial.dual import duals, slopes_of
from tests.systems.random_parts import rotation

TIP = Pose.identity()  # of the arm, on which none of the kinds depends
KINDS = {"rigid": 0, "hinge": 1, "softfinger": 2, "ball": 3}
cases = pytest.mark.parametrize(("kind", "seed"), [(kind, seed) for kind in KINDS for seed in range(3)])


def drawn(kind: str, seed: int):
    """Return a grasp, the object's pose and twist, and a tip twist that it allows."""
    rng = np.random.default_rng(seed)
    grasp = Grasp(kind, Pose(rotation(rng), 0.3 * rng.normal(size=3)))
    frame, V = Pose(rotation(rng), rng.normal(size=3)), rng.normal(size=6)
    at = contact(grasp, frame, V, TIP, np.zeros(6))
    tip = shift_twist(at.offset, V) - at.HT @ rng.normal(size=KINDS[kind])
    return grasp, frame, V, tip, contact(grasp, frame, V, TIP, tip)


@cases
def test_directions(kind, seed):
    """K and H together are the six directions: orthonormal rows, K H^T = 0 (a.7)."""
    *_, c = drawn(kind, seed)
    assert c.HT.shape == (6, KINDS[kind])
    np.testing.assert_allclose(c.K @ c.K.T, np.eye(6 - KINDS[kind]), atol=1e-14)
    np.testing.assert_allclose(c.K @ c.HT, 0, atol=1e-14)
    x = np.random.default_rng(seed).normal(size=6)
    np.testing.assert_allclose(c.transmitted(x), c.K @ x, atol=1e-14)


@cases
def test_rates(kind, seed):
    """V- = V+ + H^T W (a.6): W is found, and no gap where the tip moves as allowed."""
    _, _, V, tip, c = drawn(kind, seed)
    np.testing.assert_allclose(shift_twist(c.offset, V), tip + c.HT @ c.W, atol=1e-13)
    np.testing.assert_allclose(c.velocity_gap, 0, atol=1e-13)
    nudged = contact(c.grasp, drawn(kind, seed)[1], V, TIP, tip - np.arange(1.0, 7.0))
    np.testing.assert_allclose(nudged.velocity_gap, c.K @ np.arange(1.0, 7.0), atol=1e-12)


@cases
def test_biases(kind, seed):
    """a(C) = Adot V(C) and g = Hdot^T W (a.8), derivatives along the object's motion."""
    grasp, frame, V, tip, c = drawn(kind, seed)
    turned = Pose(duals(frame.R, skew(V[:3]) @ frame.R), duals(frame.p, V[3:]))
    later = contact(grasp, turned, V, TIP, tip)
    np.testing.assert_allclose(slopes_of(shift_twist(later.offset, V)), c.a, atol=1e-12)
    np.testing.assert_allclose(np.r_[slopes_of(later.h) @ c.W, np.zeros(3)], c.g, atol=1e-12)
    if kind in ("hinge", "softfinger"):
        assert np.abs(c.g).max() > 1e-2


@pytest.mark.parametrize("seed", range(5))
def test_carried_by_either_side(seed):
    """For a hinge Hdot^T W is the same whether its axis rides on the tip or on the object (a.8)."""
    _, _, V, tip, c = drawn("hinge", seed)
    np.testing.assert_allclose(np.cross(tip[:3], c.h @ c.W), np.cross(V[:3], c.h @ c.W), atol=1e-13)
