"""Entries of the benchmark: ways to compute forward dynamics. Those of this library are called as a user would."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.bench.systems import System
from holdfast.spatial.scalar import Array

ACCURATE = 1e-9  # largest relative error of joint accelerations for which results count as equal


@dataclass(frozen=True, eq=False)
class Answers:
    """The results of an entry at every state.

    Attributes:
        qdd: (states, n) joint accelerations.
        wrenches: (states, arms, 6) wrench of each arm on the object about the contact, world axes; NaN for an arm whose
            wrench the entry does not compute; None if it computes no wrenches.
    """

    qdd: Array
    wrenches: Array | None = None


@dataclass(frozen=True, eq=False)
class Timed:
    """One way to compute something, ready to be timed.

    Attributes:
        name: short name, unique within a system.
        library: name of the library.
        sweep: evaluates every state once, and passes the inputs as a caller has to.
        evaluations: number of evaluations in a sweep.
        note: the settings, and what the entry leaves out.
    """

    name: str
    library: str
    sweep: Callable[[], object]
    evaluations: int
    note: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Entry(Timed):
    """One way to compute forward dynamics, ready to be timed and compared.

    Attributes:
        answers: computes every state and returns the results.
        floor: True if it leaves out the grasps, so that it is a lower bound and not a competitor.
    """

    answers: Callable[[], Answers]
    floor: bool = False


@dataclass(frozen=True, eq=False)
class Candidate:
    """An entry that is not built yet, because building may take gigabytes.

    Attributes:
        name: name of the entry.
        library: library of the entry.
        build: builds the entry from the reference solution (None for the exact candidate).
        memory: approximate memory of the entry [bytes].
        exact: True if its results are the reference solution.
    """

    name: str
    library: str
    build: Callable[[Answers | None], Entry]
    memory: int = 0
    exact: bool = False


def answers_of(results: Sequence[Any]) -> Answers:
    """Return the answers from results of forward dynamics, one per state."""
    return Answers(np.array([r.qdd for r in results]), np.array([r.grasp_wrench for r in results]))


def relative_error(got: Array, truth: Array) -> float:
    """Return the largest error of any state relative to its largest true entry; NaN if `got` lacks an arm."""
    given = ~np.isnan(got)
    if not given.any():
        return float("nan")
    error = np.where(given, np.abs(got - truth), 0.0).reshape(len(truth), -1).max(axis=1)
    return float((error / np.abs(truth).reshape(len(truth), -1).max(axis=1)).max())


def each_state(system: System) -> list[tuple[Array, ...]]:
    """Return the arguments of every state as separate arrays, as a caller would have them."""
    return [tuple(array[k].copy() for array in system.arrays) for k in range(system.states)]


def each_base(system: System) -> list[dict[str, Array]]:
    """Return the pose and twist of a floating base in every state, by the names of the arguments; empty without one."""
    return [{name: x[k].copy() for name, x in system.base_arrays.items()} for k in range(system.states)]


LIBRARY = "holdfast"
NAMES = ("q", "qd", "tau", "object_pose", "object_twist")
PUBLIC, BIND, BIND_COPYING = "forward_dynamics", "bind", "bind, copying"


def public(system: System, fast: Any) -> Entry:
    """Return the checked call with arrays and a reused result."""
    states, bases, solve = each_state(system), each_base(system), fast.forward_dynamics
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

    return Entry(PUBLIC, LIBRARY, sweep, system.states, "arrays in, result re-used", answers=answers)


def bind(system: System, fast: Any) -> Entry:
    """Return the bound calls, one for each state, bound to arrays of the caller."""
    pairs = zip(each_state(system), each_base(system), strict=True)
    bound = [fast.bind(**dict(zip(NAMES, state, strict=True)), **base) for state, base in pairs]

    def sweep() -> None:
        for step in bound:
            step()

    def answers() -> Answers:
        sweep()
        return answers_of([step.result for step in bound])

    return Entry(BIND, LIBRARY, sweep, system.states, "tied to each state's own arrays", answers=answers)


def bind_copying(system: System, fast: Any) -> Entry:
    """Return one bound call, into whose arrays the five arrays of each state are copied first."""
    states, bound = each_state(system), fast.bind()
    into_q, into_qd, into_tau = bound.q, bound.qd, bound.tau
    into_pose, into_twist = bound.object_pose, bound.object_twist

    def sweep() -> None:
        for state in states:
            solve(*state)

    def solve(q: Array, qd: Array, tau: Array, pose: Array, twist: Array) -> None:
        into_q[...] = q
        into_qd[...] = qd
        into_tau[...] = tau
        into_pose[...] = pose
        into_twist[...] = twist
        bound()

    def answers() -> Answers:
        qdd, wrenches = [], []
        for state in states:
            solve(*state)
            qdd.append(bound.result.qdd.copy())
            wrenches.append(bound.result.grasp_wrench.copy())
        return Answers(np.array(qdd), np.array(wrenches))

    return Entry(BIND_COPYING, LIBRARY, sweep, system.states, "five arrays copied into its own", answers=answers)


def batch(system: System, fast: Any, size: int) -> Entry:
    """Return one call for a batch of states, on one thread."""
    repeated, solve = system.repeated(size), partial(fast.forward_dynamics, threads=1)
    arrays, base = repeated.arrays, repeated.base_arrays
    out = solve(*arrays, **base)

    def sweep() -> None:
        solve(*arrays, out=out, **base)

    def answers() -> Answers:
        found = solve(*arrays, **base)
        return Answers(np.array(found.qdd), np.array(found.grasp_wrench))

    return Entry(f"batch of {size}", LIBRARY, sweep, size, "one call, result re-used, one thread", answers=answers)
