"""Where the grasp constraint loses rank along a path.

B = K [J, -A] has rank r in general, B = U S V^T with r singular values above zero. On the way from a configuration a
to a later one b, U and V turn a little; in the axes of a the later one is U_a^T B_b V_a, near S_a. Where B loses rank
on the way some singular values pass through zero and come out negative, and so do eigenvalues mu of

    S_a^-1 U_a^T B_b V_a

On the straight line from S_a to U_a^T B_b V_a the determinant vanishes at the part 1 / (1 - mu) of the way: from there
the search goes on. The values themselves, which have no sign, would show a dip and not whether it reaches zero.
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

LOST = 1e-5  # relative singular value at a place that is known to 1e-9 of a second
PRECISION = 1e-10  # of the place
PARTS = (0.43, 0.57)  # of the way: where a path is divided, the second if the first is where it has lost rank
NEAREST = 0.02  # of a bracket: the search comes no nearer to its ends at once
MOST_TRIES = 60


class ConstraintFactors(NamedTuple):
    """The singular value decomposition of K [J, -A], moments and rates measured by the arms' reach.

    Attributes:
        U: (rows, k) left singular vectors, k the smaller of rows and columns.
        sizes: (k,) singular values relative to the largest, in falling order.
        Vt: (k, n + 6) right ones.
    """

    U: Array
    sizes: Array
    Vt: Array

    def weakest(self, rank: int) -> float:
        """Return the last singular value that a matrix of a rank has."""
        return float(self.sizes[rank - 1])


class RankDrop(NamedTuple):
    """Where the constraint loses rank.

    Attributes:
        at: place on the path.
        rank: there, of K [J, -A].
        through: whether singular values change sign there, rather than touch zero.
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


def rank_drop(path: Callable[[float], ConstraintFactors], begin: float, end: float, rank: int) -> RankDrop | None:
    """Return the first place on a path where the constraint loses rank, None if it keeps it.

    Found where singular values pass through zero, or where the least one that is seen at both ends and between comes
    down to zero from both sides.

    Args:
        path: factors by place; asked for some places again.
        begin: its beginning, a place of full rank.
        end: its end, another one.
        rank: of K [J, -A] in general, at least one.
    """
    inside = [begin + part * (end - begin) for part in PARTS]
    # where it happens to have lost rank already nothing can be compared
    middle = next((t for t in inside if path(t).weakest(rank) > LOST), inside[0])
    known = [(t, path(t)) for t in (begin, middle, end)]
    for (a, at_a), (b, at_b) in ((known[0], known[1]), (known[1], known[2])):
        found = _passed(path, (a, at_a), (b, at_b), rank)
        if found is not None:
            return found
    return _touched(path, known, rank)


def _passed(
    path: Callable[[float], ConstraintFactors],
    a: tuple[float, ConstraintFactors],
    b: tuple[float, ConstraintFactors],
    rank: int,
) -> RankDrop | None:
    """Return where singular values pass through zero between two places."""
    before, part = np.inf, _part_of_the_way(a[1], b[1], rank)
    for _ in range(MOST_TRIES):
        if part is None:
            return None  # what looked like it from afar is a turn of U and V
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
    """Return the part of the way at which the first singular value passes through zero, if one seems to."""
    U, Vt = a.U[:, :rank], a.Vt[:rank]
    later = (U.T @ b.U[:, :rank]) @ (b.sizes[:rank, None] * (b.Vt[:rank] @ Vt.T))
    mu = np.linalg.eigvals(later / np.maximum(a.sizes[:rank, None], 1e-300))
    through = mu.real < 0.0
    return float((1.0 / (1.0 - mu.real[through])).min()) if through.any() else None


def _touched(
    path: Callable[[float], ConstraintFactors], known: list[tuple[float, ConstraintFactors]], rank: int
) -> RankDrop | None:
    """Return where the least singular value comes down to zero and goes up again."""
    (a, fa), (b, fb), (c, fc) = ((t, f.weakest(rank)) for t, f in known)
    drop = max(fa, fc) - fb
    if not (fb < min(fa, fc) and fb < DROPS * drop):
        return None
    search = search_lowest(a, b, c, PLACE * (c - a))
    ((at, least),) = together([search], lambda asked: [path(t).weakest(rank) for t in asked.values()])
    return RankDrop(at, int((path(at).sizes[:rank] > LOST).sum()), through=False) if least <= LOST else None
