"""Products of 3-vectors."""

from holdfast.spatial.scalar import Array, array


def cross(a: Array, b: Array) -> Array:
    """Return a x b of two 3-vectors."""
    a0, a1, a2 = a.tolist()
    b0, b1, b2 = b.tolist()
    return array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def skew(a: Array) -> Array:
    """Return the 3x3 cross matrix a~, with a~ y = a x y."""
    a0, a1, a2 = a.tolist()
    return array([[0.0, -a2, a1], [a2, 0.0, -a0], [-a1, a0, 0.0]])


def outer(a: Array, b: Array) -> Array:
    """Return the matrix a b^T of two vectors."""
    return a[:, None] * b
