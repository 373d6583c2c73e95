"""A rollout over a duration, recorded in memory or in a folder that grows with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from typing import Any

import numpy as np

from holdfast import outer
from holdfast.progress import of_time, reporting
from holdfast.simulation.rollout.arguments import common_time, stop_margins, whole_steps
from holdfast.simulation.rollout.parts import refined
from holdfast.simulation.rollout.record import RolloutArguments, RolloutRecord
from holdfast.simulation.rollout.systems import RolloutSystems, require_recorded
from holdfast.simulation.rollout.traced_step import LIMITED, SLIPPED
from holdfast.spatial.scalar import Array

MOST_REPORTS = 100  # at most so many reports of how far a run is


@dataclass(frozen=True, eq=False)
class RecordOutput:
    """What a rollout records, and where the records go.

    Attributes:
        names: names of the arrays to record, which are attributes of `RolloutSystems`.
        folder: the folder to which records are appended; None keeps them in memory.
        overwrite: whether an earlier record in this folder is replaced.
        progress: as for `simulate`; a function is called with the time that has passed [s].
    """

    names: Sequence[str]
    folder: str | PathLike[str] | None
    overwrite: bool
    progress: bool | Callable[[float], object] | None


def recorded_rollout(
    arguments: RolloutArguments, output: RecordOutput, given: Mapping[str, Any], threads: int | None
) -> RolloutRecord:
    """Advance systems by a duration, and return their record.

    Records wait in memory; those of a folder are written when they are many, or old, or when an error or Ctrl-C ends
    the run.

    Args:
        arguments: the rollout, the systems at the start, the duration and the steps.
        output: the arrays to record, and where.
        given: parameters of the law and the chain, as for `Rollout.step`.
        threads: as for `Rollout.step`.

    Raises:
        StateError: a name is wrong, the duration is not a whole number of steps, or the systems have different times.
        ResultError: the folder is in use or cannot be written.
    """
    rollout, systems, step = arguments.rollout, arguments.systems, arguments.step
    steps = whole_steps(arguments.duration, step)
    record, progress = output.names, output.progress
    require_recorded(record)
    at, begin = systems.copy(), common_time(systems)
    done = np.minimum(np.arange(0, steps + arguments.every, arguments.every), steps)
    writer = None if output.folder is None else outer.RecordWriter(output.folder, arguments, output.overwrite)
    waiting: list[tuple[float, dict[str, Array]]] = []  # time, arrays
    last = at

    def keep(now: int) -> None:
        nonlocal last
        waiting.append((float(begin + now * step), {name: np.array(getattr(at, name)) for name in record}))
        last = at if writer is None else at.copy()

    def flush(stopped: Array, complete: bool) -> None:
        if writer is not None and waiting:
            writer.append(*_joined(waiting, record), last, stopped, complete)
            waiting.clear()

    keep(0)
    reports = np.union1d(done, np.arange(0, steps, max(1, steps // MOST_REPORTS))) if progress else done
    doing, size = f"running {len(at)} systems", f"{arguments.duration:g} s in {steps} steps"
    try:
        with reporting(progress, doing, size, of_time(arguments.duration)) as tell:
            for some_steps, now in zip(np.diff(reports), reports[1:], strict=True):
                rollout.step(at, step, steps=some_steps, threads=threads, **arguments.options, **given)
                if now in done:
                    keep(now)
                    if now < steps and writer is not None and writer.is_due(waiting):
                        flush(_ended(last), False)
                tell(now * step)
    except BaseException:
        if writer is not None and writer.started:  # nothing is on disk before the arguments were accepted
            flush(_ended(last), False)
        raise
    stopped = _ended(at)
    violated = systems.running & np.isin(at.arrays["code"], (SLIPPED, LIMITED))
    if violated.any():
        least = stop_margins(arguments.options["least_margin"], arguments.options["stop_at_limits"])
        take = partial(rollout.advance_unconfirmed, steps=1, least=least, threads=threads)
        stopped[violated] = refined(at, violated, step, take)
    flush(stopped, True)
    return RolloutRecord(*_joined(waiting, record), at, stopped, arguments) if writer is None else writer.record()


def _joined(rows: Sequence[tuple[float, Mapping[str, Array]]], names: Sequence[str]) -> tuple[Array, dict[str, Array]]:
    """Return the times of rows, and their arrays by name with the time as first axis."""
    return np.array([t for t, _ in rows]), {name: np.array([row[name] for _, row in rows]) for name in names}


def _ended(systems: RolloutSystems) -> Array:
    """Return the time at which each system stopped, to a step; infinite where it did not."""
    return np.where(systems.running, np.inf, systems.t)
