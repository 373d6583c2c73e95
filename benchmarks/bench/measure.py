"""Measurement of one system: agreement of the results of all entries, and their times."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.bench import entries
from benchmarks.bench.clock import Effort, summary, timed
from benchmarks.bench.entries import ACCURATE, Answers, Candidate, Entry, answers_of, relative_error
from benchmarks.bench.machine import memory_available
from benchmarks.bench.systems import System
from holdfast import State, forward_dynamics
from holdfast.spatial.scalar import Array

ALONE = 300e6  # entries of at least so many bytes are measured one at a time: built, timed beside ours, and freed
MARGIN = 1.3  # an entry is measured if this many times its memory is free


def measure_system(system: System, fast: Any, peers: Sequence[Candidate], effort: Effort) -> dict[str, Any]:
    """Return the record of one system: agreement and times of this library and every peer.

    Args:
        system: the system.
        fast: its chain as machine code.
        peers: the entries of other libraries; the first one, if exact, gives the reference solution.
        effort: duration of the measurement.
    """
    own = [make(system, fast) for make in (entries.public, entries.bind, entries.bind_copying)]
    truth: Answers | None = None
    rows: dict[str, list[Array]] = {entry.name: [] for entry in own}
    records, skipped = [], []
    for group in _groups(peers):
        built: list[Entry] = []
        for candidate in group:
            if truth is None and not candidate.exact:
                truth = reference(system)
            entry = _built(candidate, truth, skipped)
            if entry is not None:
                built.append(entry)
                truth = truth or entry.answers()
        truth = truth or reference(system)
        seconds = timed([*own, *built], effort)
        for k, entry in enumerate(own):
            rows[entry.name].append(seconds[:, k])
        for k, entry in enumerate(built, len(own)):
            records.append(record_of(entry, truth, seconds[:, k], dict(zip(rows, seconds.T[: len(own)], strict=True))))
        del built
        gc.collect()
    assert truth is not None  # there is at least one group, even without peers
    ours = [record_of(entry, truth, np.concatenate(rows[entry.name]), {}) for entry in own]
    chain = system.chain
    return {
        "name": system.name,
        "arms": len(chain.arms),
        "joints": chain.joint_count // len(chain.arms),
        "states": system.states,
        "operations": int(fast.operation_count),
        "entries": ours + records,
        "skipped": skipped,
    }


def reference(system: System) -> Answers:
    """Return the results of this library's reference implementation, without machine code."""
    found = []
    for q, qd, tau, pose, twist, *base in zip(*system.arrays, *system.base_arrays.values(), strict=True):
        found.append(forward_dynamics(system.chain, State(q, qd, pose, twist, *base), tau))
    return answers_of(found)


def _groups(peers: Sequence[Candidate]) -> list[list[Candidate]]:
    """Return the groups of candidates that are timed together, the exact one first; each large one is a group."""
    large = [[peer] for peer in peers if peer.memory > ALONE]
    small = [peer for peer in peers if peer.memory <= ALONE]
    return [*large, small] if small or not large else large


def _built(candidate: Candidate, truth: Answers | None, skipped: list[dict[str, str]]) -> Entry | None:
    """Return the entry; or note the reason for a failure and return None."""
    reason = ""
    if MARGIN * candidate.memory > memory_available():
        reason = f"needs {candidate.memory / 1e9:.1f} GB, {memory_available() / 1e9:.1f} GB are free"
    else:
        try:
            return candidate.build(truth)
        except Exception as error:  # any error of another library is noted, and the other entries go on
            reason = f"{type(error).__name__}: {error}"
    skipped.append({"name": candidate.name, "library": candidate.library, "reason": reason})
    return None


def record_of(entry: Entry, truth: Answers, seconds: Array, ours: dict[str, Array]) -> dict[str, Any]:
    """Return an entry's record, with its time relative to others from the same rounds.

    Its results are computed again after the timing, because some entries have state; of a batch the first ones count.
    """
    got = entry.answers()
    error = relative_error(got.qdd[: len(truth.qdd)], truth.qdd)
    wrench_error = None
    if got.wrenches is not None and truth.wrenches is not None:
        wrench_error = relative_error(got.wrenches[: len(truth.wrenches)], truth.wrenches)
    return {
        "name": entry.name,
        "library": entry.library,
        "note": entry.note,
        "floor": entry.floor,
        **summary(seconds),
        "error": error,
        "wrench_error": wrench_error,
        "accurate": bool(error <= ACCURATE) and not entry.floor,
        "ratios": {name: float(np.median(seconds / own)) for name, own in ours.items()},
    }
