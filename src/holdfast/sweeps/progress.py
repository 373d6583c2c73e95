"""The progress of a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from holdfast.names import called
from holdfast.spatial.frozen import Frozen


@called
@dataclass(frozen=True, eq=False)
class Progress(Frozen):
    """The progress of a sweep; as text it is one line.

    Attributes:
        done: number of runs whose results are in the store, including earlier ones.
        count: number of runs of the sweep.
        status_counts: number of runs computed by this call that ended with each status.
        rate: rate of this call [runs/s].
    """

    done: int
    count: int
    status_counts: Mapping[str, int]
    rate: float

    def __str__(self) -> str:
        """Return the number of finished runs, the rate, the remaining time, and the number of runs with each status."""
        left = (
            f", {(self.count - self.done) / self.rate:.0f} s left" if self.rate > 0 and self.done < self.count else ""
        )
        counts = ", ".join(f"{count} {name.lower()}" for name, count in sorted(self.status_counts.items()))
        return f"{self.done} of {self.count} runs, {self.rate:.0f}/s{left}{f'; {counts}' if counts else ''}"
