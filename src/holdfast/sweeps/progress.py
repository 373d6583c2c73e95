"""How far a sweep is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from holdfast.spatial.frozen import Frozen


@dataclass(frozen=True, eq=False)
class Progress(Frozen):
    """How far a sweep is; its text is one line.

    Attributes:
        done: runs whose results are in the store, earlier ones too.
        count: of the sweep.
        fates: of those computed by this call, how many ended with each status.
        rate: of this call [runs/s].
    """

    done: int
    count: int
    fates: Mapping[str, int]
    rate: float

    def __str__(self) -> str:
        """Return how many of how many, how fast, how much longer, and what became of them."""
        left = (
            f", {(self.count - self.done) / self.rate:.0f} s left" if self.rate > 0 and self.done < self.count else ""
        )
        fates = ", ".join(f"{count} {name.lower()}" for name, count in sorted(self.fates.items()))
        return f"{self.done} of {self.count} runs, {self.rate:.0f}/s{left}{f'; {fates}' if fates else ''}"
