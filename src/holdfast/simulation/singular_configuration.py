"""Singular configurations that a motion passes: found inside a step, or ahead of where no step leads on.

A step knows the constraint's rank at its stages and its end only. One that is longer than a singular configuration
is wide would pass it without notice, from a motion that could have branched there. So the way from each accepted
instant to the next is searched (`rank_drop`), where the constraint is so weak that it might have vanished in between.
Positions follow the quintic through both; the time is then made exact by steps that end ever nearer to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.near_singular import STRENGTH_LOST, chain_strength, lost_at
from holdfast.dynamics.projection import largest_gaps, moved
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.instant import Instant
from holdfast.simulation.rank_drop import ConstraintFactors, RankDrop, constraint_factors, rank_drop
from holdfast.simulation.segment import Segment
from holdfast.simulation.trajectory import Knot, Occurrence, interpolant
from holdfast.state import State

NEARER = 0.75  # of the way to a configuration that a step goes at once
APPROACHES = 6
CLOSED = 1e-8  # m or rad: what a way through is open by at most; one that leaps from a branch to another is more
CLOSE = 1e-4  # [s]: from here the configuration's time follows from velocities and accelerations
# Parts of the strength: steps that change it by less are as good as any.
RESOLVED, RESOLVED_ELSEWHERE = 0.02, 0.033
NEARBY = 0.25  # strength below which a configuration is looked upon as near a singular one
FARTHEST_TURN = 1.0  # rad, or part of the reach: a longer step is too long whatever the constraint
MOST_IN_A_STEP = 8
PAST = 1e-3  # of what is left of a step after a configuration: there the search for another one begins
ALMOST = 0.55  # of a step before a configuration: near enough to its half
HORIZONS = 2.0 ** np.arange(-20, 1)  # of the time in which a joint turns by a radian


@dataclass(frozen=True)
class SingularConfiguration:
    """A configuration on the way of a motion where the constraint loses rank.

    Attributes:
        t: when [s].
        rank: of the constraint there.
        generic_rank: before and after.
        lost: in words, the loads that nothing feels there and the directions that arms have lost.
        unique: whether one motion with continuous velocities leads through: singular values change sign there, and
            the grasps are closed.
        gap: how far the grasps are open on the way that was searched [m or rad].
    """

    t: float
    rank: int
    generic_rank: int
    lost: tuple[str, ...]
    unique: bool
    gap: float

    @property
    def text(self) -> str:
        """What is lost there, in words."""
        rank = f"the grasp constraint has rank {self.rank} there, {self.generic_rank} in general"
        return "; ".join([rank, *self.lost])

    def occurrence(self, what: str) -> Occurrence:
        """Return the log's line: `what` the run does, in words, and the configuration."""
        text = f"{what}: {self.text}"
        return Occurrence(
            self.t, "singular", "grasps", text, rank=self.rank, generic_rank=self.generic_rank, lost=self.lost
        )


Way = Callable[[float], State]


