"""Derivatives of random forests: against dual numbers over equations without any elimination, and what they cost.

    python -m benchmarks.random_forest_derivatives --count 100 [--first 0] [--costs 20] [--compiled 100]

Where forces are unique, all derivatives of accelerations and forces by all arguments are compared. Where they are not,
rows that follow from others are left out of the dense equations, so that accelerations are compared, by everything that
does not open closures and along a motion. `--costs` counts the operations of so many gradients beside those of forward
dynamics, as they stand in the compiler's graph. `--compiled` compares gradients and rates of so many forests by machine
code, of all results along random directions, and its operations and times with those of forward dynamics by it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from tests.oracles.chain_derivatives import symmetric_basis
from tests.oracles.forest_derivatives import ForestDerivatives, forest_derivatives
from tests.systems.random_forests import ForestProblem, random_forest

import holdfast as hf
from holdfast.compiler.trace import trace
from holdfast.dynamics.result import Status
from holdfast.dynamics.tree.forest_derivatives import (
    FOREST_RESULTS,
    POSITIONS_RATES_TORQUES,
    ForestPoint,
    backward,
    forest_dynamics_jacobian,
    forest_dynamics_jvp,
    forest_dynamics_vjp,
)
from holdfast.dynamics.tree.forest_dynamics import by_plan, forest_dynamics
from holdfast.dynamics.tree.forest_rows import forest_rows
from holdfast.dynamics.tree.varied_forest import FOREST_ARGUMENTS, ForestArguments
from holdfast.dynamics.tree.virtual_power import carried, outputs, unknowns_of
from holdfast.errors import SingularChainError

ACCELERATIONS = ("qdd", "acceleration")
KEEP_CLOSED = ("tau", "link_wrench", "gravity", "armature", "damping", "link_mass", "link_com", "link_inertia")


class Outcome(NamedTuple):
    """How the derivatives of one forest compare.

    Attributes:
        name: of the forest.
        unique: whether forces are unique; None if the posture is singular and refused.
        error: largest error of the derivatives, relative to the largest of a result by an argument, at least 1.
        adjoint: difference of a gradient times a direction from a cotangent times its rates, relative.
    """

    name: str
    unique: bool | None
    error: float
    adjoint: float


def outcome(p: ForestProblem) -> Outcome:
    """Return how the derivatives of a forest compare."""
    try:
        found = forest_dynamics_jacobian(*p[1:], of=FOREST_RESULTS, by=FOREST_ARGUMENTS)
    except SingularChainError:
        return Outcome(p.name, None, np.nan, np.nan)
    truth, unique = forest_derivatives(p, FOREST_ARGUMENTS), found.result.status is Status.OK
    pairs = [
        (of, by)
        for of in FOREST_RESULTS
        for by in FOREST_ARGUMENTS
        if unique or (of in ACCELERATIONS and by in KEEP_CLOSED)
    ]
    errors = [gap(columns(found[pair], pair[1]), truth.matrices[pair[0]][:, truth.at[pair[1]]]) for pair in pairs]
    if not unique:
        errors += [gap(*both) for both in along_a_motion(p, truth)]
    return Outcome(p.name, unique, max(errors), adjoint_error(p))


def gap(found: np.ndarray, wanted: np.ndarray) -> float:
    """Return max|x - e| / max(1, max|e|)."""
    found = found.reshape(wanted.shape)
    return float(np.abs(found - wanted).max(initial=0.0)) / max(1.0, float(np.abs(wanted).max(initial=0.0)))


def columns(x: np.ndarray, by: str) -> np.ndarray:
    """Return a Jacobian whose columns are those of the oracle: of inertias six for each."""
    return np.einsum("...ij,kij->...k", x, symmetric_basis()) if by == "link_inertia" else x


def along_a_motion(p: ForestProblem, truth: ForestDerivatives) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield rates of accelerations as the forest moves on, found and true."""
    random, forest = np.random.default_rng(0), p.forest
    tau = random.normal(size=forest.velocity_count)
    given = {"q": p.qd, "qd": forest_dynamics(forest, p.q, p.qd, tau, p.wrenches).qdd, "tau": tau}
    if not p.qd.any():
        given["q"] = allowed(p, random.normal(size=forest.velocity_count))
    found = forest_dynamics_jvp(*p[1:], along=given, check=False)
    for name in ACCELERATIONS:
        parts = [truth.matrices[name][:, truth.at[by]] @ x for by, x in given.items()]
        yield found[name], np.sum(parts, axis=0)


