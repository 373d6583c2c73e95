"""The evaluation of a forest in a run by machine code, made by tracing what the reference runs."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.computation import Computation
from holdfast.compiled.forest import INPUTS, forward_outputs, with_constant_arms, with_constants
from holdfast.compiled.kernels import kernel
from holdfast.compiled.result import INDETERMINATE, OK
from holdfast.compiled.traced_chain import Given, externals, traced
from holdfast.compiler.kernel import Bound
from holdfast.dynamics.tree.forest_balance import kinetic_energy, potential_energy, power_into
from holdfast.dynamics.tree.forest_gaps import position_gaps, velocity_gaps
from holdfast.dynamics.tree.forest_projection import ClosingRound, closing_round
from holdfast.dynamics.tree.forest_rows import forest_rows, least_forces
from holdfast.dynamics.tree.forest_simulate import ForestAccount, ForestInstant, ForestReference
from holdfast.dynamics.tree.varied_forest import ForestArguments, position_rates
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.model.forest import Forest
from holdfast.questions.arrays import Shape
from holdfast.spatial.scalar import Array, array

LONGEST_FORCES = 200_000  # operations of the smallest forces above which they are left to NumPy


class _Structure(NamedTuple):
    """What names machine code of a forest."""

    chain: Forest
    key: str


class CompiledForestEngine:
    """A forest in a run by machine code; see `ForestEngine`. What it does not answer, the reference answers or refuses.

    Attributes:
        forest: the forest, all numbers of which are constants of the code.
        rank: rank of its constraint, that of the first instant; None before.
    """

    def __init__(self, forest: Forest) -> None:
        self.forest, self.rank = forest, None if forest.constraint_row_count else 0
        self._reference = ForestReference(forest)

    def instant(self, given: ForestArguments) -> ForestInstant:
        """See `ForestEngine`."""
        x = self._run(self._dynamics, q=given.q, qd=given.qd, tau=given.tau, link_wrench=given.wrenches)
        status, rank = int(x["status"]), int(x["rank"])
        self.rank = rank if self.rank is None and status <= INDETERMINATE else self.rank
        if status > INDETERMINATE or rank != self.rank or given.under or given.behind:
            return self._reference.instant(given)
        found = {name: x[name].copy() for name in ForestInstant._fields if name in x and name != "condition"}
        return ForestInstant(**found, unique=status == OK, condition=float(x["condition"]))  # pyright: ignore

    def closing(self, q: Array, qd: Array) -> ClosingRound:
        """See `ForestEngine`."""
        x = self._run(self._closing, q=q, qd=qd)
        gaps = float(x["position_gap"]), float(x["velocity_gap"])
        return ClosingRound(x["closed_q"].copy(), x["closed_qd"].copy(), *gaps, float(x["rank"]))

    def account(self, given: ForestArguments, now: ForestInstant) -> ForestAccount:
        """See `ForestEngine`."""
        if not now.unique and self._costly:
            return self._reference.account(given, self._reference.instant(given))
        code = self._account if now.unique else self._account_of_smallest
        forces = {} if now.unique else {"closure_wrench": now.closure_wrench, "coupling_force": now.coupling_force}
        x = self._run(code, q=given.q, qd=given.qd, **forces)
        wrench, force = (now.closure_wrench, now.coupling_force) if now.unique else (x[f"least_{n}"] for n in forces)
        return ForestAccount(wrench.copy(), force.copy(), *(float(x[name]) for name in (*_GAPS, *_ENERGIES)))

    @property
    def _costly(self) -> bool:
        """Whether machine code of the smallest forces would be too long."""
        forest = self.forest
        return 4 * (self.rank or 0) * forest.velocity_count * forest.constraint_row_count > LONGEST_FORCES

    @staticmethod
    def _run(code: Bound, **given: Array) -> Mapping[str, Array]:
        for name, x in given.items():
            code.arrays[name][...] = x
        code.run()
        return code.arrays

    @cached_property
    def _dynamics(self) -> Bound:
        def outputs(given: Given) -> dict[str, Any]:
            forest = with_constants(self.forest)
            at = ForestArguments(forest, given["q"], given["qd"], given["tau"], given["link_wrench"])
            rates, power = position_rates(forest, at.q, at.qd), array(power_into(at, at.motion({})))
            return forward_outputs(self.forest, given) | {"q_rates": rates, "power": power}

        inputs, solution = (*INPUTS, "link_wrench"), ("qdd", "closure_wrench", "coupling_force")
        return self._made("dynamics", inputs, (*solution, "q_rates", "power", "rank", "status", "condition"), outputs)

    @cached_property
    def _closing(self) -> Bound:
        def outputs(given: Given) -> dict[str, Any]:
            forest = with_constants(self.forest)
            found = closing_round(forest, given["q"], given["qd"], with_constant_arms(self.forest))
            return dict(zip(("closed_q", "closed_qd", *_GAPS, "rank"), found, strict=True))

        return self._made("closing", ("q", "qd"), ("closed_q", "closed_qd", *_GAPS, "rank"), outputs)

    @cached_property
    def _account(self) -> Bound:
        def outputs(given: Given) -> dict[str, Any]:
            return _account_of(self.forest, given)

        return self._made("account", ("q", "qd"), (*_GAPS, *_ENERGIES), outputs)

    @cached_property
    def _account_of_smallest(self) -> Bound:
        rank = self.rank or 0

        def outputs(given: Given) -> dict[str, Any]:
            motion = ForestArguments(
                with_constants(self.forest), given["q"], given["qd"], 0.0 * given["qd"], self._no_wrenches
            ).motion({})
            forces = [*given["closure_wrench"]], [*given["coupling_force"]]
            wrenches, multipliers = least_forces(motion, forest_rows(motion), *forces, rank)
            least = {"least_closure_wrench": array(wrenches), "least_coupling_force": array(multipliers)}
            return least | _account_of(self.forest, given)

        forces = ("closure_wrench", "coupling_force")
        outgoing = (*(f"least_{name}" for name in forces), *_GAPS, *_ENERGIES)
        return self._made(f"account/{rank}", ("q", "qd", *forces), outgoing, outputs)

    @property
    def _no_wrenches(self) -> Array:
        return np.zeros((len(self.forest.bodies), 6))

    def _made(
        self, name: str, inputs: tuple[str, ...], outgoing: tuple[str, ...], outputs: Callable[[Given], dict[str, Any]]
    ) -> Bound:
        """Return the machine code of a function of the forest with arrays of its own."""
        forest = self.forest
        wrench, force = (len(forest.closures), 6), (len(forest.couplings),)
        shapes: dict[str, Shape] = dict.fromkeys(("q", "q_rates", "closed_q"), (forest.position_count,))
        shapes |= dict.fromkeys(("qd", "tau", "qdd", "closed_qd"), (forest.velocity_count,))
        shapes |= {"link_wrench": (len(forest.bodies), 6), "power": (4,)}
        shapes |= {"closure_wrench": wrench, "least_closure_wrench": wrench}
        shapes |= {"coupling_force": force, "least_coupling_force": force}
        found = externals(inputs, (), outgoing, {**dict.fromkeys(outgoing, ()), **shapes})
        guarded = ("qdd", "closure_wrench", "coupling_force") if "status" in outgoing else ()

        def schedule() -> Any:
            return traced(found, outputs, "status" if "status" in outgoing else None, guarded)

        key = f"{exact_fingerprint(forest) or secrets.token_hex()}/{name}"
        structure: Any = _Structure(forest, key)
        return kernel(Computation("forest", structure, found, schedule, inputs)).bind()


_GAPS = ("position_gap", "velocity_gap")
_ENERGIES = ("kinetic", "potential")


def _account_of(forest: Forest, given: Given) -> dict[str, Any]:
    """Return gaps and energies."""
    made, q, qd = with_constants(forest), given["q"], given["qd"]
    motion = ForestArguments(made, q, qd, 0.0 * qd, np.zeros((len(forest.bodies), 6))).motion({})
    gaps = position_gaps(motion, q).largest, velocity_gaps(motion, qd).largest
    return dict(
        zip((*_GAPS, *_ENERGIES), (*gaps, kinetic_energy(motion, qd), potential_energy(motion, q)), strict=True)
    )
