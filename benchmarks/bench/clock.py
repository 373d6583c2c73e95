"""Timing on a shared machine: every entry runs in every round, and medians are taken over rounds."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.bench.entries import Timed
from holdfast.spatial.scalar import Array


@dataclass(frozen=True)
class Effort:
    """The duration of a measurement.

    Attributes:
        turn: seconds that an entry runs in a round.
        rounds: number of rounds.
    """

    turn: float
    rounds: int


def timed(
    entries: Sequence[Timed],
    effort: Effort,
    now: Callable[[], float] = time.perf_counter,
) -> Array:
    """Return seconds per evaluation, (rounds, entries).

    Every round starts with another entry, so that no entry always follows the same one.

    Args:
        entries: the entries to time.
        effort: duration of the measurement.
        now: the clock [s]; `time.process_time` excludes the time of other processes.
    """
    sweeps = [_calibrated(entry, effort.turn, now) for entry in entries]
    seconds = np.empty((effort.rounds, len(entries)))
    for r in range(effort.rounds):
        for i in range(len(entries)):
            k = (i + r) % len(entries)
            seconds[r, k] = _seconds(entries[k], sweeps[k], now) / (sweeps[k] * entries[k].evaluations)
    return seconds


def _calibrated(entry: Timed, turn: float, now: Callable[[], float]) -> int:
    """Return the number of sweeps in a turn; this also warms up the entry."""
    _seconds(entry, 1, now)
    count = 1
    while (spent := _seconds(entry, count, now)) < turn / 4:
        count *= 2
    return max(1, round(count * turn / spent))


def _seconds(entry: Timed, sweeps: int, now: Callable[[], float]) -> float:
    sweep, collecting = entry.sweep, gc.isenabled()
    gc.disable()  # like timeit
    try:
        start = now()
        for _ in range(sweeps):
            sweep()
        return now() - start
    finally:
        if collecting:
            gc.enable()


def least_time(call: Callable[[], object], calls: int, rounds: int) -> float:
    """Return the processor time of a call, the least of several rounds after a first call, which may compile [s]."""
    call()
    found = []
    for _ in range(rounds):
        begin = time.process_time()
        for _ in range(calls):
            call()
        found.append((time.process_time() - begin) / calls)
    return min(found)


def summary(seconds: Array) -> dict[str, float]:
    """Return the median of an entry's rounds and the quartiles [us]."""
    low, middle, high = 1e6 * np.percentile(seconds, [25, 50, 75])
    return {"microseconds": float(middle), "lower_quartile": float(low), "upper_quartile": float(high)}