def configurations_passed(segment: Segment, now: Instant, later: Instant) -> Iterator[SingularConfiguration]:
    """Yield the singular configurations between two accepted instants, in order.

    Args:
        segment: the chain and what moves it.
        now: the earlier instant.
        later: the one that a step leads to.
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
    """Return whether joints move so far in a step that the constraint may have lost its rank on the way."""
    return _strength(now) + _strength(later) <= STRENGTH_LOST * _moved(
        now.chain, now.state, later.state, later.t - now.t
    )


def may_be_unresolved(previous: Instant | None, now: Instant, later: Instant) -> bool:
    """Return whether a step near a singular configuration, or its predecessor, changes the strength by much."""
    before, at, after = (_strength(one) for one in (previous or now, now, later))
    change = abs(after - at) + abs(at - before)
    if change < (RESOLVED if min(at, after) < NEARBY else RESOLVED_ELSEWHERE) * (at + after):
        return False
    return _moved(now.chain, now.state, later.state, later.t - now.t) <= FARTHEST_TURN


def may_lose_rank(now: Instant, until: float) -> bool:
    """Return whether joints move so far until a time [s] that the constraint may have lost its rank by then."""
    turned = _moved(now.chain, now.state, _ahead(now)(until), until - now.t)
    return _strength(now) <= STRENGTH_LOST * turned <= STRENGTH_LOST * FARTHEST_TURN


def _strength(at: Instant) -> float:
    return float(chain_strength(np.array(at.result.condition)))


def time_left(segment: Segment, now: Instant, step: float) -> float | None:
    """Return in how many seconds a singular configuration is reached, if within two steps; by accelerations that stay.

    Args:
        segment: the chain and what moves it.
        now: an accepted instant.
        step: the length of the next step [s].
    """
    until = now.t + 2.0 * step
    found = _drop(segment, _ahead(now), now.t, until) if may_lose_rank(now, until) else None
    return None if found is None else found.at - now.t


def goes_through(left: float, step: float) -> bool:
    """Return whether the next step crosses a singular configuration `left` away [s]; others end before it."""
    return left <= ALMOST * step


def length_before(left: float, step: float) -> float:
    """Return the length of a step that ends half a step before a singular configuration, or sooner [s].

    Args:
        left: how long it takes to get to the configuration [s].
        step: a step as long as it may be [s].
    """
    return min(step, left - 0.5 * step)


def length_through(left: float, step: float) -> float:
    """Return the length of a collocation step that has the configuration far from its stages [s]."""
    return 2.0 * left if left > 0.1 * step else 10.0 * left if left > 0.02 * step else step


def configuration_ahead(segment: Segment, now: Instant, until: float) -> SingularConfiguration | None:
    """Return the singular configuration that a motion is heading for, if it is reached about when steps begin to fail.

    Args:
        segment: the chain and what moves it.
        now: the last accepted instant.
        until: where a step from there has failed to go [s].
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
    """Return how far joints or the object have turned, or joints slid, in h seconds [rad, or the arms' reach]."""
    joints = b.q - a.q
    if not all(joint.turns for joint in chain.all_joints):
        joints = joints / coordinate_sizes(chain_at_rest(chain, a))[: len(joints)]
    turned = h * np.abs([V[:3] for at in (a, b) for V in (at.object_twist, at.base_twist) if V is not None])
    return float(max(np.abs(joints).max(initial=0.0), turned.max()))


def _ahead(now: Instant) -> Way:
    """Return the motion with the accelerations of an instant, as a function of time."""

    def state(t: float) -> State:
        h = t - now.t
        return moved(now.state, h * now.velocities + 0.5 * h**2 * now.accelerations)

    return state


def _drop(segment: Segment, way: Way, begin: float, end: float) -> RankDrop | None:
    """Return where the constraint loses rank on a way."""
    environment = segment.environment

    @cache
    def factors(t: float) -> ConstraintFactors:
        return constraint_factors(environment.chain_at(min(t, segment.settings.end)), way(t))

    rank = segment.generic_rank - environment.chain.contact_freedom_count
    try:
        return rank_drop(factors, begin, end, rank) if rank > 0 else None
    except np.linalg.LinAlgError:  # the motion has diverged
        return None


def _located(segment: Segment, now: Instant, found: RankDrop, way: Way) -> SingularConfiguration:
    """Return the configuration, its time made exact by steps from `now` that come nearer and nearer."""
    at, t, through, nearby = now, float(found.at), found.through, way(found.at)
    for _ in range(APPROACHES if through else 0):
        if t - at.t < CLOSE:
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
    # beside the grasps what is lost there could not be told from what is never felt
    lost = lost_at(chain_at_rest(chain, nearby), found.rank, generic - freedoms)
    gap = float(largest_gaps(chain, there, inputs.shaped(chain)).position)
    unique = through and gap <= CLOSED
    return SingularConfiguration(t, found.rank + freedoms, generic, tuple(lost), unique, gap)
