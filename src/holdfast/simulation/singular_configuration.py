"""Search for singular configurations that a motion passes: inside a step, or just after the last possible step.

A step evaluates the rank of the constraint only at its stages and at its end. A step that is longer than the
neighbourhood of a singular configuration would pass it unnoticed, although the motion could have branched there. If the
constraint is weak enough that it may have lost rank between two accepted instants, the path between them is therefore
searched (`rank_drop`). Along it, positions follow the quintic through both instants. The time of the configuration is
then refined by steps that end closer and closer to it.
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
from holdfast.simulation.occurrence import Occurrence
from holdfast.simulation.rank_drop import ConstraintFactors, RankDrop, constraint_factors, rank_drop
from holdfast.simulation.segment import Segment
from holdfast.simulation.trajectory import Knot, interpolant
from holdfast.state import State

NEARER = 0.75  # fraction of the remaining way to a configuration that one step covers
APPROACHES = 6
CLOSED = 1e-8  # m or rad: largest gap on a path that passes through; larger gaps mean a leap to another branch
CLOSE = 1e-4  # [s]: at this distance, velocities and accelerations give the time of the configuration accurately
# Steps that change the strength by a smaller fraction are short enough.
RESOLVED, RESOLVED_ELSEWHERE = 0.02, 0.033
NEARBY = 0.25  # a configuration counts as near a singular one if its strength is smaller than this
FARTHEST_TURN = 1.0  # rad, or fraction of the reach: a step that moves joints further is too long for any constraint
MOST_IN_A_STEP = 8
PAST = 1e-3  # after a configuration was found, this fraction of the rest of the step is left out of the next search
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
    return _strength(now) + _strength(later) <= STRENGTH_LOST * _moved(
        now.chain, now.state, later.state, later.t - now.t
    )


def may_be_unresolved(previous: Instant | None, now: Instant, later: Instant) -> bool:
    """Return whether a step or its predecessor changes the strength by so much that the step may be too long."""
    before, at, after = (_strength(one) for one in (previous or now, now, later))
    change = abs(after - at) + abs(at - before)
    if change < (RESOLVED if min(at, after) < NEARBY else RESOLVED_ELSEWHERE) * (at + after):
        return False
    return _moved(now.chain, now.state, later.state, later.t - now.t) <= FARTHEST_TURN


def may_lose_rank(now: Instant, until: float) -> bool:
    """Return whether the joints move so far until a time [s] that the constraint may lose rank by then."""
    turned = _moved(now.chain, now.state, _ahead(now)(until), until - now.t)
    return _strength(now) <= STRENGTH_LOST * turned <= STRENGTH_LOST * FARTHEST_TURN


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
    until = now.t + 2.0 * step
    found = _drop(segment, _ahead(now), now.t, until) if may_lose_rank(now, until) else None
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

    def state(t: float) -> State:
        h = t - now.t
        return moved(now.state, h * now.velocities + 0.5 * h**2 * now.accelerations)

    return state


def _drop(segment: Segment, way: Way, begin: float, end: float) -> RankDrop | None:
    """Return the first point of a path at which the constraint loses rank; None if there is none."""
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
    """Return the configuration, with its time refined by steps from `now` that end closer and closer to it."""
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
    # if the grasps were open, loads lost here could not be distinguished from loads that no configuration resists
    lost = lost_at(chain_at_rest(chain, nearby), found.rank, generic - freedoms)
    gap = float(largest_gaps(chain, there, inputs.shaped(chain)).position)
    unique = through and gap <= CLOSED
    return SingularConfiguration(t, found.rank + freedoms, generic, tuple(lost), unique, gap)
