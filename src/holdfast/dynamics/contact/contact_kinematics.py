"""How a feature of one body meets a shape of another: the gap, the contact point, and their rates. Either may move.

A is the body of the feature, a sphere of radius r about c; B is that of the shape, with distance phi, unit normal n
(out of B) and Hessian S. v_c = v_A(c) - v_B(c):

    gap = phi(c) - r,   y = c - r n  (contact point),   d gap / dt = n . v_c
    d^2 gap / dt^2 = n . (a_A(c) - a_B(c) - 2 w_B x v_c) + v_c^T S v_c

On a circle, c is the place c(s) where d phi / ds = n . c' = 0. It wanders, and what is least over s bends less:

    f = d(d phi / ds)/dt = c'^T S v_c + n . (w_A - w_B) x c',   k = c'^T S c' + n . c'',   ds/dt = -f / k
    d^2 gap / dt^2  becomes less by f^2 / k;   n' = w_B x n + S (v_c + c' ds/dt),   y' = v_A(c) + c' ds/dt - r n'

That is an instant. In a time tau the place on a rim in a hole that is hardly wider turns towards f at most, as on a
circle within a circle, where sqrt(k^2 + f^2 tau^2) in place of k gives the rates at the end of that time.

The relative velocity of the two bodies at y, where they touch, has the rate of a moving place in each of their fields:
a + alpha x (y - p) + w x (y' - v).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.model.world.shape import WorldShape
from holdfast.model.world.touching import Candidate
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, sqrt, where
from holdfast.spatial.vector import cross

SHARP = 1e-9  # k below this part of the largest it could be: any place is as near, and it does not wander


class RigidMotion(NamedTuple):
    """The pose, twist [omega; v] and acceleration of a body about its origin, world axes."""

    frame: Pose
    twist: Array
    acceleration: Array

    def velocity(self, arm: Array) -> Array:
        """Return the velocity of the point at an arm from the origin."""
        return self.twist[3:] + cross(self.twist[:3], arm)

    def acceleration_at(self, arm: Array) -> Array:
        """Return the acceleration of the point at an arm from the origin."""
        w = self.twist[:3]
        return self.acceleration[3:] + cross(self.acceleration[:3], arm) + cross(w, cross(w, arm))

    def rate(self, arm: Array, moving: Array) -> Array:
        """Return the derivative of the body's velocity at a place that moves with a velocity of its own."""
        turned = cross(self.twist[:3], moving - self.twist[3:])
        return self.acceleration[3:] + cross(self.acceleration[:3], arm) + turned


class NearestPlace(NamedTuple):
    """Where a feature is nearest to a shape.

    Attributes:
        gap: distance [m].
        place: (3,) contact point, world axes [m].
        n: (3,) unit normal into the object, world axes.
        rate: (3,) derivative of the object's velocity relative to the world's surface there, without the object's
            acceleration.
        normal_rate: d^2 gap / dt^2 without the object's acceleration [m/s^2].
        world: (3,) velocity of the world's surface there, with what runs along it [m/s].
        world_normal: (3,) that of the world's body alone [m/s].
    """

    gap: Scalar
    place: Array
    n: Array
    rate: Array
    normal_rate: Scalar
    world: Array
    world_normal: Array


def meeting(candidate: Candidate, held: RigidMotion, ahead: Scalar | None = None) -> NearestPlace:
    """Return where a candidate's feature and shape meet. O(1).

    Args:
        candidate: the feature and the shape, one of which is on the object.
        held: motion of the object about C; its acceleration is 0 for what `NearestPlace` leaves out.
        ahead: the time over which rates of a place that wanders shall hold [s]; None: those of the instant.
    """
    feature, shape = candidate.feature, candidate.shape
    if candidate.reverse:
        frame = held.frame @ shape.pose
        A, B = STANDS_STILL, held
    else:
        frame = shape.pose
        A, B = held, RigidMotion(frame, shape.twist, shape.acceleration)
    in_shape = Pose.unchecked(frame.R.T @ A.frame.R, (A.frame.p - frame.p) @ frame.R)
    near = feature.nearest(shape, in_shape, candidate.which)
    found = shape.distance(in_shape.R @ near.arm + in_shape.p)
    n, S, r = frame.R @ found.n, frame.R @ found.S @ frame.R.T, feature.thickness
    arm = A.frame.R @ near.arm
    c = A.frame.p + arm
    from_B = arm + (A.frame.p - B.frame.p)
    w_A, w_B = A.twist[:3], B.twist[:3]
    of_A = A.velocity(arm)
    v_c = of_A - B.velocity(from_B)
    pull = A.acceleration_at(arm) - B.acceleration_at(from_B)
    normal_rate = n @ pull - 2.0 * (n @ cross(w_B, v_c)) + v_c @ S @ v_c
    wander = np.zeros(3)
    if feature.wanders:
        along, bend = A.frame.R @ near.along, A.frame.R @ near.bend
        f = along @ S @ v_c + n @ cross(w_A - w_B, along)
        k = along @ S @ along + n @ bend
        known = k > SHARP * sqrt(along @ along)
        stiff = k if ahead is None else sqrt(k * k + f * ahead * (f * ahead))
        rate = where(known, -f / where(known, stiff, 1.0), 0.0)
        normal_rate, wander = normal_rate + f * rate, rate * along
    n_rate = cross(w_B, n) + S @ (v_c + wander)
    moving = of_A + wander - r * n_rate
    y, y_A, y_B = c - r * n, arm - r * n, from_B - r * n
    relative = A.rate(y_A, moving) - B.rate(y_B, moving)
    if candidate.reverse:
        return NearestPlace(found.phi - r, y, -n, -relative, normal_rate, np.zeros(3), np.zeros(3))
    running, running_rate = _running(shape, y_B, moving)
    of_world = B.velocity(y_B)
    return NearestPlace(found.phi - r, y, n, relative - running_rate, normal_rate, of_world + running, of_world)


STANDS_STILL = RigidMotion(Pose.identity(), np.zeros(6), np.zeros(6))


def _running(shape: WorldShape, arm: Array, moving: Array) -> tuple[Array, Array]:
    """Return the velocity of a running surface relative to its shape at a place, and its rate there."""
    w_s, v_s = shape.surface_twist[:3], shape.surface_twist[3:]
    w, v = shape.twist[:3], shape.twist[3:]
    rate = cross(w, v_s) + cross(cross(w, w_s), arm) + cross(w_s, moving - v)
    return v_s + cross(w_s, arm), rate
