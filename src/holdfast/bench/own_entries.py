"""This library's ways to compute forward dynamics, as a user would call them."""

from __future__ import annotations

from typing import Any

import numpy as np

import holdfast
from holdfast.bench.entry import Answers, Entry, each_state
from holdfast.bench.systems import System

LIBRARY = "holdfast"
PUBLIC, BIND, BIND_CALL = "forward_dynamics", "bind", "bind, call only"


def compiled(system: System) -> Any:
    """Return the system's chain as machine code."""
    return holdfast.compile(system.chain)


def public(system: System, fast: Any) -> Entry:
    """Return the checked call: five arrays in, a re-used result out."""
    states, solve = each_state(system), fast.forward_dynamics
    out = solve(*states[0])

    def sweep() -> None:
        for q, qd, tau, pose, twist in states:
            solve(q, qd, tau, pose, twist, out=out)

    def answers() -> Answers:
        found = [solve(*state) for state in states]
        return Answers(np.array([r.qdd for r in found]), np.array([r.grasp_wrench for r in found]))

    return Entry(PUBLIC, LIBRARY, sweep, system.states, answers, "five arrays, result re-used")


def bind(system: System, fast: Any) -> Entry:
    """Return the bound call, its five input arrays written before each."""
    states, bound = each_state(system), fast.bind()
    into_q, into_qd, into_tau, into_pose, into_twist = _inputs(bound)

    def sweep() -> None:
        for q, qd, tau, pose, twist in states:
            into_q[...] = q
            into_qd[...] = qd
            into_tau[...] = tau
            into_pose[...] = pose
            into_twist[...] = twist
            bound()

    def answers() -> Answers:
        qdd, wrenches = [], []
        for state in states:
            for array, value in zip(_inputs(bound), state, strict=True):
                array[...] = value
            bound()
            qdd.append(bound.result.qdd.copy())
            wrenches.append(bound.result.grasp_wrench.copy())
        return Answers(np.array(qdd), np.array(wrenches))

    return Entry(BIND, LIBRARY, sweep, system.states, answers, "five arrays written into its buffers")


def bind_call(system: System, fast: Any) -> Entry:
    """Return the bound call alone, its inputs already in place (as for a controller that computes into them)."""
    whole, bound = bind(system, fast), fast.bind()
    for array, value in zip(_inputs(bound), each_state(system)[0], strict=True):
        array[...] = value
    rounds = range(system.states)

    def sweep() -> None:
        for _ in rounds:
            bound()

    return Entry(BIND_CALL, LIBRARY, sweep, system.states, whole.answers, "inputs already in its buffers; one state")


def batch(system: System, fast: Any, size: int) -> Entry:
    """Return one call for a batch of states, on one thread."""
    arrays, solve = system.repeated(size).arrays, fast.forward_dynamics
    out = solve(*arrays)

    def sweep() -> None:
        solve(*arrays, out=out)

    def answers() -> Answers:
        found = solve(*arrays)
        return Answers(np.array(found.qdd), np.array(found.grasp_wrench))

    return Entry(f"batch of {size}", LIBRARY, sweep, size, answers, "one call, result re-used, one thread")


def _inputs(bound: Any) -> tuple[Any, ...]:
    return bound.q, bound.qd, bound.tau, bound.object_pose, bound.object_twist
