"""Twists [omega; v] and wrenches [moment; force]: 6-vectors, angular part first.

phi(a, b) = [I, l~; 0, I] with l = b - a moves a wrench from point b to point a;
phi^T(a, b) moves a twist from point a to point b (docs/theory/arm.md; paper after (2.5)).
"""

import numpy as np

from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.spatial.vector import cross


def shift_wrench(l: Array, f: Array) -> Array:
    """Return phi f = [n + l x F; F]: the wrench at b seen at a, l from a to b [m]."""
    return concatenate([f[:3] + cross(l, f[3:]), f[3:]])


def shift_twist(l: Array, V: Array) -> Array:
    """Return phi^T V = [w; v + w x l]: the twist at a seen at b, l from a to b [m]."""
    return concatenate([V[:3], V[3:] + cross(V[:3], l)])


def twist_shift(l: Array) -> Array:
    """Return phi^T as a (6, 6) matrix: what `shift_twist` does, l from a to b [m]."""
    return array([shift_twist(l, unit) for unit in np.eye(6)]).T


def rotate(R: Array, x: Array) -> Array:
    """Return the 6-vector with both halves multiplied by R (new axes, same point)."""
    return concatenate([R @ x[:3], R @ x[3:]])


def unrotate(R: Array, x: Array) -> Array:
    """Return the 6-vector with both halves multiplied by R^T."""
    return concatenate([x[:3] @ R, x[3:] @ R])


def acceleration_gradient(alpha: Array, w: Array) -> Array:
    """Return K = alpha~ + w~ w~, (3, 3): the point at r of a turning body accelerates by K r more [1/s^2]."""
    x, y, z = w.tolist()
    a, b, c = alpha.tolist()
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    return array([[-(yy + zz), xy - c, xz + b], [xy + c, -(xx + zz), yz - a], [xz - b, yz + a, -(xx + yy)]])


def centripetal(w: Array, l: Array) -> Array:
    """Return w x (w x l) [m/s^2]: the acceleration at the end of a turning vector l."""
    return cross(w, cross(w, l))
