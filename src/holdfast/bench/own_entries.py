"""This library's ways to compute forward dynamics, as a user would call them."""

from __future__ import annotations

from typing import Any

import numpy as np

import holdfast
from holdfast.bench.entry import Answers, Entry, each_state
from holdfast.bench.systems import System
from holdfast.spatial.scalar import Array

LIBRARY = "holdfast"
PUBLIC, BIND, BIND_COPYING = "forward_dynamics", "bind", "bind, copying"


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
    """Return the bound call, tied to the caller's own five arrays; one for each state."""
    names = ("q", "qd", "tau", "object_pose", "object_twist")
    bound = [fast.bind(**dict(zip(names, state, strict=True))) for state in each_state(system)]

    def sweep() -> None:
        for step in bound:
            step()

    def answers() -> Answers:
        sweep()
        found = [step.result for step in bound]
        return Answers(np.array([r.qdd for r in found]), np.array([r.grasp_wrench for r in found]))

    return Entry(BIND, LIBRARY, sweep, system.states, answers, "tied to each state's own five arrays")


def bind_copying(system: System, fast: Any) -> Entry:
    """Return one bound call, each state's five arrays copied into its own before."""
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

    return Entry(BIND_COPYING, LIBRARY, sweep, system.states, answers, "five arrays copied into its own")


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
