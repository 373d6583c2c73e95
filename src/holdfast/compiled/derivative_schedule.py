"""Schedules of the derivatives of forward dynamics, made by tracing the reference's functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from holdfast.compiled.computation import Computation
from holdfast.compiled.forward_schedule import forward_externals, guarded_outputs, outputs_of, solve_with_status
from holdfast.compiled.parameters import WRENCHES
from holdfast.compiled.recorded_loops import recorded_loops
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import Given, traced, traced_chain, traced_inputs, traced_state
from holdfast.compiler.schedule import External, Schedule
from holdfast.dynamics.closed.forward_derivatives import backward, forward
from holdfast.dynamics.closed.forward_jacobian import in_each_column, jacobian, units_needed
from holdfast.dynamics.closed.second_solve import point
from holdfast.dynamics.force_element_rates import force_element_rates, pushforward, with_pullback
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import (
    FLOATING,
    LINKS,
    MOVING,
    STATE_AND_TORQUES,
    TRUNK_LINKS,
    Shape,
    gradient_shapes,
    results_of,
    shapes,
)
from holdfast.questions.case import VariedCase
from holdfast.questions.question import Question
from holdfast.spatial.scalar import Array

DerivativeKind = Literal["vjp", "jvp", "jacobian"]
WITH = "with."  # the prefix of the names of cotangents of results and tangents of arguments
FOUND = "found."  # the prefix of the names of derivatives
UNITS = "units"  # the identity, whose rows are the directions of a Jacobian's columns


@dataclass(frozen=True)
class Request:
    """Which derivatives of a question are requested.

    Attributes:
        question: the question.
        kind: `vjp` (the product of cotangents of results with the Jacobian), `jvp` (the product of the Jacobian with
            tangents of arguments) or `jacobian`.
        results: the results to differentiate.
        arguments: the arguments by which they are differentiated.
    """

    question: Question
    kind: DerivativeKind
    results: tuple[str, ...]
    arguments: tuple[str, ...]

    @property
    def name(self) -> str:
        """The request's name in the key of the cache."""
        return f"{self.question.name}_{self.kind}({','.join(self.results)};{','.join(self.arguments)})"

    def computation(self, chain: ClosedChain, options: Options) -> Computation:
        """Return the computation of the answer and these derivatives."""
        raise NotImplementedError

    def found(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return the shapes of the arrays of derivatives, by name."""
        raise NotImplementedError

    def matrix(self, chain: ClosedChain, of: str, by: str, found: Array) -> Array:
        """Return a Jacobian, (..., *shape of the result, *shape of the argument), of the array that holds it."""
        raise NotImplementedError

    @property
    def given(self) -> tuple[str, ...]:
        """The results that have cotangents (`vjp`) or the arguments that have tangents (`jvp`)."""
        return {"vjp": self.results, "jvp": self.arguments, "jacobian": ()}[self.kind]


class ForwardRequest(Request):
    """A request for derivatives of forward dynamics."""

    def computation(self, chain: ClosedChain, options: Options) -> Computation:
        """Return the computation of forward dynamics and these derivatives."""
        structure = Structure(chain, options_of(options, self.arguments))
        arrays = self.externals(structure)
        fixed = {UNITS: np.eye(arrays[UNITS].shape[0])} if UNITS in arrays else {}
        inputs = (*given_names(chain), *(f"{WITH}{name}" for name in self.given))
        return Computation(self.name, structure, arrays, lambda: self.schedule(structure), inputs, (), fixed)

    def matrix(self, chain: ClosedChain, of: str, by: str, found: Array) -> Array:
        """Return a Jacobian, (..., *shape of the result, *shape of the argument), of its columns."""
        known, lead = derivative_shapes(chain), found.shape[:-2]
        whole = found.reshape(*lead, *known[by], *known[of])
        first, middle = len(lead), len(lead) + len(known[by])
        return whole.transpose([*range(first), *range(middle, whole.ndim), *range(first, middle)])

    def found(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return the shapes of the derivatives: by argument (`vjp`), by result (`jvp`), or of transposed blocks."""
        known = derivative_shapes(chain)
        if self.kind == "jacobian":
            sizes = {name: math.prod(known[name]) for name in (*self.results, *self.arguments)}
            return {f"{of}.{by}": (sizes[by], sizes[of]) for of in self.results for by in self.arguments}
        return {name: known[name] for name in (self.arguments if self.kind == "vjp" else self.results)}

    def externals(self, structure: Structure) -> dict[str, External]:
        """Return the arrays that the computation reads and writes."""
        chain, known = structure.chain, derivative_shapes(structure.chain)
        of_forward = forward_externals(structure)
        # The inputs of every call come first, because the builtin fills in the first addresses.
        own = {name: of_forward[name] for name in given_names(chain)}
        own |= {f"{WITH}{name}": External(known[name], "input") for name in self.given}
        own |= {name: e for name, e in of_forward.items() if e.role == "input" and name not in own}
        own |= {name: e for name, e in of_forward.items() if e.role == "parameter"}
        if self.kind == "jacobian":
            size = units_needed(chain, self.arguments)
            own[UNITS] = External((size, size), "parameter")
        own |= {name: e for name, e in of_forward.items() if e.role == "output"}
        return own | {f"{FOUND}{name}": External(shape, "output") for name, shape in self.found(chain).items()}

    def schedule(self, structure: Structure) -> Schedule:
        """Return the schedule for one chain."""
        externals = self.externals(structure)
        names = (*guarded_outputs(structure.chain), *(f"{FOUND}{name}" for name in self.found(structure.chain)))
        guarded = tuple(name for name in names if externals[name].size)
        return traced(externals, lambda given: self.outputs(structure, given), "status", guarded)

    def outputs(self, structure: Structure, given: Given) -> dict[str, Any]:
        """Return forward dynamics and its derivatives by running the reference's functions on traced arrays."""
        chain, route = traced_chain(structure, given), structure.options.route
        state, inputs = traced_state(chain, given), traced_inputs(chain, given)
        own = {name: given[f"{WITH}{name}"] for name in self.given}
        known = own if self.kind == "vjp" else None
        solved = solve_with_status(chain, state, given["tau"], inputs, given["generic_rank"], route, cotangents=known)
        at = point(solved.motion, solved.found, route)
        with recorded_loops():
            springs = force_element_rates(VariedCase(chain, state, inputs, {}), self.arguments)
        if self.kind == "jacobian":
            changed = () if springs is None else springs.names
            rates = dict.fromkeys(changed, lambda at, _: lambda tangents: forward(at, pushforward(springs, tangents)))
            columns = jacobian(at, self.results, self.arguments, given[UNITS], rates, in_each_column)
            found = {f"{of}.{by}": x for (of, by), x in columns.items()}
        elif self.kind == "vjp":
            found = with_pullback(springs, self.arguments, lambda names: backward(at, own, names, together=True))
        else:
            found = forward(at, pushforward(springs, own))
        return outputs_of(chain, solved) | {f"{FOUND}{name}": found[name] for name in self.found(structure.chain)}


def given_names(chain: ClosedChain) -> tuple[str, ...]:
    """Return the inputs that every call gives: state and torques."""
    return *STATE_AND_TORQUES, *(FLOATING if chain.floats else ())


def derivative_shapes(chain: ClosedChain) -> dict[str, Shape]:
    """Return the shapes of cotangents and tangents by result and argument; those of poses are [rotation; shift]."""
    known = shapes(chain)
    return {name: known[name] for name in results_of(chain)} | gradient_shapes(chain)


def options_of(options: Options, arguments: Sequence[str], moving: bool = False) -> Options:
    """Return the options for derivatives: arguments of the derivatives must be run-time parameters."""
    return replace(
        options,
        link_inertia=options.link_inertia or any(name in (*LINKS, *TRUNK_LINKS) for name in arguments),
        link_wrenches=options.link_wrenches or any(name in WRENCHES for name in arguments),
        base_motion=options.base_motion or moving or any(name in MOVING for name in arguments),
    )
