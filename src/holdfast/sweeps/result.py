"""The result of a sweep: summaries, which read one column at a time, and repetition of any run."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.errors import ResultError, StateError
from holdfast.io.store import UNREADABLE, Damage, advising, stored
from holdfast.model import checks
from holdfast.names import called
from holdfast.simulation.rollout.arguments import whole_number
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.real_numbers import numbers
from holdfast.spatial.scalar import Array
from holdfast.sweeps.chunk import parquet_modules
from holdfast.sweeps.plan import Plan
from holdfast.sweeps.store import SWEEP

OWN_COLUMNS = ("run", "status", "stopped [s]")
LARGEST_TABLE = 2**23  # most numbers in memory at a time


@called
class Sweep:
    """The result of a sweep; created by `sweep`.

    Files are read chunk by chunk, and only the requested columns. At its first use a file is compared with its digest,
    which reads all of it.

    Attributes:
        plan: initial values and parameters of the runs.
        folder: the folder of the sweep.
    """

    def __init__(
        self, plan: Plan, folder: Path, files: Mapping[str, str | None], differing: Sequence[str] = ()
    ) -> None:
        self.plan, self.folder, self._files = plan, folder, dict(files)
        self._differing, self._checked = differing, set[int]()

    def __len__(self) -> int:
        return self.plan.count

    def __repr__(self) -> str:
        """Return the number and duration of the runs, and the folder, on one line."""
        plan = self.plan
        return f"<Sweep of {plan.count} runs of {plan.duration:g} s in {plan.chunk_count} files of '{self.folder}'>"

    @property
    def columns(self) -> list[str]:
        """The titles of the columns: the run, its end, the drawn values, and the outputs with their units."""
        _, parquet = parquet_modules()
        return self._read(0, lambda path: parquet.read_schema(path).names)

    @property
    def status_counts(self) -> dict[str, int]:
        """Number of runs that ended with each status, by the name of the status."""
        found: Counter[str] = Counter()
        for part in self.batches(["status"]):
            found.update(part["status"].tolist())
        return dict(found)

    def batches(self, columns: Sequence[str]) -> Iterator[dict[str, Array]]:
        """Yield columns by title, chunk by chunk in the order of the runs.

        Args:
            columns: titles of the columns.

        Raises:
            StateError: there is no such column.
            ResultError: a file cannot be read.
        """
        _, parquet = parquet_modules()
        known = self.columns
        for title in columns:
            if title not in known:
                raise StateError(f"sweep: no column '{title}'.{checks.did_you_mean(str(title), known)}")

        def read(path: Path) -> dict[str, Array]:
            table = parquet.ParquetFile(path).read(columns=list(columns))
            return {title: table[title].to_numpy() for title in columns}

        for k in range(self.plan.chunk_count):
            yield self._read(k, read)

    def column(self, title: str, status: str | None = None) -> Array:
        """Return one column of all runs, or of those that ended with a status; O(runs) memory.

        Args:
            title: title of the column.
            status: a name of `RolloutStatus`; None for all.

        Raises:
            StateError: there is no such column.
            ResultError: a file cannot be read.
        """
        wanted = [title] if status is None or title == "status" else [title, "status"]
        parts = self.batches(wanted)
        if status is None:
            return np.concatenate([part[title] for part in parts])
        return np.concatenate([part[title][part["status"] == status] for part in parts])

    def quantiles(self, title: str, levels: Any = (0.0, 0.05, 0.5, 0.95, 1.0), status: str | None = "RUNNING") -> Array:
        """Return quantiles of a column, (levels,).

        Args:
            title: title of a column of numbers.
            levels: levels from 0 to 1.
            status: status of the runs to include; None for all.

        Raises:
            StateError: there is no such column, it has no numbers, a level is invalid, or there are no such runs.
            ResultError: a file cannot be read.
        """
        at = _levels(levels)
        x = self._numbers(self.column(title, status), title)
        if len(x) == 0:
            raise StateError(
                f"quantiles: expected runs that ended as {status}, got none; there are {self.status_counts}"
            )
        return np.quantile(x, at, method="inverted_cdf")

    def table(self, levels: Any = (0.0, 0.05, 0.5, 0.95, 1.0), status: str | None = "RUNNING") -> dict[str, Array]:
        """Return the quantiles, (levels,), of every column of final values, by title; empty if there are no such runs.

        Args:
            levels: levels from 0 to 1.
            status: status of the runs to include; None for all.

        Raises:
            StateError: a level is invalid.
            ResultError: a file cannot be read.
        """
        at, found = _levels(levels), {}
        titles = [title for title in self.columns if title not in OWN_COLUMNS and not title.startswith("drawn ")]
        together = max(1, LARGEST_TABLE // len(self))
        for k in range(0, len(titles), together):
            some = titles[k : k + together]
            parts = [
                {title: part[title][(part["status"] == status) | (status is None)] for title in some}
                for part in self.batches([*some, "status"])
            ]
            for title in some:
                x = np.concatenate([part[title] for part in parts])
                if len(x) and x.dtype.kind in "fi":
                    found[title] = np.quantile(x, at, method="inverted_cdf")
        return found

    def worst(self, title: str, count: int = 10, *, largest: bool = False) -> list[tuple[int, float]]:
        """Return pairs (run, entry) of the runs with the smallest entries of a column, in ascending order.

        Args:
            title: title of a column of numbers.
            count: number of runs.
            largest: return the largest entries instead, in descending order.

        Raises:
            StateError: there is no such column, or it has no numbers.
            ResultError: a file cannot be read.
        """
        most, sign = whole_number("count", count), -1.0 if largest else 1.0
        runs, entries = np.zeros(0, dtype=int), np.zeros(0)
        for part in self.batches(["run"] if title == "run" else ["run", title]):
            runs = np.concatenate([runs, part["run"]])
            entries = np.concatenate([entries, self._numbers(part[title], title)])
            first = np.argsort(sign * entries, kind="stable")[:most]
            runs, entries = runs[first], entries[first]
        return list(zip(runs.tolist(), entries.tolist(), strict=True))

    def run(self, number: int, every: int = 1) -> Trajectory:
        """Return one run with everything that `simulate` records; its steps are repeated with identical bits.

        Args:
            number: number of the run, from 0.
            every: number of steps between two samples.

        Raises:
            StateError: there is no such run, or its first state is invalid.
            ResultError: another installation made the sweep, so that its bits cannot be repeated.
        """
        plan = self.plan
        if self._differing:
            raise ResultError(
                f"run: its steps cannot be repeated with identical bits, since {', '.join(self._differing)} differ; try"
                " the installation that made the sweep"
            )
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 0 <= number < plan.count:
            raise StateError(f"run: expected a number from 0 to {plan.count - 1}, got {checks.short(number)}")
        begin, end = plan.bounds(int(number) // plan.chunk)
        # all runs of the chunk, because constraint rows are chosen for them together
        systems = plan.rollout.start(**plan.rows(begin, end))
        one = systems.copy([int(number) - begin])
        record = plan.rollout.run(one, plan.duration, plan.step, every=every, **plan.options)
        found = record.trajectory(0)
        return replace(found, setting=replace(found.require_setting(), name=f"run {number} of a sweep"))

    def plot(self, title: str, path: Any = None, status: str | None = "RUNNING") -> Any:
        """Return a matplotlib Figure of the cumulative distribution of a column: the share of runs below each value.

        Args:
            title: title of a column of numbers.
            path: file to write the figure to.
            status: status of the runs to include; None for all.

        Raises:
            StateError: there is no such column, it has no numbers, or there are no such runs.
            ResultError: a file cannot be read or written.
            MissingExtra: matplotlib is not installed.
        """
        from holdfast.view.comparison import plot_distribution

        levels = np.linspace(0.0, 1.0, 1001)
        return plot_distribution(title, self.quantiles(title, levels, status), levels, path)

    def _numbers(self, x: Array, title: str) -> Array:
        if x.dtype.kind not in "fi":
            raise StateError(f"sweep: expected a column of numbers, got '{title}'; columns: {', '.join(self.columns)}")
        return x

    def _read(self, k: int, read: Callable[[Path], Any]) -> Any:
        """Return what is read from the file of chunk k.

        Raises:
            Damage: it is missing or damaged; the message says how to recompute it.
        """
        arrow, _ = parquet_modules()
        name = SWEEP.chunk.format(k)
        with advising(self.folder, SWEEP.again):
            if k not in self._checked:
                stored(self.folder, name, self._files, most=sys.maxsize)
                self._checked.add(k)
            try:
                return read(self.folder / name)
            except (*UNREADABLE, arrow.ArrowException) as cause:
                raise Damage(f"{name} is damaged") from cause


def _levels(levels: Any) -> Array:
    """Return the levels of quantiles.

    Raises:
        StateError: the levels are invalid.
    """
    at = np.atleast_1d(numbers(levels, None, "levels", StateError))
    if not ((at >= 0.0) & (at <= 1.0)).all():
        raise StateError(f"levels: expected numbers from 0 to 1, got {checks.short(levels)}")
    return at
