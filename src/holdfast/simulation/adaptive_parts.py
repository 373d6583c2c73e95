"""Fixed steps near a singular posture, taken in parts whose errors are estimated.

There a motion turns within the time in which the constraint's strength changes by its own size, and a step of fixed
length may be longer than that. So where a step changes the strength by more than a fiftieth (or by a thirtieth, where
it is far from zero), it is believed only if its halves lead to the same, and otherwise taken in parts of the adaptive
scheme.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from holdfast.errors import HoldfastError, StateError
from holdfast.simulation.adaptive import Tolerance, first_proposal, next_step
from holdfast.simulation.instant import Instant
from holdfast.simulation.runge_kutta import dop853
from holdfast.simulation.stepper import NO_GAPS, Advance, ReferenceStepper, Stepper, in_parts, together

RTOL = 1e-11
MOST_PARTS = 256
SAME = 1e-7  # of what velocities change by: halves that lead elsewhere by more show a step that is too long


def halves_agree(stepper: Stepper, now: Instant, later: Instant) -> bool:
    """Return whether a step in halves ends with the same velocities."""
    halves = in_parts(stepper, now, later.t, 2).instant
    if halves is None:
        return False
    off, change = (np.abs(at.velocities - halves.velocities).max() for at in (later, now))
    return bool(off <= SAME * change)


@dataclass(frozen=True, eq=False)
class AdaptivePartsStepper(ReferenceStepper):
    """Takes steps in parts of the adaptive scheme, on floats; see `Stepper`."""

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where a step leads, one way for all its ends; see `Stepper`."""
        adaptive = ReferenceStepper(self.environment, self.controller, self.generic_rank, dop853(), Tolerance(RTOL))
        at, proposal, parts = now, first_proposal(now), list[Advance]()
        found: dict[float, Advance] = {}
        for end in sorted(set(ends)):
            try:
                while at.t < end:
                    if len(parts) == MOST_PARTS:
                        why = f"the motion is too fast for {MOST_PARTS} parts of the step from t = {now.t:.9g} s"
                        raise StateError(f"{why}; try a smaller time step")
                    part, proposal = next_step(adaptive, at, proposal, end)
                    assert part.instant is not None
                    at = replace(part.instant, memory=now.memory)  # it moves on once
                    parts.append(part)
            except HoldfastError as cause:
                found[end] = Advance(end, None, NO_GAPS, np.zeros(4), failure=cause)
            else:
                found[end] = together(parts)
        return [found[end] for end in ends]
