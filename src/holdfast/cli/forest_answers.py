"""Answers of `holdfast solve` to forward dynamics of forests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from holdfast.cli.force_answers import relative_error
from holdfast.compiled.chain import compile
from holdfast.dynamics.result import Status
from holdfast.dynamics.tree.forest_dynamics import (
    FOREST_METHODS,
    ForestResult,
    forest_arguments,
    forest_dynamics,
    forest_result,
)
from holdfast.dynamics.tree.forest_gaps import require_closed
from holdfast.dynamics.tree.virtual_power import carried
from holdfast.errors import MethodNotApplicable, ModelError, SingularChainError, StateError
from holdfast.io.forest_case import ForestCase
from holdfast.model.forest import Forest
from holdfast.spatial.scalar import Array

COMPILED = "compiled"  # `sequential` as machine code
OF_FORESTS = f"for arms that hold one object; a forest is answered by {' or '.join(map(repr, FOREST_METHODS))}"


@dataclass(frozen=True, eq=False)
class ForestAnswer:
    """A result, or the reason why there is none.

    Attributes:
        case: the problem.
        method: name of the algorithm.
        result: result of forward dynamics; None if refused.
        reason: `not_applicable: ...`, `singular: ...` or `inconsistent: ...`; None if solved.
    """

    case: ForestCase
    method: str
    result: ForestResult | None = None
    reason: str | None = None

    @property
    def answered(self) -> bool:
        """Whether there is a result."""
        return self.result is not None

    @property
    def error(self) -> float | None:
        """The largest of max|x - e| / max(1, max|e|) over qdd, alpha, f and coupling; None without what is expected."""
        expected, found = self.case.expected, self.result
        if expected is None or found is None:
            return None
        pairs = [
            (found.qdd, np.concatenate([np.array(part) for part in expected.qdd])),
            (found.acceleration, np.array(expected.alpha)),
            (found.closure_wrench, np.array(expected.f).reshape(-1, 6)),
            (found.coupling_force, np.array(expected.coupling)),
        ]
        return max(relative_error(got, wanted) for got, wanted in pairs)

    def as_json(self) -> dict[str, object]:
        """Return the answer as plain data, by body, closure and coupling; numbers are null if refused."""
        r = self.result
        return {
            "name": self.case.name,
            "method": self.method,
            "status": "refused" if r is None else "ok",
            "reason": self.reason,
            "qdd": None if r is None else [r.qdd[part].tolist() for part in r.forest.velocities],
            "alpha": None if r is None else r.acceleration.tolist(),
            "f": None if r is None else r.closure_wrench.tolist(),
            "coupling": None if r is None else r.coupling_force.tolist(),
            "f_unique": r is not None and r.status is Status.OK,
            "rank": None if r is None else r.rank,
            "mobility": None if r is None else r.mobility,
            "error_vs_expected": self.error,
        }

    @property
    def line(self) -> tuple[str, str, str, str]:
        """Status, rank, mobility and error for a table."""
        if self.result is None:
            return f"refused: {(self.reason or '').partition(':')[0]}", "", "", ""
        r = self.result
        status = "ok" if r.status is Status.OK else "ok, f not unique"
        error = "" if self.error is None else f"{self.error:.1e}"
        return status, f"{r.rank} of {r.forest.constraint_row_count}", str(r.mobility), error

    def print_numbers(self, console: Console) -> None:
        """Print the accelerations of the joints and the wrenches of the closures."""
        if self.result is None:
            return
        r = self.result
        table = Table("body", "name", "joint", "accelerations [rad/s^2 or m/s^2]", title="joint accelerations")
        for k, (body, part) in enumerate(zip(r.forest.bodies, r.forest.velocities, strict=True)):
            table.add_row(str(k), body.link.name, body.joint.kind, _numbers(r.qdd[part]))
        console.print(table)
        title = "what body a exerts on body b, about the contact point, world axes"
        forces = Table("a", "b", "kind", "force x, y, z [N]", "moment x, y, z [N m]", title=title)
        for closure, f in zip(r.forest.closures, r.closure_wrench, strict=True):
            a = "world" if closure.a is None else str(closure.a)
            forces.add_row(a, str(closure.b), closure.grasp.kind, _numbers(f[3:]), _numbers(f[:3]))
        console.print(forces)
        if len(r.coupling_force):
            console.print(f"couplings: {_numbers(r.coupling_force)}")


def _numbers(values: Array) -> str:
    return ", ".join(f"{x:+.6g}" for x in values)


def forest_answers(case: ForestCase, methods: Sequence[str]) -> list[ForestAnswer]:
    """Return the answer of every method."""
    return [_answer(case, method) for method in methods]


def _answer(case: ForestCase, method: str) -> ForestAnswer:
    given = case.q, case.qd, case.tau, case.wrenches
    if method not in (*FOREST_METHODS, COMPILED):
        return ForestAnswer(case, method, reason=f"not_applicable: {method}: {OF_FORESTS}")
    try:
        if method == COMPILED:
            return ForestAnswer(case, method, by_machine_code(case.forest, *given))
        found = forest_dynamics(case.forest, *given, method=method)
    except StateError as cause:
        return ForestAnswer(case, method, reason=f"inconsistent: {cause}")
    except MethodNotApplicable as cause:
        return ForestAnswer(case, method, reason=f"not_applicable: {method}: {cause}")
    except (SingularChainError, ModelError) as cause:
        return ForestAnswer(case, method, reason=f"singular: {cause}")
    return ForestAnswer(case, method, found)


def by_machine_code(forest: Forest, q: Array, qd: Array, tau: Array, wrenches: Array) -> ForestResult:
    """Return the result of machine code, with what it leaves to Python: accelerations of bodies, smallest forces.

    Raises:
        HoldfastError: `forest_dynamics` raises it for the same arguments.
    """
    motion = forest_arguments(forest, q, qd, tau, wrenches).motion({})
    require_closed(motion, q, qd)
    r = compile(forest, parameters=["link_wrench"]).forward_dynamics(q, qd, tau, link_wrench=wrenches)
    qdd = [r.qdd[part] for part in forest.velocities]
    rates = [b.point_acceleration(x) if b.floats else x for b, x in zip(motion.bodies, qdd, strict=True)]
    bodies = zip(motion.bodies, carried(motion, rates), strict=True)
    accelerations = [body.true_acceleration(beta, forest.gravity) for body, beta in bodies]
    forces = [*r.closure_wrench], [*r.coupling_force]
    return forest_result(motion, qdd, accelerations, *forces, r.rank, r.condition, COMPILED)
