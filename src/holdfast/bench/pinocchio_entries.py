"""Pinocchio at its best: no list converted in a call, data made once, one thread, `lcaba` tuned per system.

Its C++ library has more (`pv`, `constrainedABA`); its Python package does not, so they are not here.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterable
from typing import Any

from holdfast.bench import library
from holdfast.bench.entry import ACCURATE, Answers, Candidate, Entry, relative_error
from holdfast.bench.pinocchio_model import Form, PinocchioModel
from holdfast.bench.systems import System

LIBRARY = "pinocchio"
LARGE = 300e6  # bytes of Data from which on making one takes seconds
MUS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
ITERATIONS = (2, 3, 4, 5, 6, 8, 10)
MUS_IF_LARGE = (1e-5, 1e-6, 1e-7)
ITERATIONS_IF_LARGE = (3, 4, 6, 10)
UNREACHED = 1e-14  # accuracy asked for: the iteration count alone decides
TRIAL = 0.05  # seconds of calls in which a setting must keep its accuracy, because errors build up in Data
PROBATION = 0.5  # the same for the setting that is chosen
MISSING_WRENCH = "without the wrench of the arm whose hand the object is part of"

Evaluate = Callable[[Any, Any, Any], Any]


def candidates(system: System) -> list[Candidate]:
    """Return every way to solve a system with Pinocchio; the first supplies the true answers."""
    memory = data_size(system)
    ways = [
        ("constraintDynamics, free", functools.partial(cholesky, system, "free")),
        ("constraintDynamics, tree", functools.partial(cholesky, system, "tree")),
        ("lcaba, free", functools.partial(lcaba, system, "free")),
        ("lcaba, tree", functools.partial(lcaba, system, "tree")),
        ("aba, no grasps", functools.partial(aba, system)),
    ]
    return [Candidate(name, LIBRARY, build, memory, exact=not i) for i, (name, build) in enumerate(ways)]


def data_size(system: System) -> int:
    """Return what one Data takes, roughly: a few tensors of nv^3 doubles."""
    return int(4.3 * 8 * (system.chain.joint_count + 6) ** 3)


def cholesky(system: System, form: Form, truth: Answers | None) -> Entry:
    """Return `constraintDynamics` with its default settings (mu = 0, exact)."""
    pin = library.pinocchio()

    posed = PinocchioModel(system, form)
    model, welds, data, weld_data = posed.model, posed.welds, posed.model.createData(), posed.weld_data()
    pin.initConstraintDynamics(model, data, welds, weld_data)
    solve, inputs = pin.constraintDynamics, posed.inputs

    def sweep() -> None:
        for q, v, tau in inputs:
            solve(model, data, q, v, tau, welds, weld_data)

    def evaluate(q: Any, v: Any, tau: Any) -> Any:
        return solve(model, data, q, v, tau, welds, weld_data)

    note = "mu = 0" if form == "free" else f"mu = 0; {MISSING_WRENCH}"
    answers = functools.partial(posed.answers, evaluate, weld_data)
    return Entry(f"constraintDynamics, {form}", LIBRARY, sweep, system.states, answers, note)


def lcaba(system: System, form: Form, truth: Answers | None) -> Entry:
    """Return `lcaba` with the fewest iterations, and the best mu, that keep 1e-9 call after call.

    If no setting does, the most accurate one.

    Args:
        system: the system.
        form: "free" or "tree".
        truth: the true answers.
    """
    pin = library.pinocchio()

    assert truth is not None
    posed = PinocchioModel(system, form)
    model, welds, inputs, solve = posed.model, posed.welds, posed.inputs, pin.lcaba

    def prepared(mu: float, iterations: int) -> tuple[Evaluate, Callable[[], None]]:
        data, weld_data = model.createData(), posed.weld_data()  # a bad setting spoils them for every later call
        pin.computeJointMinimalOrdering(model, data, welds)
        settings = pin.ProximalSettings(UNREACHED, UNREACHED, mu, iterations)

        def sweep() -> None:
            for q, v, tau in inputs:
                solve(model, data, q, v, tau, welds, weld_data, settings)

        def evaluate(q: Any, v: Any, tau: Any) -> Any:
            return solve(model, data, q, v, tau, welds, weld_data, settings)

        return evaluate, sweep

    def error(mu: float, iterations: int, seconds: float) -> float:
        evaluate, sweep = prepared(mu, iterations)
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            sweep()
        return relative_error(posed.answers(evaluate).qdd, truth.qdd)

    large = data_size(system) > LARGE
    mus, counts = (MUS_IF_LARGE, ITERATIONS_IF_LARGE) if large else (MUS, ITERATIONS)
    mu, iterations = fewest_iterations(error, mus, counts)
    evaluate, sweep = prepared(mu, iterations)
    note = f"mu = {mu:g}, {iterations} iterations" + ("" if form == "free" else f"; {MISSING_WRENCH}")
    answers = functools.partial(posed.answers, evaluate)
    return Entry(f"lcaba, {form}", LIBRARY, sweep, system.states, answers, note)


def fewest_iterations(
    error: Callable[[float, int, float], float], mus: Iterable[float], counts: Iterable[int]
) -> tuple[float, int]:
    """Return mu and the number of iterations: the fewest that reach 1e-9, else the most accurate pair.

    Args:
        error: of (mu, iterations) after that many seconds of calls.
        mus: to try.
        counts: of iterations to try, ascending: each costs time.
    """
    tried: dict[tuple[float, int], float] = {}
    for count in counts:
        row = {(mu, count): error(mu, count, TRIAL) for mu in mus}
        tried |= row
        for pair in sorted(row, key=row.__getitem__):
            if row[pair] <= ACCURATE and error(*pair, PROBATION) <= ACCURATE:
                return pair
    return min(tried, key=lambda pair: (math.isnan(tried[pair]), tried[pair]))


def aba(system: System, truth: Answers | None) -> Entry:
    """Return `aba` of arms and free object without any grasp: what no tree library goes below."""
    pin = library.pinocchio()

    posed = PinocchioModel(system, "free")
    model, data, inputs, solve = posed.model, posed.model.createData(), posed.inputs, pin.aba

    def sweep() -> None:
        for q, v, tau in inputs:
            solve(model, data, q, v, tau)

    answers = functools.partial(posed.answers, functools.partial(solve, model, data))
    return Entry("aba, no grasps", LIBRARY, sweep, system.states, answers, "grasps left out", floor=True)
