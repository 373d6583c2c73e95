"""Products of small vectors and matrices, and their largest entries.

`@` on floats is BLAS, whose last digits depend on the kernel that it picks for the processor. Where the numbers of a
model are made, `dot` and `product` sum in one order instead, so that a model is the same on every processor.
"""

from collections.abc import Iterable

from holdfast.spatial.scalar import Array, Scalar, array, maximum


def cross(a: Array, b: Array) -> Array:
    """Return a x b of two 3-vectors."""
    a0, a1, a2 = a.tolist()
    b0, b1, b2 = b.tolist()
    return array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def dot(a: Array, b: Array) -> Scalar:
    """Return a . b of two vectors, summed in order."""
    first, *others = [x * y for x, y in zip(a.tolist(), b.tolist(), strict=True)]
    return sum(others, first)


def product(A: Array, B: Array) -> Array:
    """Return A B of a matrix (l, m) and a matrix (m, n) or vector (m,), summed in order."""
    columns = A.T if B.ndim == 1 else A.T[:, :, None]
    found = columns[0] * B[0]
    for column, row in zip(columns[1:], B[1:], strict=True):
        found = found + column * row
    return found


def skew(a: Array) -> Array:
    """Return the 3x3 cross matrix a~, with a~ y = a x y."""
    a0, a1, a2 = a.tolist()
    return array([[0.0, -a2, a1], [a2, 0.0, -a0], [-a1, a0, 0.0]])


def axial(A: Array) -> Array:
    """Return (A32 - A23, A13 - A31, A21 - A12), the vector with axial(A) . a = sum of A_ij (a~)_ij, (3,)."""
    return array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])


def outer(a: Array, b: Array) -> Array:
    """Return the matrix a b^T of two vectors."""
    return a[:, None] * b


def largest(x: Iterable[Scalar]) -> Scalar:
    """Return the largest absolute value of some numbers; 0 if there are none."""
    found: Scalar = 0.0
    for entry in x:
        found = maximum(found, abs(entry))
    return found