def allowed(p: ForestProblem, rates: np.ndarray) -> np.ndarray:
    """Return the part of rates that closures and couplings allow."""
    motion = ForestArguments(*p[1:]).motion({})
    G = forest_rows(motion).on_qd(motion)
    return rates - np.linalg.pinv(G, rcond=1e-9) @ (G @ rates)


def adjoint_error(p: ForestProblem) -> float:
    """Return the difference of a gradient times a direction from a cotangent times its rates, relative to its terms."""
    random = np.random.default_rng(1)
    values = ForestArguments(*p[1:]).values(FOREST_ARGUMENTS)
    along = {name: random.normal(size=x.shape) for name, x in values.items()}
    rates = forest_dynamics_jvp(*p[1:], along=along, check=False)
    bars = {name: random.normal(size=rates[name].shape) for name in FOREST_RESULTS}
    gradients = forest_dynamics_vjp(*p[1:], by=FOREST_ARGUMENTS, check=False, **bars)
    forth = [(bars[name] * rates[name]).ravel() for name in FOREST_RESULTS]
    back = [(gradients[name] * along[name]).ravel() for name in FOREST_ARGUMENTS]
    size = sum(np.abs(x).sum() for x in (*forth, *back))
    return float(abs(sum(x.sum() for x in forth) - sum(x.sum() for x in back))) / max(1.0, size)


def costs(p: ForestProblem) -> tuple[int, int]:
    """Return the operations of forward dynamics, and of it with a gradient by q, qd and tau of all its results."""

    def solved(q, qd, tau) -> ForestPoint:
        given = ForestArguments(p.forest, q, qd, tau, p.wrenches)
        motion = given.motion({})
        found = by_plan(motion)
        return ForestPoint(given, motion, unknowns_of(motion, list(found.qdd), found.wrenches, found.multipliers), None)

    def shown(at: ForestPoint) -> tuple:
        return tuple(outputs(at.motion, at.z, carried(at.motion, at.z.rates)))

    def forward(q, qd, tau) -> tuple:
        at = solved(q, qd, tau)
        return shown(at)

    def with_gradient(q, qd, tau, *bars) -> tuple:
        at = solved(q, qd, tau)
        found = backward(at, dict(zip(FOREST_RESULTS, bars, strict=True)), POSITIONS_RATES_TORQUES)
        return *shown(at), *found.values()

    shapes = [x.shape for x in p[2:5]]
    bars = [x.shape for x in shown(solved(*p[2:5]))]
    return trace(forward, shapes).operation_count, trace(with_gradient, [*shapes, *bars]).operation_count


class Compiled(NamedTuple):
    """How gradients and rates of one forest by machine code compare.

    Attributes:
        name: of the forest.
        unique: whether forces are unique; None if the posture is singular and refused.
        error: largest difference from dual numbers, relative to the largest entry, at least 1.
        operations, seconds: those of a gradient by q, qd and tau, with forward dynamics, over those of it alone.
    """

    name: str
    unique: bool | None
    error: float
    operations: float
    seconds: float


