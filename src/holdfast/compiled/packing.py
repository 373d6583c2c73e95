"""Symmetric matrices as the numbers above their diagonals: what stages hand to each other."""

from __future__ import annotations

import numpy as np

from holdfast.spatial.scalar import Array


def upper(S: Array) -> Array:
    """Return the upper triangle of a symmetric matrix, row by row."""
    return S[np.triu_indices(len(S))]


def symmetric(entries: Array, size: int = 6) -> Array:
    """Return the symmetric matrix of its upper triangle."""
    S = np.empty((size, size), dtype=entries.dtype)
    rows, columns = np.triu_indices(size)
    S[rows, columns] = S[columns, rows] = entries
    return S


def upper_count(size: int) -> int:
    """Return how many numbers the upper triangle has."""
    return size * (size + 1) // 2
