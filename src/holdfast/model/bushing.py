"""Bushings: compliant grasps, which exert a wrench, the gradient of a stored energy, instead of imposing a constraint.

Let n and e be the scalar and the vector of the unit quaternion of the contact frame relative to the tip frame, p the
origin of the contact frame in tip axes, and V = [w; v] the twist of the object relative to the tip at that origin. Then
    x = [2 e; p],   U = 1/2 x . K x,   dx/dt = [(n 1 - e~) w; v]
For a rotation by the angle t, 2 e is the axis times 2 sin(t / 2). It is smooth below half a turn, and its relative
difference from t is at most t^2 / 24. With [a; b] = K x, the tip therefore exerts the following wrench on the object,
about that origin and in tip axes:
    -[n a + e x a; b] - C V
This is derived in docs/theory/contacts.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.motion_subspace import MatrixRows, rows_of
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, select, sqrt, where
from holdfast.spatial.spatial_vector import rotate, shift_wrench
from holdfast.spatial.vector import cross

SEMIDEFINITE = 1e-9  # eigenvalues above minus this, for a matrix scaled to unit diagonal, count as >= 0


@dataclass(frozen=True)
class Bushing:
    """A spring and damper in six directions, in tip axes about the tip's origin.

    Attributes:
        stiffness: (6, 6) symmetric matrix for [turn; shift] [N m, N, N/m].
        damping: (6, 6) symmetric matrix for their rates [N m s, N s, N s/m].
    """

    stiffness: MatrixRows
    damping: MatrixRows

    def deflection(self, Q: Array, p: Array, W: Array, R: Array) -> Deflection:
        """Return the deflection of the bushing at one instant.

        Args:
            Q: (3, 3) rotation from the axes of the contact frame to tip axes.
            p: (3,) from the tip to the origin of the contact frame, tip axes [m].
            W: (6,) twist of the object relative to the tip at the tip's point, tip axes.
            R: (3, 3) rotation from tip axes to world axes.
        """
        n, e = unit_quaternion(Q)
        x, V = concatenate([2.0 * e, p]), concatenate([W[:3], W[3:] + cross(W[:3], p)])
        return Deflection(np.array(self.stiffness), np.array(self.damping), n, e, x, V, R)


class Deflection(NamedTuple):
    """The deformation of a bushing at one instant, in tip axes.

    Attributes:
        stiffness, damping: (6, 6) matrices K and C.
        n, e: scalar and vector (3,) of the unit quaternion of the contact frame relative to the tip frame.
        x: (6,) [2 e; p].
        V: (6,) twist of the object relative to the tip at the contact's origin.
        R: (3, 3) rotation from tip axes to world axes.
    """

    stiffness: Array
    damping: Array
    n: Scalar
    e: Array
    x: Array
    V: Array
    R: Array

    def energy(self) -> Scalar:
        """Return 1/2 x . K x [J]."""
        return 0.5 * (self.x @ (self.stiffness @ self.x))

    def loss(self) -> Scalar:
        """Return V . C V [W]."""
        return self.V @ (self.damping @ self.V)

    def wrench(self) -> Array:
        """Return the wrench of the tip on the object, (6,) about the tip's point, world axes."""
        a, b = np.split(self.stiffness @ self.x, 2)
        at_contact = -concatenate([self.n * a + cross(self.e, a), b]) - self.damping @ self.V
        return rotate(self.R, shift_wrench(self.x[3:], at_contact))


def bushing(stiffness: Any, damping: Any) -> Bushing:
    """Return a bushing.

    Args:
        stiffness: (6,) along the axes, rotations first, or (6, 6) symmetric and positive semidefinite.
        damping: likewise; None for no damping.

    Raises:
        ModelError: a shape is wrong, or a matrix is not symmetric and positive semidefinite.
    """
    none = np.zeros(6)
    return Bushing(_matrix(stiffness, "stiffness"), _matrix(none if damping is None else damping, "damping"))


def _matrix(given: Any, what: str) -> MatrixRows:
    what = f"grasp: {what}"
    x = checks.numbers(given, None, what)
    if x.shape not in ((6,), (6, 6)):
        raise ModelError(f"{what}: expected shape (6,) or (6, 6), got shape {x.shape}")
    matrix = np.diag(x) if x.ndim == 1 else np.array(x)
    _require_semidefinite(matrix, what)
    return rows_of(0.5 * matrix + 0.5 * matrix.T)


def _require_semidefinite(matrix: Array, what: str) -> None:
    size = np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > SEMIDEFINITE * size:
        raise ModelError(f"{what}: expected a symmetric matrix, got asymmetry {np.abs(matrix - matrix.T).max():.3g}")
    diagonal = np.diag(matrix)
    if (diagonal < 0).any():
        raise ModelError(f"{what}: expected numbers >= 0 on the diagonal, got {diagonal.min():.6g}")
    unit = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))  # rotations and translations have different units
    least = float(np.linalg.eigvalsh(matrix / unit / unit[:, None])[0])
    if least < -SEMIDEFINITE:
        raise ModelError(
            f"{what}: expected a positive semidefinite matrix, got one with a negative eigenvalue (by"
            f" {-least:.3g} of its diagonal)"
        )


def unit_quaternion(Q: Array) -> tuple[Scalar, Array]:
    """Return the scalar >= 0 and the vector (3,) of a rotation matrix's unit quaternion.

    They follow from the row of 4 q q^T with the largest component, as in `rotation.to_quaternion`, so they are accurate
    for half a turn, too. The function also accepts traced numbers.
    """
    x, y, z = np.diag(Q)
    a, b, c = Q[2, 1] - Q[1, 2], Q[0, 2] - Q[2, 0], Q[1, 0] - Q[0, 1]
    d, f, g = Q[1, 0] + Q[0, 1], Q[0, 2] + Q[2, 0], Q[2, 1] + Q[1, 2]
    largest, q = x + y + z, array([1.0 + x + y + z, a, b, c])
    for size, row in (
        (x, [a, 1.0 + x - y - z, d, f]),
        (y, [b, d, 1.0 - x + y - z, g]),
        (z, [c, f, g, 1.0 - x - y + z]),
    ):
        q = select(size > largest, array(row), q)
        largest = maximum(largest, size)
    q = q * (where(q[0] < 0.0, -1.0, 1.0) / sqrt(q @ q))
    return q[0], q[1:]
