"""The object's contacts with the world at one instant: gaps, contact axes, rows and their drift.

A contact is a sphere of radius r with its centre c in the object against a shape with the signed distance phi, the unit
normal n (into the object) and the Hessian S. Arms are from C, world axes:

    gap = phi(c) - r,   l = arm - r n  (contact point),   u = [t1; t2; n] (v + w x l - v_s(l))
    u_n = d gap / dt,   u = C V - carried,                C = [t1; t2; n] [-l~, 1]
    d u_n / dt = n . (a + alpha x l + w x (w x arm)) + v_c^T S v_c            v_c = v + w x arm
    d u_t / dt = t . (a + alpha x l + w x (w x arm - r S v_c) - w_s x (v_c - r S v_c))

The last line leaves out the turning of t, which is multiplied by u_t: it holds where the contact sticks, and only
there u_t is imposed. v_s and w_s are those of a running surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.model.world.touching import Touching
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array, concatenate, where
from holdfast.spatial.vector import cross


class ContactRows(NamedTuple):
    """The contacts of the object with the world at one instant, k candidates.

    With hands that slide, their points follow, and C has more columns and perhaps a fourth row, see `sliding_hands`.

    Attributes:
        gap: (k,) distances, negative within a shape [m].
        C: (k, 3, 6) rows along the contact axes: C V is the velocity of the object at the contact point.
        drift: (k, 3) C-dot V and the acceleration of a running surface: du/dt = C alpha + drift [m/s^2].
        carried: (k, 3) velocity of the running surface, contact axes; its normal component is 0 [m/s].
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


def contact_rows(touching: Touching, object_frame: Pose, twist: Array) -> ContactRows:
    """Return the gaps, rows and drifts of all candidates. O(k).

    Args:
        touching: the points and shapes.
        object_frame: pose of the object (origin C) in the world.
        twist: (6,) its twist about C, world axes.
    """
    found = []
    w, v = twist[:3], twist[3:]
    for _, sphere, shape in touching.candidates:
        arm = object_frame.R @ sphere.centre
        x = object_frame.p + arm
        phi, n, S = shape.from_world(x)
        l, axes = arm - sphere.radius * n, contact_axes(n)
        centre = v + cross(w, arm)
        turning = S @ centre  # of the normal
        place = object_frame.p + l
        w_s, v_s = shape.surface_twist[:3], shape.surface_twist[3:]
        surface = v_s + cross(w_s, place - shape.pose.p)
        inward = cross(w, cross(w, arm))
        along = inward - sphere.radius * cross(w, turning) - cross(w_s, centre - sphere.radius * turning)
        drift = array([axes[0] @ along, axes[1] @ along, n @ inward + centre @ turning])
        carried = array([axes[0] @ surface, axes[1] @ surface, 0.0])
        C = array([concatenate([cross(l, t), t]) for t in axes])
        found.append((phi - sphere.radius, C, drift, carried, l, axes, shape.friction, shape.restitution))
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
