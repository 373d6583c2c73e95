"""Gaps of features and shapes that both move: rates are derivatives along the motion, in either order of the two."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.spatial import rotation
from holdfast.world import Ball, Box, Circle, Cone, Cylinder, HalfSpace, Hole, Rod, Sphere, Touching

H = 1e-3

SHAPES = {
    "half-space": HalfSpace(normal=[0.6, 0, 0.8], offset=-0.5, friction=0.5),
    "ball": Ball(radius=0.3),
    "hole": Cylinder(radius=0.9, inside=True),
    "funnel": Cone(angle=0.9, inside=True, pose=hf.Pose.translation(0, 0, -1.2)),
    "box": Box(half=[0.3, 0.2, 0.1], edge=0.02),
    "chamfered hole": Hole(radius=0.35, chamfer=0.2, edge=0.05),
    "rod": Rod(radius=0.2, half_length=0.4, edge=0.03),
}
FEATURES = {
    "point": Sphere([0.1, 0.05, -0.2]),
    "ball": Sphere([-0.1, 0.1, 0.05], 0.07),
    "rim": Circle([0.05, 0.0, -0.1], [0.0, 0.6, 0.8], 0.15),
    "torus": Circle([0.0, 0.02, 0.1], [0.8, 0.0, 0.6], 0.25, 0.04),
}


class Moving:
    """A motion with constant angular velocity and acceleration of the origin."""

    def __init__(self, rng, spread, still=False):
        """Draw the motion; still: it stands."""
        self.start = hf.Pose(rotation.exp(rng.uniform(-1, 1, 3)), spread * rng.uniform(-1, 1, 3))
        self.w, self.v, self.a = np.zeros((3, 3)) if still else rng.uniform(-1, 1, (3, 3))

    def __call__(self, t):
        """Return pose, twist, acceleration."""
        pose = hf.Pose.unchecked(
            rotation.exp(self.w * t) @ self.start.R, self.start.p + self.v * t + 0.5 * self.a * t * t
        )
        return pose, np.concatenate([self.w, self.v + self.a * t]), np.concatenate([np.zeros(3), self.a])


def rows_at(t, feature, shape, held, world, running=None):
    """Return the contacts at a time, the shape in the world and moving."""
    placed = shape if running is None else replace(shape, surface_twist=running)
    touching = Touching({"f": feature}, {"s": replace(placed, pose=world.start)}).moved({"s": world(t)})
    frame, twist, _ = held(t)
    return contact_rows(touching, frame, twist), twist


def derivative(of):
    """Return the derivative of a function of time at 0 by differences over five points."""
    return (8.0 * (of(H) - of(-H)) - (of(2 * H) - of(-2 * H))) / (12.0 * H)


@pytest.mark.parametrize("of", FEATURES)
@pytest.mark.parametrize("name", SHAPES)
def test_both_move(name, of):
    """u_n is the rate of the gap, and C alpha + drift that of u, of tangents in fixed axes: all by differences."""
    rng, seen = np.random.default_rng(len(name) + 7 * len(of)), 0
    while seen < 2:
        held, world = Moving(rng, 0.8), Moving(rng, 0.2)

        def at(t, held=held, world=world):
            return rows_at(t, FEATURES[of], SHAPES[name], held, world)

        def velocity(t, at=at):
            rows, twist = at(t)
            return np.append(rows.velocity(twist)[0] @ rows.axes[0], rows.velocity(twist)[0, 2])

        drifts = [at(t)[0].drift[0] for t in np.linspace(-2 * H, 2 * H, 5)]
        if at(0.0)[0].gap[0] < 0.05 or np.abs(np.diff(drifts, axis=0)).max() > 0.1:
            continue  # a corner of the shape, or another place of the circle, is near
        seen += 1
        rows, twist = at(0.0)
        rate, change = derivative(lambda t, at=at: at(t)[0].gap[0]), derivative(velocity)
        assert rows.velocity(twist)[0, 2] == pytest.approx(rate, abs=1e-8)
        found = rows.C[0] @ held(0.0)[2] + rows.drift[0]
        assert found[2] == pytest.approx(change[3], abs=1e-6)
        np.testing.assert_allclose(found[:2], rows.axes[0, :2] @ change[:3], atol=1e-6)


def test_running_surface_turns_with_its_shape():
    """A turning drum whose belt runs along it: the velocity of what sticks to it has the right rate."""
    rng = np.random.default_rng(4)
    belt, rod = np.array([0, 0, 2.0, 0, 0, 0.7]), Cylinder(radius=0.2, friction=0.5)
    for _ in range(5):
        held, world = Moving(rng, 0.8), Moving(rng, 0.2)
        running = np.concatenate([world.start.R @ belt[:3], world.start.R @ belt[3:]])  # about and along the axis

        def velocity(t, held=held, world=world, running=running):
            rows, twist = rows_at(t, Sphere([0.1, 0, 0], 0.05), rod, held, world, running)
            return rows.velocity(twist)[0] @ rows.axes[0]

        rows, _ = rows_at(0.0, Sphere([0.1, 0, 0], 0.05), rod, held, world, running)
        if rows.gap[0] < 0.1:
            continue
        found = (rows.C[0] @ held(0.0)[2] + rows.drift[0])[:2]
        np.testing.assert_allclose(found, rows.axes[0, :2] @ derivative(velocity), atol=1e-6)


@pytest.mark.parametrize("of", FEATURES)
@pytest.mark.parametrize("name", SHAPES)
def test_reversed(name, of):
    """A feature in the world against a shape of the object is the same meeting, with the object's motion taken away."""
    rng = np.random.default_rng(3)
    for _ in range(10):
        object_motion = Moving(rng, 0.5)
        frame, twist, acceleration = object_motion(0.0)
        shape = replace(SHAPES[name], pose=hf.Pose.identity())
        back = Touching({}, {}, solids={"s": shape}, edges={"f": FEATURES[of]})
        there = Touching({"f": FEATURES[of]}, {"s": shape}).moved({"s": (frame, twist, acceleration)})
        one = contact_rows(back, frame, twist)
        other = contact_rows(there, hf.Pose.identity(), np.zeros(6))
        np.testing.assert_allclose(one.gap, other.gap, atol=1e-15)
        np.testing.assert_allclose(one.axes[:, 2], -other.axes[:, 2], atol=1e-14)
        u, v = one.in_world(one.velocity(twist)), other.in_world(other.velocity(np.zeros(6)))
        np.testing.assert_allclose(u, -v, atol=1e-13)
        du = one.in_world(one.C @ acceleration + one.drift)
        np.testing.assert_allclose(du, -other.in_world(other.drift), atol=1e-11)
