"""Subdivision of fixed steps that are too long for the motion near a singular configuration.

Near a singular configuration, the motion changes within the time in which the strength of the constraint changes by a
multiple of itself, and a step of fixed length may be longer than that. A step that changes the strength by more than a
fiftieth (a thirtieth, if the strength is far from zero) is therefore accepted only if two half steps give the same
result. If they do not, the step is divided into equal parts. Their number is chosen from the order of the scheme, and
they are accepted if twice as many parts give the same result. If no such number is found, an explicit step is taken by
the adaptive scheme instead, and an implicit step is divided into parts of its own scheme that are halved until the
halves of each part give the same result.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from holdfast.errors import HoldfastError, StateError
from holdfast.simulation.adaptive import first_proposal, next_step
from holdfast.simulation.instant import Instant
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.stepper import NO_GAPS, Advance, PartsStepper, Stepper, in_parts, together
from holdfast.spatial.scalar import Array

RTOL_OF_PARTS = 1e-11
MOST_ADAPTIVE_PARTS, MOST_HALVED = 256, 1024
MOST_EQUAL_PARTS = 32
AGREEMENT = 1e-7  # largest accepted difference between a step and its halves, relative to the change of the velocities
AGREEMENT_IMPLICIT = 1e-5  # the same for implicit steps, which are of second order


def agreeing_parts(stepper: Stepper, now: Instant, later: Instant) -> int | None:
    """Return the number of equal parts in which a step has to be taken; None if it would have to be too large.

    The number is 1 if the whole step and its halves give the same result. Otherwise it is an even number of parts that
    give the same result as half as many.

    Args:
        stepper: takes the step and its parts.
        now: the chain at the start of the step.
        later: the chain at the end of the whole step.
    """
    scheme, parts, coarse = stepper.scheme, 1, later
    same = agreement(scheme)
    while coarse is not None and (fine := in_parts(stepper, now, later.t, 2 * parts).instant) is not None:
        off = float(disagreement(coarse.velocities, fine.velocities, now.velocities))
        if off <= same:
            return 1 if parts == 1 else 2 * parts
        if 2 * parts == MOST_EQUAL_PARTS:
            return None
        by_order = parts * min(off / same, 1e12) ** (1.0 / scheme.order)
        more = min(MOST_EQUAL_PARTS // 2, max(2 * parts, math.ceil(by_order)))
        coarse = fine if more == 2 * parts else in_parts(stepper, now, later.t, more).instant
        parts = more
    return None


def agreement(scheme: Tableau) -> float:
    """Return the largest `disagreement` between a step and its halves with which they give the same result."""
    return AGREEMENT_IMPLICIT if scheme.implicit else AGREEMENT


def disagreement(coarse: Array, fine: Array, start: Array) -> Array:
    """Return the difference between two results of a step relative to the change of the velocities.

    Args:
        coarse: (..., n + 6) velocities at the step's end.
        fine: the same, from smaller parts.
        start: velocities at the step's start.
    """
    return np.abs(coarse - fine).max(axis=-1) / np.maximum(np.abs(fine - start).max(axis=-1), 1e-300)


@dataclass(frozen=True, eq=False)
class EqualPartsStepper(PartsStepper):
    """Takes steps in equal parts; see `Stepper`.

    Attributes:
        longest: greatest length of a part [s].
    """

    longest: float

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step leads; see `Stepper`."""
        parts = [max(1, math.ceil((end - now.t) / self.longest * (1 - 1e-9))) for end in ends]
        return [in_parts(self.whole, now, end, count) for end, count in zip(ends, parts, strict=True)]


@dataclass(frozen=True, eq=False)
class AdaptivePartsStepper(PartsStepper):
    """Takes each step in parts chosen by a scheme that estimates its error; see `Stepper`."""

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of steps to the given ends; all of them use the same parts. See `Stepper`."""
        at, proposal, parts = now, first_proposal(now), list[Advance]()
        found: dict[float, Advance] = {}
        for end in sorted(set(ends)):
            try:
                while at.t < end:
                    if len(parts) == MOST_ADAPTIVE_PARTS:
                        raise _too_fast(now, MOST_ADAPTIVE_PARTS)
                    part, proposal = next_step(self.whole, at, proposal, end)
                    assert part.instant is not None
                    at = replace(part.instant, memory=now.memory)  # the memory is updated once per step
                    parts.append(part)
            except HoldfastError as cause:
                found[end] = Advance(end, None, NO_GAPS, np.zeros(4), failure=cause)
            else:
                found[end] = together(parts)
        return [found[end] for end in ends]


@dataclass(frozen=True, eq=False)
class HalvedPartsStepper(PartsStepper):
    """Takes each step in parts that are halved until the halves of each part give the same result; see `Stepper`."""

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step leads; see `Stepper`."""
        return [self._to(now, end) for end in ends]

    def _to(self, now: Instant, end: float) -> Advance:
        at, part, parts = now, end - now.t, list[Advance]()
        for _ in range(MOST_HALVED):
            until = end if part >= (end - at.t) * (1 - 1e-9) else at.t + part
            (whole,), halves = self.whole.advance(at, [until]), in_parts(self.whole, at, until, 2)
            off, same = math.inf, agreement(self.whole.scheme)
            if whole.instant is not None and halves.instant is not None:
                off = float(disagreement(*(x.velocities for x in (whole.instant, halves.instant, at))))
            if not off <= same:
                part *= 0.5
                continue
            assert halves.instant is not None
            at = replace(halves.instant, memory=now.memory)  # the memory is updated once per step
            parts.append(halves)
            if until == end:
                return together(parts)
            if off <= 0.5 ** (self.whole.scheme.order + 1) * same:
                part *= 2.0
        return Advance(end, None, NO_GAPS, np.zeros(4), failure=_too_fast(now, MOST_HALVED))


def _too_fast(now: Instant, parts: int) -> StateError:
    why = f"the motion is too fast for {parts} parts of the step from t = {now.t:.9g} s"
    return StateError(f"{why}; try a smaller time step")
