"""Base parameters: the combinations of inertial parameters that a motion can identify, and those that it cannot.

A stacked regressor Y with p columns and rank r leaves p - r combinations of parameters undetermined. A QR decomposition
with column pivoting chooses r independent columns; the others are linear combinations of these,

    Y pi = Y_1 (pi_1 + K pi_2),   K = R_11^-1 R_12

and pi_1 + K pi_2 are the base parameters (Gautier and Khalil 1990). In the same way, the combinations of unknowns that
an estimate takes from the guess are put in words.
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
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.linalg import without_overflow
from holdfast.spatial.scalar import Array

NEGLIGIBLE = 1e-6  # terms smaller than this, relative to a combination's largest one, are rounding (unit columns)
WHOLLY, PARTLY = 0.99, 1e-8  # squared share of an unknown in the fixed combinations above which it is so from the guess
ALONE = 0.05  # terms smaller than this, relative to a combination's largest one, are not named


@called
@dataclass(frozen=True, eq=False)
class BaseParameters(Frozen):
    """The combinations of parameters that a regressor can identify.

    Attributes:
        names: (p,) names of the parameters.
        combinations: (r, p); the base parameters are combinations @ parameters. In each combination, a parameter that
            is in no other one has the weight 1.
        absent: names of the parameters on which no row depends.
    """

    names: tuple[str, ...]
    combinations: Array
    absent: tuple[str, ...]

    @property
    def rank(self) -> int:
        """r, the number of identifiable combinations."""
        return len(self.combinations)

    def in_words(self) -> list[str]:
        """Return the combinations as text, such as `m` or `Ixx - 1 Iyy`."""
        return [combination(row, self.names) for row in self.combinations]

    def __str__(self) -> str:
        """Return the combinations, one per line, and the absent parameters."""
        lines = [f"{self.rank} of {len(self.names)} parameters or combinations:", *self.in_words()]
        return "\n  ".join(lines) + (f"\nabsent: {', '.join(self.absent)}" if self.absent else "")


def base_parameters(matrix: ArrayLike, names: Sequence[str], tolerance: float = 1e-9) -> BaseParameters:
    """Return the combinations of parameters that a regressor can identify.

    Args:
        matrix: (rows, p) regressors of many samples, one below the other.
        names: (p,) names of the parameters.
        tolerance: a column, scaled to unit length, is dependent on others if its pivot is below this; a column is
            treated as zero if its length, relative to that of the longest column in SI units, is below this.

    Raises:
        ModelError: it is not a matrix of finite numbers, or the number of names is not that of the columns.
    """
    checks.instance(names, (list, tuple), "base_parameters: names")
    for k, name in enumerate(names):
        checks.instance(name, str, f"base_parameters: names[{k}]")
    Y = checks.numbers(matrix, None, "base_parameters: matrix")
    if Y.ndim != 2 or Y.shape[1] != len(names) or not Y.size:
        raise ModelError(f"base_parameters: matrix: expected shape (rows, {len(names)}) as named, got {Y.shape}")
    tolerance = checks.number(tolerance, "base_parameters: tolerance", above=0.0)
    Y = without_overflow(Y)
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
    """Return the triangular factor of a QR decomposition with column pivoting, and the columns' order. O(rows p^2)."""
    found: Any = qr(matrix, mode="economic", pivoting=True)
    return found[1], found[2]


def combination(weights: Array, names: Sequence[str]) -> str:
    """Return a weighted sum of names as text, with a term of weight 1 first."""
    order = sorted(np.flatnonzero(weights).tolist(), key=lambda k: weights[k] != 1.0)
    first, *others = order
    lead = names[first] if weights[first] == 1.0 else f"{weights[first]:.3g} {names[first]}"
    return lead + "".join(f" {'-' if weights[k] < 0 else '+'} {abs(weights[k]):.3g} {names[k]}" for k in others)


def parts_kept(fixed: Array) -> tuple[Array, Array]:
    """Return which unknowns keep the guess's value entirely, and which partly, (p,) each."""
    part = (fixed**2).sum(axis=1)
    return part > WHOLLY, (part > PARTLY) & (part <= WHOLLY)


def pivot_directions(null: Array) -> list[tuple[int, Array]]:
    """Return a basis of directions in which each has a pivot k of its own, 1 there and 0 in the others: (k, (p,)).

    Args:
        null: (p, d) an orthonormal basis of the same directions.
    """
    if not null.shape[1]:
        return []
    pivots = np.sort(pivoted(null.T)[1][: null.shape[1]])
    return list(zip(pivots.tolist(), (null @ np.linalg.inv(null[pivots])).T, strict=True))


def sentences(fixed: Array, names: Sequence[str], sizes: Array) -> tuple[str, ...]:
    """Return a sentence for each combination that cannot be identified.

    Args:
        fixed: (p, d) an orthonormal basis of these combinations, with unknowns scaled by their sizes.
        names: (p,) names of the unknowns.
        sizes: (p,) their sizes.
    """
    alone, together = [], []
    for k, direction in pivot_directions(fixed):
        others = [j for j in np.flatnonzero(np.abs(direction) > ALONE).tolist() if j != k]
        if not others:
            alone.append(names[k])
            continue
        weights = np.zeros(len(direction))
        weights[others] = (direction * sizes[k] / sizes)[others]
        weights[k] = 1.0
        together.append(f"the combination {combination(weights, names)} is not identifiable")
    lead = (f"cannot be told from noise: {', '.join(alone)}",) if alone else ()
    return (*lead, *together)
