"""What a run records: which arrays, of which samples, and how many of them stay in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import MethodNotApplicable, ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.stops import ALIKE
from holdfast.simulation.trajectory import (
    BASE_FIELDS,
    LOWEST,
    NOT_OF_FORESTS,
    TOUCH_FIELDS,
    TRUNK_FIELDS,
    Trajectory,
    array_names,
    joined,
    part_of,
)
from holdfast.spatial.scalar import Array

EVERYTHING, STATES = "everything", "states"
STATE_NAMES = ("t", "q", "qd", "qdd", "object_pose", "object_twist", "object_acceleration", *BASE_FIELDS)
MOST_SAMPLES = 1_000_000  # of a run that is only in memory
MOST_KEPT = 2**28  # bytes of samples that memory holds beside a folder


class RecordSettings(NamedTuple):
    """What a run records.

    Attributes:
        names: the arrays, in the order of a trajectory.
        every: number of steps between two samples.
        step: the step [s].
    """

    names: tuple[str, ...]
    every: int = 1
    step: float = 0.0

    @property
    def options(self) -> dict[str, Any]:
        """What differs from recording everything at every step, as options of a run."""
        some: dict[str, Any] = {} if self.names == tuple(array_names()) else {"record": list(self.names)}
        return some | ({} if self.every == 1 else {"every": self.every})


def require_memory(steps: int, every: int) -> None:
    """Refuse a run whose samples are too many for memory.

    Raises:
        ModelError: naming what would do.
    """
    if steps / every > MOST_SAMPLES:
        enough = int(np.ceil(steps / MOST_SAMPLES))
        raise ModelError(
            f"simulation: expected at most {MOST_SAMPLES} samples in memory, got {steps / every:.3g}; try"
            f" every={enough}, or folder=..., which keeps them on disk"
        )


def record_settings(record: str | Sequence[str], every: int, step: float, chain: ClosedChain) -> RecordSettings:
    """Return what a run records; see `simulate`.

    Raises:
        ModelError: a name is unknown, or `every` is not a whole number from 1.
        MethodNotApplicable: an array is asked for by name that a run of a chain with branches does not determine.
    """
    if isinstance(every, bool) or not isinstance(every, int | np.integer) or every < 1:
        raise ModelError(f"simulation: every: expected a number of steps from 1, got {checks.short(every)}")
    known = array_names()
    if isinstance(record, str):
        listed: Sequence[str] = {EVERYTHING: known, STATES: STATE_NAMES}.get(record, [record])
    else:
        listed = [*record] if checks.is_listed(record) else []
    if not listed:
        expected = f"expected '{EVERYTHING}', '{STATES}' or names of arrays"
        raise ModelError(f"simulation: record: {expected}, got {checks.short(record)}")
    for name in listed:
        if not isinstance(name, str) or name not in known:
            alike = checks.did_you_mean(str(name), [EVERYTHING, STATES, *known])
            raise ModelError(f"simulation: record: no array {checks.short(name)}.{alike}")
        if chain.beyond_serial and name in NOT_OF_FORESTS and listed is not known:
            raise MethodNotApplicable(f"record: expected arrays of a chain that is answered as a forest, got '{name}'")
    empty = TRUNK_FIELDS if chain.trunk is None else () if chain.trunk.floating else BASE_FIELDS
    empty = (*empty, *(() if chain.all_couplings else ("coupling_force",)))
    empty = (*empty, *(() if chain.touching else TOUCH_FIELDS))
    found = {"t", *listed, *empty, *(lowest for lowest, others in LOWEST.items() if not {*listed}.isdisjoint(others))}
    found -= {*(NOT_OF_FORESTS if chain.beyond_serial else ())}
    return RecordSettings(tuple(name for name in known if name in found), int(every), step)


class Thinning:
    """Chooses the samples of a run that are recorded.

    These are the samples at multiples of `every` steps, of which there are two at a jump; the first and the last; and
    those on both sides of whatever happens. Each has the lowest margins since the one recorded before.
    """

    def __init__(self, how: RecordSettings, resumed: bool) -> None:
        self._how, self._begun = how, resumed
        self._passed: Trajectory | None = None  # the last sample, if it is not recorded

    def take(self, run: Trajectory) -> tuple[Trajectory | None, Array]:
        """Take successive samples, and return those to record, with their places.

        Args:
            run: the samples; if anything has happened, only one.

        Returns:
            The samples, or None; and their places in `run`, which is -1 for the last of an earlier call.
        """
        if self._how.every == 1:
            return run, np.arange(len(run))
        before = 0 if self._passed is None else 1
        run = run if self._passed is None else joined([self._passed, run])
        interval = self._how.every * self._how.step
        due = np.abs(run.t - interval * np.round(run.t / interval)) <= ALIKE * self._how.step
        due[:before] = bool(run.occurrences)
        due[before:] |= bool(run.occurrences) or not self._begun
        self._begun, places = True, np.flatnonzero(due)
        ends = places if due[-1] else np.append(places, len(due) - 1)
        run = part_of(_with_lowest(run, ends, self._how.every), ends, run.occurrences)
        kept = run if due[-1] else part_of(run, slice(None, -1))
        self._passed = None if due[-1] else part_of(run, slice(-1, None))
        return kept if len(kept) else None, places - before

    def last(self) -> Trajectory | None:
        """Return the last sample of the run, if it is not recorded yet."""
        return self._passed


def _with_lowest(run: Trajectory, ends: Array, every: int) -> Trajectory:
    """Return a run whose samples `ends` have the lowest margins since the one before."""
    arrays: dict[str, Any] = {name: np.array(getattr(run, name)) for name in run.recorded}
    begins = [0, *(ends[:-1] + 1)]
    for lowest, others in LOWEST.items():
        for begin, end in zip(begins, ends, strict=True) if lowest in arrays else ():
            k = begin + np.argmin(arrays[lowest][begin : end + 1], axis=0)[None]
            for name in (lowest, *others):
                if name in arrays:
                    arrays[name][end] = np.take_along_axis(arrays[name], k, axis=0)[0]
    return Trajectory(**arrays, every=every, occurrences=run.occurrences)


class Listeners(NamedTuple):
    """Functions that are called while a run goes on; see `simulate`.

    Attributes:
        progress: called with the time after every step.
        on_sample: called with every sample.
        on_checkpoint: called after that with the checkpoint.
        on_samples: each called with the samples of one or more steps and the checkpoint after the last.
        on_disk: returns an array of the samples that were given to `on_samples`, by name; None if they are not kept.
    """

    progress: Callable[[float], object]
    on_sample: Callable[[Trajectory], None] | None = None
    on_checkpoint: Callable[[Checkpoint], None] | None = None
    on_samples: Sequence[Callable[[Trajectory, Any], None]] = ()
    on_disk: Callable[[str], Array] | None = None


class RunRecord:
    """The recorded samples of a run, of which memory holds only so many if they are also on disk."""

    def __init__(self, how: RecordSettings, resumed: bool, listeners: Listeners) -> None:
        self._how, self._thinning, self._listeners = how, Thinning(how, resumed), listeners
        self._parts: list[Trajectory] = []
        self._size, self._only_on_disk = 0, False  # bytes
        self._earlier: Callable[[], Checkpoint] | None = None  # the checkpoint after the last sample before

    def add(self, run: Trajectory, checkpoint: Callable[[int], Checkpoint]) -> None:
        """Take successive samples; if anything has happened, only one.

        Args:
            run: the samples.
            checkpoint: returns the checkpoint after one of them.
        """
        kept, places = self._thinning.take(run)
        if kept is not None:
            earlier = self._earlier
            self._keep(kept, [partial(checkpoint, int(k)) if k >= 0 or earlier is None else earlier for k in places])
        self._earlier = partial(checkpoint, len(run) - 1)

    def whole(self, last: Checkpoint) -> Trajectory | None:
        """Return all samples, the last of the run included; None without one.

        Args:
            last: the checkpoint at the end.
        """
        if (passed := self._thinning.last()) is not None:
            self._keep(passed, [lambda: last])
        if self._only_on_disk and self._listeners.on_disk is not None:
            return Trajectory.on_disk(self._how.names, self._listeners.on_disk)
        return joined(self._parts) if self._parts else None

    def _keep(self, run: Trajectory, checkpoints: Sequence[Callable[[], Checkpoint]]) -> None:
        told = self._listeners
        for k, checkpoint in enumerate(checkpoints) if told.on_sample or told.on_checkpoint else ():
            if told.on_sample is not None:
                told.on_sample(part_of(run, k, run.occurrences if k == len(run) - 1 else ()))
            if told.on_checkpoint is not None:
                told.on_checkpoint(checkpoint())
        for listen in told.on_samples:
            listen(run, checkpoints[-1]())
        if told.on_disk is not None:
            self._size += sum(getattr(run, name).nbytes for name in run.recorded)
            if self._size > MOST_KEPT:
                self._only_on_disk = True
                self._parts.clear()
        if not self._only_on_disk:
            self._parts.append(run)
