"""What is timed: one way to compute forward dynamics of a system."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from holdfast.bench.systems import System
from holdfast.spatial.scalar import Array

ACCURATE = 1e-9  # relative error of the joint accelerations up to which answers count as the same


@dataclass(frozen=True, eq=False)
class Answers:
    """What an entry computes at every state.

    Attributes:
        qdd: (states, n) joint accelerations.
        wrenches: (states, arms, 6) [moment; force] of each arm on the object about the contact,
            world axes; NaN for an arm whose wrench the entry does not give; None: none given.
    """

    qdd: Array
    wrenches: Array | None = None


@dataclass(frozen=True, eq=False)
class Entry:
    """One way to compute forward dynamics, ready to be timed.

    Attributes:
        name: short, unique within a system.
        library: whose it is.
        sweep: evaluates every state once, inputs handed over as a caller must.
        evaluations: how many that is.
        answers: computes every state and returns what came out.
        note: what was chosen for it and what it leaves out, in words.
        floor: True if it leaves the grasps out: a lower bound, no competitor.
    """

    name: str
    library: str
    sweep: Callable[[], object]
    evaluations: int
    answers: Callable[[], Answers]
    note: str = ""
    floor: bool = False


@dataclass(frozen=True, eq=False)
class Candidate:
    """An entry that is not built yet, because building may take gigabytes.

    Attributes:
        name: the entry's.
        library: the entry's.
        build: makes the entry, given the true answers (None for the exact candidate).
        memory: what it holds while it lives, roughly [bytes].
        exact: True if its answers are taken as the true ones.
    """

    name: str
    library: str
    build: Callable[[Answers | None], Entry]
    memory: int = 0
    exact: bool = False


def relative_error(got: Array, truth: Array) -> float:
    """Return the largest error of any state over that state's largest true entry; NaN where `got` lacks an arm."""
    given = ~np.isnan(got)
    if not given.any():
        return float("nan")
    error = np.where(given, np.abs(got - truth), 0.0).reshape(len(truth), -1).max(axis=1)
    return float((error / np.abs(truth).reshape(len(truth), -1).max(axis=1)).max())


def each_state(system: System) -> list[tuple[Array, ...]]:
    """Return the arguments of every state as arrays of their own, as a caller would hold them."""
    return [tuple(array[k].copy() for array in system.arrays) for k in range(system.states)]
