"""The normal of an object's surface at a contact."""

from __future__ import annotations

import numpy as np

from holdfast import outer
from holdfast.model.held_object import HeldObject
from holdfast.model.visuals import Cylinder, Sphere
from holdfast.spatial.scalar import Array

ON_FACE = 1e-6  # distance from a face, relative to the size, below which a place lies on it


def outward_normal(held: HeldObject, place: Array) -> Array | None:
    """Return the outward normal (3,) of the object's surface at a place on it, None elsewhere and on edges.

    The surface is that of the object's sphere or cylinder or, without a shape, of the box with its inertia.
    """
    if isinstance(held.shape, Sphere):
        distance = float(np.linalg.norm(place))
        return place / distance if abs(distance - held.shape.radius) < ON_FACE * held.shape.radius else None
    if isinstance(held.shape, Cylinder):
        sizes, axes = np.array([2 * held.shape.radius, held.shape.length]), np.eye(3)
        across = np.array([place[0], place[1], 0.0])
        radius = float(np.linalg.norm(across))
        local, axes = np.array([radius, place[2]]), np.column_stack([across / (radius or 1.0), axes[:, 2]])
    elif held.shape is None:
        sizes, at = outer.equivalent_box(held)
        local, axes = at.R.T @ (place - at.p), at.R
    else:
        return None
    off = np.abs(local) - 0.5 * sizes
    face = int(np.argmax(off))
    inside = np.delete(off, face) < -ON_FACE * sizes.max()
    return np.sign(local[face]) * axes[:, face] if abs(off[face]) < ON_FACE * sizes.max() and inside.all() else None
