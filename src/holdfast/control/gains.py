"""Matrices of stiffness, damping and inertia."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial.scalar import Array

SYMMETRIC = 1e-9  # largest asymmetry and negative eigenvalue of a matrix that count as rounding, relative to its size


def gain_matrix(given: ArrayLike, what: str, definite: bool = False) -> Array:
    """Return a symmetric positive semidefinite (6, 6) matrix from one, its diagonal, or one number for all.

    Raises:
        ModelError: it is none, or has an eigenvalue below zero (with `definite`, one that is zero).
    """
    x = checks.numbers(given, None, what)
    if x.shape not in ((), (6,), (6, 6)):
        raise ModelError(f"{what}: expected a number, (6,) or (6, 6), got shape {x.shape}")
    matrix = x if x.ndim == 2 else np.diag(np.full(6, x))
    size = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > SYMMETRIC * size:
        raise ModelError(f"{what}: expected a symmetric matrix, got {checks.short(matrix.tolist())}")
    least = float(np.linalg.eigvalsh(matrix)[0])
    if least < -SYMMETRIC * size or (definite and least <= 0.0):
        wanted = "definite" if definite else "semidefinite"
        raise ModelError(f"{what}: expected a positive {wanted} matrix, got one with the eigenvalue {least:.3g}")
    return checks.read_only(matrix)


def require_stable(what: str, product: str, value: float, most: float, why: str) -> None:
    """Refuse a gain with which a sampled loop is not stable.

    Raises:
        ModelError: the value is not below the largest.
    """
    if not value < most:
        raise ModelError(
            f"{what}: expected {product} < {most:g}, the limit of stability {why}, got {value:.4g}; try a lower gain or"
            " a shorter sample time"
        )