def compiled_outcome(p: ForestProblem, timed: bool = True) -> Compiled:
    """Return how gradients and rates of a forest by machine code compare; only accelerations if forces are a choice."""
    forward, random = hf.compile(p.forest, parameters=["link_wrench"]).forward_dynamics, np.random.default_rng(2)
    given: dict[str, Any] = {"q": p.q, "qd": p.qd, "tau": p.tau, "link_wrench": p.wrenches}
    try:
        unique = forward(**given).status is Status.OK
    except SingularChainError:
        return Compiled(p.name, None, np.nan, np.nan, np.nan)
    truth, of = (
        forest_derivatives(p, FOREST_ARGUMENTS),
        ("qdd", "closure_wrench", "coupling_force")[: 3 if unique else 1],
    )
    by = [name for name in FOREST_ARGUMENTS if not name.endswith("_pose") and (unique or name in KEEP_CLOSED)]
    shapes = {name: x.shape for name, x in ForestArguments(*p[1:]).values(by).items()}
    bars: dict[str, Any] = {name: random.normal(size=forward.function.terms.outputs[name]) for name in of}
    along = {name: random.normal(size=shape) for name, shape in shapes.items()}
    if "link_inertia" in along:
        along["link_inertia"] = 0.5 * (along["link_inertia"] + np.swapaxes(along["link_inertia"], 1, 2))
    found, errors = forward.vjp(**given, by=by, **bars), []
    for name in by:
        wanted = sum(bars[one].ravel() @ truth.matrices[one][:, truth.at[name]] for one in of)
        errors.append(gap(columns(found[name][None], name).ravel(), np.asarray(wanted)))
    rates = forward.jvp(**given, along=along, of=of)
    for one in of:
        wanted = sum(truth.matrices[one][:, truth.at[name]] @ directions_of(along[name], name) for name in by)
        errors.append(gap(rates[one], np.asarray(wanted)))
    ways = forward.bind(**given), forward.bind("vjp", of=of, by=POSITIONS_RATES_TORQUES, **given)
    counts = [way._function.calls.kernel.operation_count for way in ways]
    times = np.array([[seconds(way.run) for way in ways] for _ in range(15)]) if timed else np.ones((1, 2))
    return Compiled(p.name, unique, max(errors), counts[1] / counts[0], float(np.median(times[:, 1] / times[:, 0])))


def directions_of(x: np.ndarray, by: str) -> np.ndarray:
    """Return a direction in the oracle's columns: of inertias six for each."""
    if by != "link_inertia":
        return x.ravel()
    basis = symmetric_basis().reshape(6, 9)
    return np.concatenate([np.linalg.lstsq(basis.T, one.ravel(), rcond=None)[0] for one in x])


def seconds(call: Callable[[], Any]) -> float:
    """Return the time of a call [s]."""
    start = time.perf_counter()
    for _ in range(50):
        call()
    return (time.perf_counter() - start) / 50


def report_compiled(first: int, count: int) -> None:
    """Print how machine code compares."""
    found = []
    for seed in range(first, first + count):
        found.append(compiled_outcome(random_forest(seed)))
        if found[-1].error > 1e-9:
            print(found[-1], flush=True)
    for unique in (True, False):
        some = [one for one in found if one.unique is unique]
        if some:
            errors = [one.error for one in some]
            print(
                f"machine code, forces {'unique' if unique else 'not unique'}: {len(some)} forests, error median"
                f" {np.median(errors):.0e}, largest {max(errors):.0e}"
            )
    known = [one for one in found if one.unique is not None]
    for what, ratios in {"operations": [x.operations for x in known], "time": [x.seconds for x in known]}.items():
        print(
            f"gradient with forward dynamics by machine code, {what}: {min(ratios):.2f} to {max(ratios):.2f}, median"
            f" {np.median(ratios):.2f} times forward dynamics"
        )


def main() -> None:
    """Print a line for every forest beyond the bars, and a summary."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--costs", type=int, default=0)
    parser.add_argument("--compiled", type=int, default=0)
    given = parser.parse_args()
    if given.compiled:
        report_compiled(given.first, given.compiled)
    found = []
    for seed in range(given.first, given.first + given.count):
        one = outcome(random_forest(seed))
        found.append(one)
        if one.error > 1e-9 or one.adjoint > 1e-12:
            print(
                f"{one.name}: error {one.error:.1e}, adjoint {one.adjoint:.1e}, forces unique: {one.unique}", flush=True
            )
    for unique in (True, False):
        some = [one for one in found if one.unique is unique]
        if some:
            errors, adjoint = [one.error for one in some], max(one.adjoint for one in some)
            print(
                f"forces {'unique' if unique else 'not unique'}: {len(some)} forests, error median"
                f" {np.median(errors):.0e}, largest {max(errors):.0e}; adjoint to {adjoint:.0e}"
            )
    print(f"refused as singular: {sum(one.unique is None for one in found)}")
    ratios = []
    for seed in range(given.first, given.first + given.costs):
        p = random_forest(seed)
        forward, gradient = costs(p)
        ratios.append(gradient / forward)
        print(f"{p.name}: {forward} operations forward, {gradient} with a gradient: {ratios[-1]:.2f}", flush=True)
    if ratios:
        print(f"gradients cost {min(ratios):.2f} to {max(ratios):.2f} times forward dynamics, with it")


if __name__ == "__main__":
    main()
