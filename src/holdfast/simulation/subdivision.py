"""Steps that are too long for the motion are taken in parts.

How far a step leaves the grasps open before projection is an estimate of its error that costs nothing. Of order
p + 1 in the step h for a scheme of order p, it says how many equal parts the step needs to stay below a limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ClosureError
from holdfast.simulation.instant import Instant
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import Advance, Stepper
from holdfast.spatial.scalar import Array
from holdfast.state import State

MOST_PARTS = 32


@dataclass(frozen=True, eq=False)
class SubdividingStepper:
    """Takes another stepper's steps, those whose drift passes a limit in equal parts; see `Stepper`.

    The controller's memory moves on once a step, as without parts.

    Attributes:
        whole: takes steps and parts.
        limit: of the grasps' position gaps before projection, as far as parts can keep it [m or rad].
    """

    whole: Stepper
    limit: float

    @property
    def scheme(self) -> Tableau:
        """The Runge-Kutta scheme."""
        return self.whole.scheme

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state, projected onto the grasps; see `Stepper`."""
        return self.whole.start(t, state, memory)

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state, taken as it is."""
        return self.whole.evaluate(t, state, memory)

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step leads, in parts where it must be; see `Stepper`."""
        found = [(reached, self._parts(reached)) for reached in self.whole.advance(now, ends)]
        return [one if parts == 1 else in_parts(self.whole, now, one.t, parts) for one, parts in found]

    def _parts(self, reached: Advance) -> int:
        """Return how many parts a step needs."""
        if isinstance(reached.failure, ClosureError):
            return MOST_PARTS
        if reached.failure is not None:
            return 1
        return int(parts_needed(reached.gaps.position[0], self.limit, self.scheme.order))


def parts_needed(drift: ArrayLike, limit: float, order: int) -> Array:
    """Return into how many equal parts steps must go for less drift than a limit, of the drifts' shape.

    Args:
        drift: position gaps that whole steps left before projection [m or rad].
        limit: of the same.
        order: of the scheme.
    """
    return np.ceil(np.clip((np.asarray(drift) / limit) ** (1.0 / (order + 1)), 1, MOST_PARTS)).astype(int)


def in_parts(stepper: Stepper, now: Instant, until: float, parts: int) -> Advance:
    """Return where equal parts of a step lead; the controller's memory moves on once, as in a whole step.

    Args:
        stepper: takes the parts.
        now: the chain at the step's start.
        until: the step's end [s].
        parts: how many, at least one.
    """
    at, done = now, []
    for k in range(1, parts + 1):
        end = until if k == parts else now.t + k / parts * (until - now.t)
        (part,) = stepper.advance(at, [end])
        if part.instant is None:
            return replace(part, t=until)
        at = replace(part.instant, memory=now.memory)
        done.append(part)
    gaps = [np.max([getattr(part.gaps, kind) for part in done], axis=0) for kind in ("position", "velocity")]
    return replace(done[-1], gaps=Gaps(*gaps), work=np.sum([part.work for part in done], axis=0))
