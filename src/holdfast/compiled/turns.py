"""Rotation vectors of many rotations at once: what `spatial.rotation` does for one, on leading axes.

Entry by entry, so that the bits do not depend on how many there are.
"""

from __future__ import annotations

import numpy as np

from holdfast.spatial.scalar import Array


def log(R: Array) -> Array:
    """Return the rotation vectors [rad], of length <= pi, of rotation matrices.

    Args:
        R: (..., 3, 3).

    Returns:
        (..., 3); not-a-number where R is.
    """
    q = to_quaternion(R)
    sine = _length(q[..., 1:])
    small = sine < 1e-9  # angle = 2 sine (1 + sine^2/6 ...)
    ratio = np.where(small, 2.0, 2.0 * np.arctan2(sine, q[..., 0].copy()) / np.where(small, 1.0, sine))
    return ratio[..., None] * q[..., 1:]


def to_quaternion(R: Array) -> Array:
    """Return the unit quaternions (w, x, y, z) with w >= 0 of rotation matrices.

    4 q q^T is linear in R; the row of the largest component is taken, so no digits cancel.

    Args:
        R: (..., 3, 3).

    Returns:
        (..., 4).
    """
    x, y, z = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    trace = x + y + z
    products = np.empty((*R.shape[:-2], 4, 4))
    products[..., 0, 0] = 1.0 + trace
    for i in range(3):
        j, m = (i + 1) % 3, (i + 2) % 3
        products[..., 0, 1 + i] = products[..., 1 + i, 0] = R[..., m, j] - R[..., j, m]
        products[..., 1 + i, 1 + i] = 1.0 + R[..., i, i] - R[..., j, j] - R[..., m, m]
        products[..., 1 + i, 1 + j] = products[..., 1 + j, 1 + i] = R[..., i, j] + R[..., j, i]
    largest = np.stack([trace, x, y, z], -1).argmax(-1)
    q = np.take_along_axis(products, largest[..., None, None], -2)[..., 0, :]
    q = q / _length(q)[..., None]
    return np.where(q[..., :1] < 0.0, -q, q)


def align(a: Array, b: Array) -> Array:
    """Return the shortest rotation vectors [rad] that turn unit vectors a to unit vectors b.

    Where a = -b any perpendicular axis serves and one is chosen.

    Args:
        a: (..., 3).
        b: (3,) or (..., 3).

    Returns:
        (..., 3).
    """
    axis, cosine = np.cross(a, b), _dot(a, b)
    sine = _length(axis)
    small = sine <= 1e-12
    ratio = np.where(small, 1.0, np.arctan2(sine, cosine) / np.where(small, 1.0, sine))
    other = np.cross(a, np.eye(3)[np.abs(a).argmin(-1)])
    half_turn = (np.pi / _length(other))[..., None] * other
    return np.where((small & ~(cosine > 0.0))[..., None], half_turn, ratio[..., None] * axis)


def _dot(a: Array, b: Array) -> Array:
    total = a[..., 0] * b[..., 0]
    for i in range(1, a.shape[-1]):
        total = total + a[..., i] * b[..., i]
    return total


def _length(v: Array) -> Array:
    return np.sqrt(_dot(v, v))
