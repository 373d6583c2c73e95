"""Where a run is: at one accepted instant, with all it can go on from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.instant import Instant
from holdfast.simulation.segment import Segment
from holdfast.simulation.step import Gaps
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class RunState:
    """A run at one accepted instant.

    Attributes:
        segment: the chain and what moves it.
        checkpoint: what the run can go on from.
        now: the instant, `checkpoint.now` evaluated.
        previous: the instant before, `checkpoint.previous` evaluated; None where now begins a smooth stretch.
        gaps: what projection found and left.
        times: (looks,) at which margins were looked at since the instant before [s].
        margins: (looks, signals) then; the last are those of now.
        ended: why the run ends here, if it does.
    """

    segment: Segment
    checkpoint: Checkpoint
    now: Instant
    previous: Instant | None
    gaps: Gaps
    times: Array
    margins: Array
    ended: str | None = None

    def violated(self) -> int | None:
        """Return the signal most below zero, of those that a run does not go on with."""
        acting, now = self.segment.acting, self.margins[-1]
        if not len(acting) or now[acting].min() >= 0.0:
            return None
        return int(acting[np.argmin(now[acting])])
