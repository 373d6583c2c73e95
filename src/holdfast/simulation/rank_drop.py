"""Search for the configuration on a path at which the grasp constraint loses rank.

B = K [J, -A] generically has rank r: B = U S V^T with r positive singular values. From a configuration a to a later one
b, U and V rotate slightly, and the later matrix expressed in the singular vectors of a, U_a^T B_b V_a, is close to S_a.
If B loses rank between them, some singular values pass through zero and change sign, and some eigenvalues mu of
    S_a^-1 U_a^T B_b V_a
become negative. On the straight line from S_a to U_a^T B_b V_a the determinant vanishes at the fraction 1 / (1 - mu),
which is the next point of the search. The singular values themselves have no sign: they show a dip, but not whether it
reaches zero.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.constraint import constraint_rows, coordinate_sizes
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.bracket import search_lowest, together
from holdfast.simulation.verification import DROPS, PLACE
from holdfast.spatial.scalar import Array
from holdfast.state import State

LOST = 1e-5  # singular values smaller than this, relative to the largest, count as zero once the point is located
PRECISION = 1e-10  # precision of the located point
PARTS = (0.43, 0.57)  # fractions at which a path is divided; the second is used if the rank is lost at the first
NEAREST = 0.02  # a new point keeps at least this fraction of the bracket's width from its ends
MOST_TRIES = 60


class ConstraintFactors(NamedTuple):
    """The singular value decomposition of K [J, -A], made dimensionless with the reach of the arms.

    Attributes:
        U: (rows, k) left singular vectors; k is the smaller of the numbers of rows and columns.
        sizes: (k,) singular values relative to the largest, in decreasing order.
        Vt: (k, n + 6) right singular vectors.
    """

    U: Array
    sizes: Array
    Vt: Array

    def weakest(self, rank: int) -> float:
        """Return the singular value number `rank`, the smallest that is not zero in a matrix of that rank."""
        return float(self.sizes[rank - 1])


class RankDrop(NamedTuple):
    """A point on a path at which the constraint loses rank.

    Attributes:
        at: path parameter of the point.
        rank: rank of K [J, -A] at the point.
        through: whether singular values change sign there; otherwise they touch zero and return.
    """

    at: float
    rank: int
    through: bool


def constraint_factors(chain: ClosedChain, state: State) -> ConstraintFactors:
    """Return the factors of the grasp constraint at a configuration. O((n + 6)^3)."""
    motion = chain_at_rest(chain, state)
    sizes, rows = coordinate_sizes(motion), constraint_rows(motion)
    turning = [np.array(c.rows) < 3 for c in motion.contacts]
    lengths = np.where(np.concatenate(turning), sizes[-1], 1.0)
    U, s, Vt = np.linalg.svd(lengths[:, None] * rows.matrix * sizes, full_matrices=False)
    return ConstraintFactors(U, s / s[0], Vt)


Path = Callable[[float], ConstraintFactors]
Known = tuple[float, ConstraintFactors]  # a path parameter, and the factors there


def rank_drop(path: Path, begin: float, end: float, rank: int) -> RankDrop | None:
    """Return the first point on a path at which the constraint loses rank; None if there is none.

    A point is found if singular values pass through zero, or if the smallest one at both ends and in the middle has a
    minimum that reaches zero.

    Args:
        path: returns the factors at a path parameter; some parameters are evaluated repeatedly.
        begin: parameter at the start, a point of full rank.
        end: parameter at the end, another point of full rank.
        rank: generic rank of K [J, -A], at least one.
    """
    inside = [begin + part * (end - begin) for part in PARTS]
    # a point at which the rank is already lost cannot serve as a reference
    middle = next((t for t in inside if path(t).weakest(rank) > LOST), inside[0])
    known = [(t, path(t)) for t in (begin, middle, end)]
    for (a, at_a), (b, at_b) in ((known[0], known[1]), (known[1], known[2])):
        found = _passed(path, (a, at_a), (b, at_b), rank)
        if found is not None:
            return found
    return _touched(path, known, rank)


def _passed(path: Path, a: Known, b: Known, rank: int) -> RankDrop | None:
    """Return the first point between two points at which singular values pass through zero; None if there is none."""
    before, part = np.inf, _part_of_the_way(a[1], b[1], rank)
    for _ in range(MOST_TRIES):
        if part is None:
            return None  # the negative eigenvalue came from a rotation of U and V
        width = b[0] - a[0]
        at = a[0] + min(1.0 - NEAREST, max(NEAREST, part)) * width
        there = path(at)
        if there.weakest(rank) < PRECISION or min(abs(at - before), width) <= PRECISION * max(1.0, abs(at)):
            return RankDrop(at, int((there.sizes[:rank] > LOST).sum()), through=True)
        before, part = at, _part_of_the_way(a[1], there, rank)
        if part is None:
            a, part = (at, there), _part_of_the_way(there, b[1], rank)
        else:
            b = (at, there)
    return None


def _part_of_the_way(a: ConstraintFactors, b: ConstraintFactors, rank: int) -> float | None:
    """Return the estimated fraction of the way at which the first singular value passes through zero, or None."""
    U, Vt = a.U[:, :rank], a.Vt[:rank]
    later = (U.T @ b.U[:, :rank]) @ (b.sizes[:rank, None] * (b.Vt[:rank] @ Vt.T))
    mu = np.linalg.eigvals(later / np.maximum(a.sizes[:rank, None], 1e-300))
    through = mu.real < 0.0
    return float((1.0 / (1.0 - mu.real[through])).min()) if through.any() else None


def _touched(path: Path, known: list[Known], rank: int) -> RankDrop | None:
    """Return the point at which the smallest singular value touches zero; None if it does not."""
    (a, fa), (b, fb), (c, fc) = ((t, f.weakest(rank)) for t, f in known)
    drop = max(fa, fc) - fb
    if not (fb < min(fa, fc) and fb < DROPS * drop):
        return None
    search = search_lowest(a, b, c, PLACE * (c - a))
    ((at, least),) = together([search], lambda points: [path(t).weakest(rank) for t in points.values()])
    return RankDrop(at, int((path(at).sizes[:rank] > LOST).sum()), through=False) if least <= LOST else None
