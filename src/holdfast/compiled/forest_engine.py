"""The evaluation of a forest in a run by machine code, made by tracing what the reference runs."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from holdfast.compiled.forest_code import ForestCode
from holdfast.compiled.forest_schedule import forward_outputs, traced_solution, with_constant_arms, with_constants
from holdfast.compiled.result import INDETERMINATE, OK, SINGULAR
from holdfast.compiled.traced_chain import Given
from holdfast.compiled.traced_forest import (
    AGREEING,
    ClosureForces,
    closure_margins,
    limited_closures,
    traced_instant,
)
from holdfast.dynamics.tree.forest_closing import FOREST_CLOSED
from holdfast.dynamics.tree.forest_inverse import (
    CarryingForces,
    InverseAt,
    InverseTerms,
    carrying_forces,
    inverse_terms,
    loads_for,
    nearest_accelerations,
    smallest_accelerations,
)
from holdfast.dynamics.tree.forest_projection import ClosingRound, closing_round
from holdfast.dynamics.tree.forest_rows import forest_rows, least_forces
from holdfast.dynamics.tree.forest_simulate import (
    ForestAccount,
    ForestInstant,
    ForestReference,
    closed_near,
    gaps_and_energies,
)
from holdfast.dynamics.tree.varied_forest import (
    ForestArguments,
    rates_of_positions,
    unit_quaternions,
)
from holdfast.model.forest import Forest
from holdfast.questions.arrays import Shape, contact_of
from holdfast.spatial.scalar import Array, array, where

LONGEST_FORCES = 200_000  # operations of the smallest forces above which they are left to NumPy
_FORCES = ("closure_wrench", "coupling_force")
_ACCOUNT = ("position_gap", "velocity_gap", "kinetic", "potential")


class CompiledForestEngine:
    """A forest in a run by machine code; see `ForestEngine`. What it does not answer, the reference answers or refuses.

    Attributes:
        forest: the forest, all numbers of which are constants of the code.
        rank: rank of its constraint; if it is not given, that of the first instant, and None before.
    """

    def __init__(self, forest: Forest, rank: int | None = None) -> None:
        self.forest, self.rank = forest, rank if forest.constraint_row_count else 0
        self._reference = ForestReference(forest)

    def instant(self, given: ForestArguments) -> ForestInstant:
        """See `ForestEngine`."""
        x = self._dynamics(q=given.q, qd=given.qd, tau=given.tau, link_wrench=given.wrenches)
        status, rank = int(x["status"]), int(x["rank"])
        self.rank = rank if self.rank is None and status <= INDETERMINATE else self.rank
        if status > INDETERMINATE or rank != self.rank or given.under or given.behind:
            return self._reference.instant(given)
        found = {name: x[name].copy() for name in ForestInstant._fields if name in x and x[name].ndim}
        return ForestInstant(**found, unique=status == OK, condition=float(x["condition"]), rank=rank)  # pyright: ignore

    def closed(self, q: Array, qd: Array) -> tuple[Array, Array, tuple[float, float]]:
        """See `ForestEngine`."""
        return closed_near(self._closing_round, self.forest, q, qd)

    def _closing_round(self, q: Array, qd: Array) -> ClosingRound:
        x = self._closing(q=q, qd=qd)
        gaps = float(x["position_gap"]), float(x["velocity_gap"])
        return ClosingRound(x["closed_q"].copy(), x["closed_qd"].copy(), *gaps, float(x["rank"]))

    def account(self, given: ForestArguments, now: ForestInstant) -> ForestAccount:
        """See `ForestEngine`."""
        if not now.unique and self.costly:
            return self._reference.account(given, self._reference.instant(given))
        forces = {name: getattr(now, name)[None] for name in _FORCES}
        x = self.accounts(given.q[None], given.qd[None], now.unique, **forces)
        numbers: dict[str, Any] = {name: float(x[name][0]) for name in _ACCOUNT}
        return ForestAccount(**{name: x[name][0] for name in _FORCES}, **numbers)

    def accounts(
        self, q: Array, qd: Array, unique: bool, closure_wrench: Array, coupling_force: Array
    ) -> dict[str, Array]:
        """Return the entries of the accounts of k instants, (k, ...) each, if they are not too `costly`.

        Args:
            q: (k, n_q) positions.
            qd: (k, n_v) rates.
            unique: whether forces are unique.
            closure_wrench: (k, closures, 6) wrenches of the closures.
            coupling_force: (k, couplings) forces of the couplings.
        """
        forces = dict(zip(_FORCES, (closure_wrench, coupling_force), strict=True))
        if unique:
            return {**self._account.of_each(len(q), q=q, qd=qd), **forces}
        x = self._account_of_smallest.of_each(len(q), q=q, qd=qd, **forces)
        return {name.removeprefix("least_"): found for name, found in x.items()}

    def margins(self, x: Array, rates: Array, tau: Array, wrenches: Array) -> Array | None:
        """See `ForestEngine`."""
        if self.rank is None or (self.rank < self.forest.constraint_row_count and self.costly):
            return None
        contacts = np.array([contact_of(closure.grasp) for closure in self.forest.closures])
        found = self._margins.of_each(len(x), q=x, rates=rates, tau=tau, link_wrench=wrenches, contact=contacts)
        answered = found["status"] <= INDETERMINATE  # which NaN is not
        margins = found["margin"]
        return margins if (answered & (found["rank"] == self.rank)).all() and not np.isnan(margins).any() else None

    def inverse(self, given: ForestArguments) -> InverseAt | None:
        """Return inverse dynamics by machine code; None of another forest, or if bases move. See `inverse_code`."""
        if given.forest is not self.forest or given.under or given.behind:
            return None
        x = self._inverse(q=given.q, qd=given.qd)
        terms = InverseTerms(*(x[f"terms_{name}"].copy() for name in InverseTerms._fields))

        def loads(qdd: Array) -> Array:
            return self._loads(q=given.q, qd=given.qd, qdd=qdd, link_wrench=given.wrenches)["loads"].copy()

        def carrying(needed: Array, asked: Array) -> CarryingForces:
            x = self._carrying(q=given.q, qd=given.qd, needed=needed, asked=asked)
            return CarryingForces(x["force"].copy(), x["left"].copy(), float(x["missing"]))

        def nearest(qdd: Array, free: Array) -> Array:
            x = self._nearest(q=given.q, qd=given.qd, qdd=qdd, free=free)
            if not x["apart"] <= AGREEING:
                return smallest_accelerations(terms, qdd, free)
            return x["nearest"].copy()

        return InverseAt(terms, loads, carrying, nearest)

    @property
    def costly(self) -> bool:
        """Whether machine code of the smallest forces would be too long."""
        forest = self.forest
        return 4 * (self.rank or 0) * forest.velocity_count * forest.constraint_row_count > LONGEST_FORCES

    def _arguments(self, given: Given) -> ForestArguments:
        """Return traced arguments; those that are not given are zero."""
        forest, none = with_constants(self.forest), np.zeros(self.forest.velocity_count)
        wrenches = given.get("link_wrench", np.zeros((len(forest.bodies), 6)))
        return ForestArguments(forest, given["q"], given["qd"], given.get("tau", none), wrenches)

    @cached_property
    def _dynamics(self) -> ForestCode:
        def function(given: Given) -> dict[str, Any]:
            return traced_instant(self.forest, self._arguments(given))

        forest = self.forest
        outputs: dict[str, Shape] = {"qdd": (forest.velocity_count,), "closure_wrench": (len(forest.closures), 6)}
        outputs |= {"coupling_force": (len(forest.couplings),), "q_rates": (forest.position_count,), "power": (4,)}
        outputs |= dict.fromkeys(("rank", "status", "condition"), ())
        inputs = ("q", "qd", "tau", "link_wrench")
        return ForestCode(forest, "dynamics", inputs, outputs, function, ("qdd", *_FORCES))

    @cached_property
    def _closing(self) -> ForestCode:
        def function(given: Given) -> dict[str, Any]:
            arms = with_constant_arms(self.forest)
            found = closing_round(with_constants(self.forest), given["q"], given["qd"], arms)._asdict()
            return found | {f"closed_{name}": found.pop(name) for name in ("q", "qd")}

        sizes = {"closed_q": (self.forest.position_count,), "closed_qd": (self.forest.velocity_count,)}
        outputs = sizes | dict.fromkeys(("position_gap", "velocity_gap", "rank"), ())
        return ForestCode(self.forest, "closing", ("q", "qd"), outputs, function)

    @cached_property
    def _account(self) -> ForestCode:
        def function(given: Given) -> dict[str, Any]:
            return dict(zip(_ACCOUNT, gaps_and_energies(self._arguments(given)), strict=True))

        return ForestCode(self.forest, "account", ("q", "qd"), dict.fromkeys(_ACCOUNT, ()), function)

    @cached_property
    def _account_of_smallest(self) -> ForestCode:
        forest, rank = self.forest, self.rank or 0

        def function(given: Given) -> dict[str, Any]:
            at = self._arguments(given)
            motion = at.motion({})
            wrenches, forces = [*given["closure_wrench"]], [*given["coupling_force"]]
            found = least_forces(motion, forest_rows(motion), wrenches, forces, rank)
            least = {f"least_{name}": array(x) for name, x in zip(_FORCES, found, strict=True)}
            return least | dict(zip(_ACCOUNT, gaps_and_energies(at), strict=True))

        outputs: dict[str, Shape] = {"least_closure_wrench": (len(forest.closures), 6), **dict.fromkeys(_ACCOUNT, ())}
        outputs |= {"least_coupling_force": (len(forest.couplings),)}
        return ForestCode(forest, f"account/{rank}", ("q", "qd", *_FORCES), outputs, function)

    @cached_property
    def _margins(self) -> ForestCode:
        forest, rank = self.forest, self.rank or 0
        limits = limited_closures(forest)

        def function(given: Given) -> dict[str, Any]:
            made = with_constants(forest)
            q, qd = unit_quaternions(made, given["q"]), rates_of_positions(made, given["q"], given["rates"])
            gap, unique = 0.0, rank == forest.constraint_row_count
            if not unique:  # rows that follow from others contradict each other beside closed states
                for _ in range(2):
                    q, qd, gap, *_ = closing_round(made, q, qd, with_constant_arms(forest))
            given = {**given, "q": q, "qd": qd}
            found, motion = forward_outputs(traced_solution(forest, given)), self._arguments(given).motion({})
            forces = ClosureForces(found["closure_wrench"], found["coupling_force"])
            margins = closure_margins(forest, motion, forces, given["contact"], rank)
            status = where(gap <= FOREST_CLOSED, found["status"], float(SINGULAR))
            return {"margin": margins, "status": status, "rank": found["rank"]}

        outputs: dict[str, Shape] = {"margin": (len(forest.closures),), **dict.fromkeys(("status", "rank"), ())}
        return ForestCode(
            forest, f"margins/{rank}/{limits}", ("q", "rates", "tau", "link_wrench", "contact"), outputs, function
        )

    @cached_property
    def _inverse(self) -> ForestCode:
        forest = self.forest
        rows, n = forest.constraint_row_count, forest.velocity_count
        shapes = {"K": (rows - len(forest.couplings), 6), **dict.fromkeys(("G", "on_qd", "E"), (rows, n))}
        shapes |= {"r": (rows,), "C": (rows, rows), "unit": (n,), "normals": (len(forest.closures), 3)}

        def function(given: Given) -> dict[str, Any]:
            terms = inverse_terms(self._arguments(given).motion({}))
            return {f"terms_{name}": x for name, x in terms._asdict().items()}

        outputs = {f"terms_{name}": shape for name, shape in shapes.items()}
        return ForestCode(forest, "inverse", ("q", "qd"), outputs, function)

    @cached_property
    def _carrying(self) -> ForestCode:
        forest = self.forest

        def function(given: Given) -> dict[str, Any]:
            terms = inverse_terms(self._arguments(given).motion({}))
            return carrying_forces(forest, terms, given["needed"], given["asked"])._asdict()

        outputs: dict[str, Shape] = {"force": (forest.constraint_row_count,), "left": (forest.velocity_count,)}
        return ForestCode(forest, "carrying", ("q", "qd", "needed", "asked"), outputs | {"missing": ()}, function)

    @cached_property
    def _nearest(self) -> ForestCode:
        def function(given: Given) -> dict[str, Any]:
            terms = inverse_terms(self._arguments(given).motion({}))
            found, apart = nearest_accelerations(terms, given["qdd"], given["free"])
            return {"nearest": found, "apart": apart}

        outputs: dict[str, Shape] = {"nearest": (self.forest.velocity_count,), "apart": ()}
        return ForestCode(self.forest, "nearest", ("q", "qd", "qdd", "free"), outputs, function)

    @cached_property
    def _loads(self) -> ForestCode:
        def function(given: Given) -> dict[str, Any]:
            return {"loads": loads_for(self._arguments(given).motion({}), given["qdd"])}

        inputs, outputs = ("q", "qd", "qdd", "link_wrench"), {"loads": (self.forest.velocity_count,)}
        return ForestCode(self.forest, "loads", inputs, outputs, function)
