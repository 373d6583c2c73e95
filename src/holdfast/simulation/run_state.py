"""The state of a run at one accepted instant, from which it continues."""

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
        segment: the current segment of the run.
        checkpoint: the data from which the run can be continued.
        now: the instant, evaluated from `checkpoint.now`.
        previous: the previous instant, evaluated from `checkpoint.previous`; None if `now` begins a smooth stretch.
        gaps: position and velocity gaps before and after projection.
        times: (k,) times since the previous instant at which the margins were evaluated [s].
        margins: (k, signals) margins at these times; the last row belongs to `now`.
        ended: the reason if the run ends here, otherwise None.
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
        """Return the most negative signal among those at which the run does not simply continue; None if none is."""
        acting, now = self.segment.acting, self.margins[-1]
        if not len(acting) or now[acting].min() >= 0.0:
            return None
        return int(acting[np.argmin(now[acting])])
