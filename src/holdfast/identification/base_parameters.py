"""Base parameters: the combinations of inertial parameters that a motion can tell.

A stacked regressor Y of rank r has p - r combinations that no row contains. Its columns are taken one after the other,
the largest that is left first (QR with pivots): r of them are independent, the others are K of these,

    Y pi = Y_1 (pi_1 + K pi_2),   K = R_11^-1 R_12

and pi_1 + K pi_2 are the base parameters (Gautier and Khalil 1990).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import qr, solve_triangular

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

NEGLIGIBLE = 1e-6  # of a combination's largest term, in columns of unit length: what is smaller is rounding


@dataclass(frozen=True, eq=False)
class BaseParameters(Frozen):
    """What the rows of a regressor can tell.

    Attributes:
        names: (p,) of the parameters.
        combinations: (r, p): combinations @ parameters are the base parameters; each has 1 at a parameter of its own.
        absent: names of the parameters that no row contains.
    """

    names: tuple[str, ...]
    combinations: Array
    absent: tuple[str, ...]

    @property
    def rank(self) -> int:
        """r, how many combinations the rows can tell."""
        return len(self.combinations)

    def in_words(self) -> list[str]:
        """Return the combinations, such as `m` or `Ixx - 1 Iyy`."""
        return [combination(row, self.names) for row in self.combinations]

    def __str__(self) -> str:
        """Return the combinations, one a line, and what is absent."""
        lines = [f"{self.rank} of {len(self.names)} parameters or combinations:", *self.in_words()]
        return "\n  ".join(lines) + (f"\nabsent: {', '.join(self.absent)}" if self.absent else "")


def base_parameters(matrix: ArrayLike, names: Sequence[str], tolerance: float = 1e-9) -> BaseParameters:
    """Return which combinations of parameters the rows of a regressor can tell.

    Args:
        matrix: (rows, p) regressors of many samples, one below the other.
        names: (p,) of the parameters.
        tolerance: what is left of a column, of unit length before, counts as nothing below this; so does a column that
            is as much shorter than the longest, in SI units.

    Raises:
        ModelError: no matrix of finite numbers, or not a name a column.
    """
    checks.instance(names, (list, tuple), "base_parameters: names")
    for k, name in enumerate(names):
        checks.instance(name, str, f"base_parameters: names[{k}]")
    Y = checks.numbers(matrix, None, "base_parameters: matrix")
    if Y.ndim != 2 or Y.shape[1] != len(names) or not Y.size:
        raise ModelError(f"base_parameters: matrix: expected shape (rows, {len(names)}) as named, got {Y.shape}")
    tolerance = checks.number(tolerance, "base_parameters: tolerance", above=0.0)
    sizes = np.linalg.norm(Y, axis=0)
    there = sizes > tolerance * sizes.max()
    unit = np.where(there, sizes, 1.0)
    R, order = pivoted(np.where(there, Y, 0.0) / unit)
    pivots = np.abs(np.diag(R))
    rank = int((pivots > tolerance).sum())
    found = np.zeros((rank, len(names)))
    found[:, order[:rank]] = np.eye(rank)
    found[:, order[rank:]] = solve_triangular(R[:rank, :rank], R[:rank, rank:])
    found[np.abs(found) < NEGLIGIBLE * np.abs(found).max(axis=1, initial=0.0, keepdims=True)] = 0.0
    inwards = np.argsort(order[:rank])
    found = (found * (unit[None, :] / unit[order[:rank], None]))[inwards]
    absent = tuple(name for name, seen in zip(names, there, strict=True) if not seen)
    return BaseParameters(tuple(names), found, absent)


def pivoted(matrix: Array) -> tuple[Array, Array]:
    """Return the triangle of a QR decomposition with pivots, and the columns' order. O(rows p^2)."""
    found: Any = qr(matrix, mode="economic", pivoting=True)
    return found[1], found[2]


def combination(weights: Array, names: Sequence[str]) -> str:
    """Return a sum of named terms in words, one of weight 1 first."""
    order = sorted(np.flatnonzero(weights).tolist(), key=lambda k: weights[k] != 1.0)
    first, *others = order
    lead = names[first] if weights[first] == 1.0 else f"{weights[first]:.3g} {names[first]}"
    return lead + "".join(f" {'-' if weights[k] < 0 else '+'} {abs(weights[k]):.3g} {names[k]}" for k in others)
