"""Chains with a trunk: entries of this library and Pinocchio, timed in the same rounds as ours without a trunk."""

from __future__ import annotations

from typing import Any

import holdfast
from benchmarks.bench import entries, pinocchio_peer
from benchmarks.bench.clock import Effort, timed
from benchmarks.bench.measure import record_of, reference
from benchmarks.bench.systems import System
from benchmarks.bench.trunk_systems import make_trunk_system

BATCH = 4096  # states in one call
WAYS: tuple[str, ...] = ("call", "bound", "batch")


def compare(name: str, plain: tuple[System, Any], effort: Effort, *, pinocchio: bool) -> dict[str, Any]:
    """Return the record of a system with a trunk.

    Args:
        name: name of the system.
        plain: two arms of seven joints without a trunk, and their machine code.
        effort: duration of the measurement.
        pinocchio: whether Pinocchio is installed.
    """
    system = make_trunk_system(name)
    fast = holdfast.compile(system.chain)
    own, others = (
        [entries.public(*one), entries.bind(*one), entries.batch(*one, BATCH)] for one in ((system, fast), plain)
    )
    peers = [pinocchio_peer.cholesky(system, "free", None)] if pinocchio else []
    truth = peers[0].answers() if peers else reference(system)
    seconds = timed([*own, *others, *peers], effort).T
    ours = dict(zip(WAYS, seconds, strict=False))
    pairs, theirs = zip(WAYS, own, seconds[len(own) :], strict=False), seconds[2 * len(own) :]
    return {
        "name": name,
        "operations": int(fast.operation_count),
        **{way: _record(entry, truth, ours[way], {"2 x 7": plainly}) for way, entry, plainly in pairs},
        "peers": [_record(peer, truth, taken, ours) for peer, taken in zip(peers, theirs, strict=True)],
    }


def _record(*measured: Any) -> dict[str, Any]:
    """Return an entry's record without the marks that only comparisons of peers need."""
    return {key: x for key, x in record_of(*measured).items() if key not in ("floor", "accurate")}
