"""Gaps and rows of contacts: velocities and drifts are derivatives along a motion of the object."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.contact.rows import contact_axes, contact_rows
from holdfast.spatial import rotation
from holdfast.world import Sphere, Touching
from tests.model.world.test_shapes import SHAPES

POINTS = {"point": [0.05, 0.02, -0.04], "ball": Sphere([-0.03, 0.06, 0.02], 0.03)}


def motion(t, start, w, v, turn, a):
    """Return the pose and twist of a motion with constant angular velocity and acceleration a, at a time t."""
    R = rotation.exp(w * t) @ start.R
    p = start.p + v * t + 0.5 * a * t * t
    return hf.Pose.unchecked(R, p), np.concatenate([w, v + a * t])


@pytest.mark.parametrize("name", SHAPES)
def test_rows_are_derivatives(name):
    """d gap / dt = u_n, d u_n / dt = C_n alpha + drift_n; tangents likewise at a sticking surface."""
    touching = Touching(points=POINTS, world={"shape": SHAPES[name]})
    rng, h = np.random.default_rng(2), 1e-5
    for _ in range(20):
        start = hf.Pose(rotation.exp(rng.uniform(-1, 1, 3)), rng.uniform(-0.7, 0.7, 3))
        w, v, a = rng.uniform(-1, 1, (3, 3))
        now = contact_rows(touching, start, np.concatenate([w, v]))
        if now.gap.min() < 0.08:
            continue
        around = [contact_rows(touching, *motion(s, start, w, v, 0.0, a)) for s in (-h, h)]
        u = [rows.velocity(motion(s, start, w, v, 0.0, a)[1]) for rows, s in zip(around, (-h, h), strict=True)]
        twist, alpha = np.concatenate([w, v]), np.concatenate([np.zeros(3), a])
        np.testing.assert_allclose(now.velocity(twist)[:, 2], (around[1].gap - around[0].gap) / (2 * h), atol=1e-8)
        change = (u[1] - u[0]) / (2 * h)
        np.testing.assert_allclose((now.C @ alpha + now.drift)[:, 2], change[:, 2], atol=2e-6)
        # tangents in fixed axes, with the velocity of the point of contact in world axes
        world = [rows.in_world(x) for rows, x in zip(around, u, strict=True)]
        of_axes = np.einsum("kij,kj->ki", now.axes, (world[1] - world[0]) / (2 * h))
        sticking = (now.C @ alpha + now.drift)[:, :2]
        np.testing.assert_allclose(sticking, of_axes[:, :2], atol=2e-6)


def test_axes_are_rotations():
    """Contact axes are right-handed and orthonormal for all directions, the poles included."""
    rng = np.random.default_rng(0)
    for n in [*rng.normal(size=(50, 3)), [0, 0, 1.0], [0, 0, -1.0], [1e-9, 0, -1.0], [1.0, 0, 0]]:
        A = contact_axes(np.array(n, float) / np.linalg.norm(n))
        np.testing.assert_allclose(A @ A.T, np.eye(3), atol=4e-16)
        assert abs(np.linalg.det(A) - 1.0) < 1e-14


def test_running_surface():
    """A belt carries what sticks to it: u is relative to the belt, and its normal component is the gap's rate."""
    belt = hf.world.HalfSpace(friction=0.5, surface_twist=[0, 0, 0, 0.3, 0, 0])
    touching = Touching(points={"a": [0, 0, -0.1]}, world={"belt": belt})
    rows = contact_rows(touching, hf.Pose.translation(0, 0, 0.1), np.zeros(6))
    np.testing.assert_allclose(rows.in_world(rows.velocity(np.array([0, 0, 0, 0.3, 0, 0]))), 0.0, atol=1e-16)
    np.testing.assert_allclose(rows.in_world(rows.velocity(np.zeros(6))), [[-0.3, 0, 0]], atol=1e-16)
    assert rows.wrench(np.array([[0.0, 0.0, 2.0]])) == pytest.approx(np.array([0, 0, 0, 0, 0, 2.0]))
