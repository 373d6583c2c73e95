"""The object's contacts with the world at one instant: gaps, contact axes, rows and their drift.

What touches what, and how the contact moves, is in `contact_kinematics`. With the arm l of the contact point from C,
and contact axes [t1; t2; n] with n into the object, world axes:

    u = C V - carried,   C = [t1; t2; n] [-l~, 1],   u_n = d gap / dt,   du/dt = C alpha + drift

The drift of the tangents leaves out the turning of t, which is multiplied by u_t: it holds where the contact sticks,
and only there u_t is imposed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.contact_kinematics import RigidMotion, meeting
from holdfast.model.world.touching import Touching
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, where
from holdfast.spatial.vector import cross


class ContactRows(NamedTuple):
    """The contacts of the object with the world at one instant, k candidates.

    With hands that slide, their points follow, and C has more columns and perhaps a fourth row, see `sliding_hands`.

    Attributes:
        gap: (k,) distances, negative within a shape [m].
        C: (k, 3, 6) rows along the contact axes: C V is the velocity of the object at the contact point.
        drift: (k, 3) C-dot V and the acceleration of the world's surface: du/dt = C alpha + drift [m/s^2].
        carried: (k, 3) velocity of the world's surface, contact axes; along n that of the shape alone [m/s].
        point: (k, 3) contact points from C, world axes [m].
        axes: (k, 3, 3) contact axes [t1, t2, n] as rows, n into the object, world axes.
        friction: (k,) mu.
        restitution: (k,).
    """

    gap: Array
    C: Array
    drift: Array
    carried: Array
    point: Array
    axes: Array
    friction: Array
    restitution: Array

    def velocity(self, twist: Array) -> Array:
        """Return u (k, 3), the velocity of the object relative to the surfaces, contact axes."""
        return self.C @ twist - self.carried

    def wrench(self, force: Array) -> Array:
        """Return the sum of C^T lambda for lambda (k, 3) in contact axes: a wrench (6,) about C, world axes."""
        none = np.zeros(self.C[0].shape[1]) if len(self.C) else np.zeros(6)
        return sum((rows.T @ one for rows, one in zip(self.C, force, strict=True)), none)

    def in_world(self, force: Array) -> Array:
        """Return vectors (k, 3) in contact axes as vectors in world axes."""
        return rows_in_world(self.axes, force)


def rows_in_world(axes: Array, x: Array) -> Array:
    """Return vectors (k, 3 or more), of which the first three are along axes (k, 3, 3), in world axes, (k, 3)."""
    return array([one[:3] @ own for one, own in zip(x, axes, strict=True)])


def contact_rows(touching: Touching, object_frame: Pose, twist: Array, ahead: Scalar | None = None) -> ContactRows:
    """Return the gaps, rows and drifts of all candidates. O(k).

    Args:
        touching: the points and shapes.
        object_frame: pose of the object (origin C) in the world.
        twist: (6,) its twist about C, world axes.
        ahead: the time over which the drift of rims shall hold [s]; None: that of the instant.
    """
    found = []
    held = RigidMotion(object_frame, twist, np.zeros(6))
    for one in touching.candidates:
        shape = one.shape
        at = meeting(one, held, ahead)
        l, axes = at.place - object_frame.p, contact_axes(at.n)
        C = array([concatenate([cross(l, t), t]) for t in axes])
        drift = array([axes[0] @ at.rate, axes[1] @ at.rate, at.normal_rate])
        carried = array([axes[0] @ at.world, axes[1] @ at.world, at.n @ at.world_normal])
        found.append((at.gap, C, drift, carried, l, axes, shape.friction, shape.restitution))
    return ContactRows(*(array(x) for x in zip(*found, strict=True)))


def contact_axes(n: Array) -> Array:
    """Return contact axes [t1; t2; n] as rows of a rotation, for a unit vector n (3,); without a branch.

    Source: Duff and others, "Building an orthonormal basis, revisited", JCGT 6 (2017).
    """
    x, y, z = n.tolist()
    s = where(z < 0.0, -1.0, 1.0)
    a = -1.0 / (s + z)
    b = x * y * a
    return array([[1.0 + s * x * x * a, s * b, -s * x], [b, s + y * y * a, -y], [x, y, z]])
