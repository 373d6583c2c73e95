"""The stiffness and damping of a bushing, a compliant grasp that exerts a force instead of imposing a constraint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.motion_subspace import MatrixRows, rows_of
from holdfast.spatial.scalar import Array

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
