"""Search for singular configurations that a motion passes: inside a step, or just after the last possible step.

A step evaluates the rank of the constraint only at its stages and at its end. A step that is longer than the
neighbourhood of a singular configuration would pass it unnoticed, although the motion could have branched there. If the
constraint is weak enough that it may have lost rank between two accepted instants, the path between them is therefore
searched (`rank_drop`). Along it, positions follow the quintic through both instants. The time of the configuration is
then refined by steps that end closer and closer to it.

B = K [J, -A] generically has rank r: B = U S V^T with r positive singular values. From a configuration a to a later one
b, U and V rotate slightly, and the later matrix expressed in the singular vectors of a, U_a^T B_b V_a, is close to S_a.
If B loses rank between them, some singular values pass through zero and change sign, and some eigenvalues mu of
    S_a^-1 U_a^T B_b V_a
become negative. On the straight line from S_a to U_a^T B_b V_a the determinant vanishes at the fraction 1 / (1 - mu),
which is the next point of the search. The singular values themselves have no sign: they show a dip, but not whether it
reaches zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.near_singular import STRENGTH_LOST, chain_strength, lost_at
from holdfast.dynamics.projection import largest_gaps, moved
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.bracket import search_lowest, together
from holdfast.simulation.events import Occurrence
from holdfast.simulation.instant import Instant
from holdfast.simulation.interpolant import Knot, interpolant
from holdfast.simulation.segment import Segment
from holdfast.simulation.verification import DROPS, TIME_OF_MINIMUM
from holdfast.spatial.scalar import Array
from holdfast.state import State

LOST_VALUE = 1e-5  # singular values smaller than this, relative to the largest, count as zero once the point is located
LOCATED = 1e-10  # precision of the located point
DIVISIONS = (0.43, 0.57)  # fractions at which a path is divided; the second is used if the rank is lost at the first
NEAREST = 0.02  # a new point keeps at least this fraction of the bracket's width from its ends
MOST_DIVISIONS = 60
NEARER = 0.75  # fraction of the remaining way to a configuration that one step covers
APPROACHES = 6
CLOSED_PATH = 1e-8  # m or rad: largest gap on a path that passes through; larger gaps mean a leap to another branch
CLOSE_IN_TIME = 1e-4  # [s]: from here, velocities and accelerations give the time of the configuration accurately
# Steps that change the strength by a smaller fraction are short enough.
RESOLVED_CHANGE, RESOLVED_CHANGE_ELSEWHERE = 0.02, 0.033
NEARBY = 0.25  # a configuration counts as near a singular one if its strength is smaller than this
LARGEST_MOTION = 1.0  # rad, or fraction of the reach: a step that moves joints further is too long for any constraint
MOST_IN_A_STEP = 8
PAST = 1e-3  # after a configuration was found, this fraction of the rest of the step is left out of the next search
SHORTENED_WITHIN = 1.5  # a fixed step that begins so many steps before a configuration, or fewer, is shortened
ALMOST = 0.55  # a step crosses a configuration that is nearer than this fraction of a step
HORIZONS = 2.0 ** np.arange(-20, 1)  # in units of the time in which a joint turns by one radian


@dataclass(frozen=True)
class SingularConfiguration:
    """A configuration during a motion at which the constraint loses rank.

    Attributes:
        t: time [s].
        rank: rank of the constraint at this configuration.
        generic_rank: rank of the constraint before and after.
        lost: in words, the loads that the joints do not feel there, and the directions that arms have lost.
        unique: whether exactly one motion with continuous velocities leads through. This holds if singular values
            change sign and the grasps are closed.
        gap: how far the grasps are open at this point of the searched path [m or rad].
    """

    t: float
    rank: int
    generic_rank: int
    lost: tuple[str, ...]
    unique: bool
    gap: float

    @property
    def text(self) -> str:
        """Description of the loss of rank."""
        rank = f"the grasp constraint has rank {self.rank} there, {self.generic_rank} in general"
        return "; ".join([rank, *self.lost])

    def occurrence(self, what: str) -> Occurrence:
        """Return the log entry, which consists of `what` the run does there, in words, and the description."""
        text = f"{what}: {self.text}"
        return Occurrence(
            self.t, "singular", "grasps", text, rank=self.rank, generic_rank=self.generic_rank, lost=self.lost
        )


Way = Callable[[float], State]


def configurations_passed(segment: Segment, now: Instant, later: Instant) -> Iterator[SingularConfiguration]:
    """Yield the singular configurations between two accepted instants, in order.

    Args:
        segment: the current segment of the run.
        now: the earlier instant.
        later: the instant after the step.
    """
    if not may_have_lost_rank(now, later):
        return
    way = interpolant(*(Knot(at.t, at.state, at.accelerations) for at in (now, later)))
    begin = now.t
    for _ in range(MOST_IN_A_STEP):
        drop = _drop(segment, way, begin, later.t)
        if drop is None:
            return
        yield _located(segment, now, drop, way)
        begin = drop.at + PAST * (later.t - drop.at)


def may_have_lost_rank(now: Instant, later: Instant) -> bool:
    """Return whether the joints move so far in a step that the constraint may have lost rank during it."""
    return bool(may_lose(_strength(now) + _strength(later), _moved(now.chain, now.state, later.state, later.t - now.t)))


def may_be_unresolved(previous: Instant | None, now: Instant, later: Instant) -> bool:
    """Return whether a step or its predecessor changes the strength by so much that the step may be too long."""
    if not changes_much(*(_strength(one) for one in (previous or now, now, later))):
        return False
    return _moved(now.chain, now.state, later.state, later.t - now.t) <= LARGEST_MOTION


def may_lose_rank(now: Instant, until: float) -> bool:
    """Return whether the joints move so far until a time [s] that the constraint may lose rank by then."""
    return _may_lose_on(_ahead(now), now, until)


def _may_lose_on(way: Way, now: Instant, until: float) -> bool:
    turned = _moved(now.chain, now.state, way(until), until - now.t)
    return bool(may_lose(_strength(now), turned)) and turned <= LARGEST_MOTION


def may_lose(strength: Array | float, moved: Array | float) -> Array | bool:
    """Return whether a motion of given size may use up a strength, or the sum of those at its ends."""
    return strength <= STRENGTH_LOST * moved


def changes_much(before: Array | float, at: Array | float, after: Array | float) -> Array:
    """Return whether the strengths at the ends of two steps differ so much that the steps may be too long."""
    share = np.where(np.minimum(at, after) < NEARBY, RESOLVED_CHANGE, RESOLVED_CHANGE_ELSEWHERE)
    return abs(after - at) + abs(at - before) >= share * (at + after)


def _strength(at: Instant) -> float:
    return float(chain_strength(np.array(at.result.condition)))


def time_left(segment: Segment, now: Instant, step: float) -> float | None:
    """Return the time until a singular configuration is reached, if it is at most two steps; otherwise None.

    The motion is extrapolated with constant accelerations.

    Args:
        segment: the current segment of the run.
        now: an accepted instant.
        step: the length of the next step [s].
    """
    until, way = now.t + 2.0 * step, _ahead(now)
    found = _drop(segment, way, now.t, until) if _may_lose_on(way, now, until) else None
    return None if found is None else found.at - now.t


def length_through(left: float, step: float) -> float:
    """Return the length of a collocation step whose stages are far from the configuration [s]."""
    return 2.0 * left if left > 0.1 * step else 10.0 * left if left > 0.02 * step else step


def configuration_ahead(segment: Segment, now: Instant, until: float) -> SingularConfiguration | None:
    """Return the singular configuration ahead of a motion, if it is reached at about the time at which a step failed.

    Args:
        segment: the current segment of the run.
        now: the last accepted instant.
        until: end of the step that failed [s].
    """
    rate, way = float(np.abs(now.velocities).max()), _ahead(now)  # [rad/s or m/s]
    for horizon in HORIZONS / rate if rate > 0.0 else ():
        found = _drop(segment, way, now.t, now.t + horizon)
        if found is not None:
            return _located(segment, now, found, way)
        if horizon > until - now.t:
            return None
    return None


def _moved(chain: ClosedChain, a: State, b: State, h: float) -> float:
    """Return the largest motion in h seconds, of rotations [rad] and sliding joints [per reach of the arms]."""
    joints = b.q - a.q
    if not all(joint.turns for joint in chain.all_joints):
        joints = joints / coordinate_sizes(chain_at_rest(chain, a))[: len(joints)]
    turned = h * np.abs([V[:3] for at in (a, b) for V in (at.object_twist, at.base_twist) if V is not None])
    return float(max(np.abs(joints).max(initial=0.0), turned.max()))


def _ahead(now: Instant) -> Way:
    """Return the motion with constant accelerations, those of an instant, as a function of time."""

    @cache
    def state(t: float) -> State:
        h = t - now.t
        return moved(now.state, h * now.velocities + 0.5 * h**2 * now.accelerations)

    return state


def _drop(segment: Segment, way: Way, begin: float, end: float) -> RankDrop | None:
    """Return the first point of a path at which the constraint loses rank; None if there is none."""
    known: dict[float, ConstraintFactors] = {}

    def factors(t: float) -> ConstraintFactors:
        if t not in known:
            times = [t] if known else list(dict.fromkeys([begin, t, end]))  # those are needed in any case
            rows = segment.stepper.constraint([min(t, segment.settings.end) for t in times], [way(t) for t in times])
            known.update(zip(times, constraint_factors(rows), strict=True))
        return known[t]

    rank = segment.generic_rank - segment.environment.chain.contact_freedom_count
    try:
        return rank_drop(factors, begin, end, rank) if rank > 0 else None
    except np.linalg.LinAlgError:  # the motion has diverged
        return None


def _located(segment: Segment, now: Instant, found: RankDrop, way: Way) -> SingularConfiguration:
    """Return the configuration, with its time refined by steps from `now` that end closer and closer to it."""
    at, t, through, nearby = now, float(found.at), found.through, way(found.at)
    for _ in range(APPROACHES if through else 0):
        if t - at.t < CLOSE_IN_TIME:
            break
        (reached,) = segment.stepper.advance(at, [at.t + NEARER * (t - at.t)])
        if reached.instant is None:
            break
        nearer = replace(reached.instant, memory=now.memory)
        again = _drop(segment, _ahead(nearer), nearer.t, nearer.t + 2.0 * (t - nearer.t))
        if again is None:
            break
        at, t, found, way, nearby = nearer, float(again.at), again, _ahead(nearer), nearer.state
    there = way(t)
    chain, inputs = segment.environment.at(min(t, segment.settings.end), there)
    generic, freedoms = segment.generic_rank, chain.contact_freedom_count
    # if the grasps were open, loads lost here could not be distinguished from loads that no configuration resists
    lost = lost_at(chain_at_rest(chain, nearby), found.rank, generic - freedoms)
    gap = float(largest_gaps(chain, there, inputs.shaped(chain)).position)
    unique = through and gap <= CLOSED_PATH
    return SingularConfiguration(t, found.rank + freedoms, generic, tuple(lost), unique, gap)


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


def constraint_factors(rows: Array) -> list[ConstraintFactors]:
    """Return the factors of the grasp constraint at several configurations, from `constraint.dimensionless_rows`."""
    U, s, Vt = np.linalg.svd(rows, full_matrices=False)
    return [ConstraintFactors(*one) for one in zip(U, s / s[:, :1], Vt, strict=True)]


FactorsOnPath = Callable[[float], ConstraintFactors]
KnownFactors = tuple[float, ConstraintFactors]  # a path parameter, and the factors there


def rank_drop(path: FactorsOnPath, begin: float, end: float, rank: int) -> RankDrop | None:
    """Return the first point on a path at which the constraint loses rank; None if there is none.

    A point is found if singular values pass through zero, or if the smallest one at both ends and in the middle has a
    minimum that reaches zero.

    Args:
        path: returns the factors at a path parameter; some parameters are evaluated repeatedly.
        begin: parameter at the start, a point of full rank.
        end: parameter at the end, another point of full rank.
        rank: generic rank of K [J, -A], at least one.
    """
    inside = [begin + part * (end - begin) for part in DIVISIONS]
    # a point at which the rank is already lost cannot serve as a reference
    middle = next((t for t in inside if path(t).weakest(rank) > LOST_VALUE), inside[0])
    known = [(t, path(t)) for t in (begin, middle, end)]
    for (a, at_a), (b, at_b) in ((known[0], known[1]), (known[1], known[2])):
        found = _passed(path, (a, at_a), (b, at_b), rank)
        if found is not None:
            return found
    return _touched(path, known, rank)


def _passed(path: FactorsOnPath, a: KnownFactors, b: KnownFactors, rank: int) -> RankDrop | None:
    """Return the first point between two points at which singular values pass through zero; None if there is none."""
    before, part = np.inf, _part_of_the_way(a[1], b[1], rank)
    for _ in range(MOST_DIVISIONS):
        if part is None:
            return None  # the negative eigenvalue came from a rotation of U and V
        width = b[0] - a[0]
        at = a[0] + min(1.0 - NEAREST, max(NEAREST, part)) * width
        there = path(at)
        if there.weakest(rank) < LOCATED or min(abs(at - before), width) <= LOCATED * max(1.0, abs(at)):
            return RankDrop(at, int((there.sizes[:rank] > LOST_VALUE).sum()), through=True)
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


def _touched(path: FactorsOnPath, known: list[KnownFactors], rank: int) -> RankDrop | None:
    """Return the point at which the smallest singular value touches zero; None if it does not."""
    (a, fa), (b, fb), (c, fc) = ((t, f.weakest(rank)) for t, f in known)
    drop = max(fa, fc) - fb
    if not (fb < min(fa, fc) and fb < DROPS * drop):
        return None
    search = search_lowest(a, b, c, TIME_OF_MINIMUM * (c - a))
    ((at, least),) = together([search], lambda points: [path(t).weakest(rank) for t in points.values()])
    return RankDrop(at, int((path(at).sizes[:rank] > LOST_VALUE).sum()), through=False) if least <= LOST_VALUE else None
