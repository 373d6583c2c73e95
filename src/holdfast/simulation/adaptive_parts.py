"""Fixed steps near a singular configuration, taken in parts where they are too long.

There a motion turns within the time in which the constraint's strength changes by its own size, and a step of fixed
length may be longer than that. So where a step changes the strength by more than a fiftieth (or by a thirtieth, where
it is far from zero), it is believed only if its halves lead to the same. Otherwise it is taken in equal parts, as many
as the scheme's order says, if halves of these do; where not even they do, in parts of the adaptive scheme, and an
implicit step in parts of its own scheme, each compared with its halves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from holdfast.errors import HoldfastError, StateError
from holdfast.simulation.adaptive import first_proposal, next_step
from holdfast.simulation.instant import Instant
from holdfast.simulation.stepper import NO_GAPS, Advance, PartsStepper, Stepper, in_parts, together

RTOL = 1e-11
MOST_PARTS, MOST_HALVED = 256, 1024
MOST_EQUAL_PARTS = 32
SAME = 1e-7  # of what velocities change by: halves that lead elsewhere by more show a step that is too long
SAME_IMPLICIT = 1e-5  # the same of implicit steps, which are of second order


def agreeing_parts(stepper: Stepper, now: Instant, later: Instant) -> int | None:
    """Return in how many equal parts a step has to be taken so that it leads to the same in fewer; None: too many.

    One where the step's halves lead to the same; else twice as many parts as lead to the same as these.

    Args:
        stepper: takes step and parts.
        now: the chain at the step's start.
        later: where the whole step leads.
    """
    scheme, parts, coarse = stepper.scheme, 1, later
    same = _same(stepper)
    while coarse is not None and (fine := in_parts(stepper, now, later.t, 2 * parts).instant) is not None:
        off = _difference(coarse, fine) / max(_difference(fine, now), 1e-300)
        if off <= same:
            return 1 if parts == 1 else 2 * parts
        if 2 * parts == MOST_EQUAL_PARTS:
            return None
        by_order = parts * min(off / same, 1e12) ** (1.0 / scheme.order)
        more = min(MOST_EQUAL_PARTS // 2, max(2 * parts, math.ceil(by_order)))
        coarse = fine if more == 2 * parts else in_parts(stepper, now, later.t, more).instant
        parts = more
    return None


def _same(stepper: Stepper) -> float:
    return SAME_IMPLICIT if stepper.scheme.implicit else SAME


def _difference(a: Instant, b: Instant) -> float:
    return float(np.abs(a.velocities - b.velocities).max())


@dataclass(frozen=True, eq=False)
class EqualPartsStepper(PartsStepper):
    """Takes steps in equal parts; see `Stepper`.

    Attributes:
        longest: a part at most [s].
    """

    longest: float

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step leads; see `Stepper`."""
        parts = [max(1, math.ceil((end - now.t) / self.longest * (1 - 1e-9))) for end in ends]
        return [in_parts(self.whole, now, end, count) for end, count in zip(ends, parts, strict=True)]


@dataclass(frozen=True, eq=False)
class AdaptivePartsStepper(PartsStepper):
    """Takes steps in parts of a scheme that estimates its error; see `Stepper`."""

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where a step leads, one way for all its ends; see `Stepper`."""
        at, proposal, parts = now, first_proposal(now), list[Advance]()
        found: dict[float, Advance] = {}
        for end in sorted(set(ends)):
            try:
                while at.t < end:
                    if len(parts) == MOST_PARTS:
                        raise _too_fast(now, MOST_PARTS)
                    part, proposal = next_step(self.whole, at, proposal, end)
                    assert part.instant is not None
                    at = replace(part.instant, memory=now.memory)  # it moves on once
                    parts.append(part)
            except HoldfastError as cause:
                found[end] = Advance(end, None, NO_GAPS, np.zeros(4), failure=cause)
            else:
                found[end] = together(parts)
        return [found[end] for end in ends]


@dataclass(frozen=True, eq=False)
class HalvedPartsStepper(PartsStepper):
    """Takes steps in parts that are halved until halves of them lead to the same; see `Stepper`."""

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step leads; see `Stepper`."""
        return [self._to(now, end) for end in ends]

    def _to(self, now: Instant, end: float) -> Advance:
        at, part, parts = now, end - now.t, list[Advance]()
        for _ in range(MOST_HALVED):
            until = end if part >= (end - at.t) * (1 - 1e-9) else at.t + part
            (whole,), halves = self.whole.advance(at, [until]), in_parts(self.whole, at, until, 2)
            off = math.inf
            if whole.instant is not None and halves.instant is not None:
                off = _difference(whole.instant, halves.instant) / max(_difference(halves.instant, at), 1e-300)
            if not off <= _same(self.whole):
                part *= 0.5
                continue
            assert halves.instant is not None
            at = replace(halves.instant, memory=now.memory)  # it moves on once
            parts.append(halves)
            if until == end:
                return together(parts)
            if off <= 0.5 ** (self.whole.scheme.order + 1) * _same(self.whole):
                part *= 2.0
        return Advance(end, None, NO_GAPS, np.zeros(4), failure=_too_fast(now, MOST_HALVED))


def _too_fast(now: Instant, parts: int) -> StateError:
    why = f"the motion is too fast for {parts} parts of the step from t = {now.t:.9g} s"
    return StateError(f"{why}; try a smaller time step")
