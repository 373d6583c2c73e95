"""Chains with a trunk: entries of this library and Pinocchio, timed in the same rounds as ours without a trunk."""

from __future__ import annotations

from typing import Any

import numpy as np

import holdfast
from holdfast.bench import entries, pinocchio_peer
from holdfast.bench.clock import Effort, summary, timed
from holdfast.bench.entries import LIBRARY, Answers, Entry, answers_of, relative_error
from holdfast.bench.measure import reference
from holdfast.bench.systems import System
from holdfast.bench.trunk_systems import make_trunk_system

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
    own = [call(system, fast), bound(system, fast), call_for_many(system, fast, BATCH)]
    others = [entries.public(*plain), entries.bind(*plain), entries.batch(*plain, BATCH)]
    peers = [pinocchio_peer.cholesky(system, "free", None)] if pinocchio else []
    truth = peers[0].answers() if peers else reference(system)
    seconds = timed([*own, *others, *peers], effort).T
    ours = dict(zip(WAYS, seconds, strict=False))
    pairs = zip(WAYS, own, seconds[len(own) :], strict=False)
    return {
        "name": name,
        "operations": int(fast.operation_count),
        **{way: _timed(entry, ours[way], truth, {"2 x 7": plainly}) for way, entry, plainly in pairs},
        "peers": [_timed(peer, taken, truth, ours) for peer, taken in zip(peers, seconds[2 * len(own) :], strict=True)],
    }


def call(system: System, fast: Any) -> Entry:
    """Return the checked call with arrays and a reused result."""
    states, bases, solve = entries.each_state(system), _each_base(system), fast.forward_dynamics
    out, rows = solve(*states[0], **bases[0]), list(zip(states, bases, strict=True))
    floating = [(*state, *base.values()) for state, base in rows if base]

    def sweep() -> None:  # written out, like a loop of a caller
        if floating:
            for q, qd, tau, pose, twist, base_pose, base_twist in floating:
                solve(q, qd, tau, pose, twist, floating_pose=base_pose, floating_twist=base_twist, out=out)
        else:
            for q, qd, tau, pose, twist in states:
                solve(q, qd, tau, pose, twist, out=out)

    def answers() -> Answers:
        return answers_of([solve(*state, **base) for state, base in rows])

    return Entry(entries.PUBLIC, LIBRARY, sweep, system.states, answers, "arrays in, result re-used")


def bound(system: System, fast: Any) -> Entry:
    """Return the bound calls, one for each state, bound to arrays of the caller."""
    names = ("q", "qd", "tau", "object_pose", "object_twist")
    pairs = zip(entries.each_state(system), _each_base(system), strict=True)
    tied = [fast.bind(**dict(zip(names, state, strict=True)), **base) for state, base in pairs]

    def sweep() -> None:
        for step in tied:
            step()

    def answers() -> Answers:
        sweep()
        return answers_of([step.result for step in tied])

    return Entry(entries.BIND, LIBRARY, sweep, system.states, answers, "tied to each state's own arrays")


def call_for_many(system: System, fast: Any, size: int) -> Entry:
    """Return one call for a batch of states, on one thread."""
    arrays, solve = system.repeated(size).arrays, fast.forward_dynamics
    base = {name: np.resize(x, (size, x.shape[1])) for name, x in _bases(system).items()}
    out = solve(*arrays, **base)

    def sweep() -> None:
        solve(*arrays, out=out, **base)

    def answers() -> Answers:
        found = solve(*arrays, **base)
        return Answers(found.qdd[: system.states], found.grasp_wrench[: system.states])

    return Entry(f"batch of {size}", LIBRARY, sweep, size, answers, "one call, result re-used, one thread")


def _bases(system: System) -> dict[str, Any]:
    """Return pose and twist of a floating base, with the names of the arguments."""
    return dict(zip(("floating_pose", "floating_twist"), system.base_arrays, strict=False))


def _each_base(system: System) -> list[dict[str, Any]]:
    return [{name: x[k].copy() for name, x in _bases(system).items()} for k in range(system.states)]


def _timed(entry: Entry, seconds: Any, truth: Answers, over: dict[str, Any]) -> dict[str, Any]:
    """Return an entry's record with its time relative to others from the same rounds."""
    assert truth.wrenches is not None
    got = entry.answers()
    assert got.wrenches is not None
    return {
        "name": entry.name,
        "library": entry.library,
        "note": entry.note,
        **summary(seconds),
        "error": relative_error(got.qdd, truth.qdd),
        "wrench_error": relative_error(got.wrenches, truth.wrenches),
        "ratios": {name: float(np.median(seconds / other)) for name, other in over.items()},
    }
