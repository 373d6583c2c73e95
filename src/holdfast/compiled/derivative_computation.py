"""Derivatives of questions that need no linear solve, as computations: linearised while they are traced."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from holdfast.compiled.computation import (
    Computation,
    arrays_of,
    computation,
    iterated,
    source_key,
    structure_of,
    traced_case,
)
from holdfast.compiled.derivative_schedule import (
    FOUND,
    UNITS,
    WITH,
    DerivativeKind,
    ForwardRequest,
    Request,
    derivative_shapes,
    options_of,
)
from holdfast.compiled.forward_schedule import forward_computation
from holdfast.compiled.recorded_loops import recorded_loops
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import Given, traced, traced_chain
from holdfast.dynamics.forward import FORWARD_DYNAMICS
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import without_contacts
from holdfast.questions.arrays import ARRAYS, LINKS, Shape
from holdfast.questions.derivatives import require_names
from holdfast.questions.linearised_function import LinearisedFunction, linearised_function
from holdfast.questions.question import Question, ResultPart
from holdfast.spatial.scalar import Array, concatenate

OF_EACH_JOINT = {"q", "qd", "qdd", "tau", "armature", "damping", "link_wrench", *LINKS}  # arguments, row by row


@dataclass(frozen=True)
class FunctionRequest(Request):
    """A request for derivatives of a question that is answered directly, without solving the equations of motion."""

    def found(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return the shapes of the derivatives: by argument (`vjp`), by result (`jvp`), or of `blocks` (`jacobian`)."""
        known = self.shapes(chain)
        if self.kind == "jacobian":
            return {
                f"{of}.{by}": (sum(size_of(part) * size_of(own) for part, own in self.blocks(chain, of, by)),)
                for of in self.results
                for by in self.arguments
            }
        return {name: known[name] for name in (self.arguments if self.kind == "vjp" else self.results)}

    def shapes(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return the shapes of results, and of gradients by arguments."""
        of_results = {name: self.question.shape(chain, name) for name in self.question.names_at(chain)}
        own = {name: ARRAYS[name].shape(chain) for name in self.question.own(chain)}
        return derivative_shapes(chain) | own | of_results

    def matrix(self, chain: ClosedChain, of: str, by: str, found: Array) -> Array:
        """Return a Jacobian, (..., *shape of the result, *shape of the argument), of its blocks (..., numbers)."""
        known, lead, begin = self.shapes(chain), found.shape[:-1], 0
        whole = np.zeros((*lead, math.prod(known[of]), math.prod(known[by])))
        for part, entries in self.blocks(chain, of, by):
            end = begin + size_of(part) * size_of(entries)
            whole[..., part, entries] = found[..., begin:end].reshape(*lead, size_of(part), size_of(entries))
            begin = end
        return whole.reshape((*lead, *known[of], *known[by]))

    def blocks(self, chain: ClosedChain, of: str, by: str) -> list[tuple[slice, slice]]:
        """Return for each part of a result its entries, and those of an argument on which it may depend.

        Only these blocks of a Jacobian are computed and stored.
        """
        shape = self.shapes(chain)[by]
        parts = self.question.parts_of(chain, of)
        return [(part.entries, own_entries(self.question, chain, part, by, shape)) for part in parts]

    def computation(self, chain: ClosedChain, options: Options) -> Computation:
        """Return the computation of the question's results and these derivatives."""
        question, known = self.question, self.shapes(chain)
        seen = structure_of(question, chain, options_of(options, self.arguments, True))
        by_grasp = seen.by_grasp or "grasp_wrench" in question.inputs or "grasp_pose" in self.arguments
        structure = Structure(chain, seen.options, by_grasp, seen.by_links)
        fixed: dict[str, Any] = {}
        if self.kind == "jacobian":
            parts = [part.entries for of in self.results for part in question.parts_of(chain, of)]
            fixed[UNITS] = np.eye(max(map(size_of, parts), default=0))
        given = {f"{WITH}{name}": known[name] for name in self.given}
        own = {name: known[name] for name in question.names_at(chain)}
        found = own | {f"{FOUND}{name}": shape for name, shape in self.found(chain).items()}
        found |= question.feasibility(chain)
        arrays = arrays_of(question, structure, given, fixed, found)
        return Computation(
            self.name + source_key(question),
            structure,
            arrays,
            lambda: traced(arrays, lambda x: self._outputs(iterated(question, structure.options), structure, x)),
            (*question.inputs, *given),
            tuple(question.by_name(chain)),
            fixed,
        )

    def _outputs(self, question: Question, structure: Structure, x: Given) -> dict[str, Any]:
        """Return the question's results and their derivatives by running the reference's functions on traced arrays."""
        case = traced_case(question, traced_chain(structure, x), x)
        with recorded_loops():
            at = linearised_function(question, case, self.arguments)
        return {**at.results, **{f"{FOUND}{name}": of for name, of in self._found(at, x).items()}}

    def _found(self, at: LinearisedFunction, x: Given) -> dict[str, Any]:
        given = {name: x[f"{WITH}{name}"] for name in self.given}
        if self.kind == "jacobian":
            chain, known = at.case.chain, self.shapes(at.case.chain)
            rows = {of: at.rows(of, x[UNITS]) for of in self.results}
            return {
                f"{of}.{by}": concatenate(
                    rows[of][by].reshape(math.prod(known[of]), math.prod(known[by]))[part, entries].ravel()
                    for part, entries in self.blocks(chain, of, by)
                )
                for of in self.results
                for by in self.arguments
            }
        return at.gradient(given) if self.kind == "vjp" else at.rates(given)


def own_entries(question: Question, chain: ClosedChain, part: ResultPart, by: str, shape: Shape) -> slice:
    """Return the entries of an argument, flat, on which a part of a result may depend.

    Arms on bases of their own depend on what is theirs, on gravity, and some results also on the object. Where springs
    or bushings act, everything may depend on everything.

    Args:
        question: the question that is differentiated.
        chain: the chain.
        part: the part.
        by: the argument.
        shape: the shape of its gradient.
    """
    whole, none, size = slice(0, math.prod(shape)), slice(0, 0), math.prod(shape[1:])
    if question.parts is None or chain.trunk is not None or by == "gravity" or part.arm is None:
        return whole
    if question.by_place(chain):
        return whole
    if by.startswith(("object", "grasp_pose")) and not question.of_object:
        return none
    if by.startswith("object"):
        return whole
    row, name = slice(part.arm, part.arm + 1), chain.names[part.arm]
    if by == "grasp_pose":
        if name not in chain.grasps:
            return none
        k = list(chain.grasps).index(name)
        row = slice(k, k + 1)
    elif by in OF_EACH_JOINT:
        row = chain.joints[name]
    return slice(size * row.start, size * row.stop)


def size_of(part: slice) -> int:
    """Return how many entries there are."""
    return part.stop - part.start


def request_of(
    question: Question, chain: ClosedChain, kind: DerivativeKind, of: Collection[str], by: Collection[str]
) -> Request:
    """Return the request for some derivatives of a question.

    Raises:
        StateError: A name is unknown, or the question cannot be differentiated.
    """
    what, results, arguments = f"{question.name}.{kind}", question.names_at(chain), question.arguments_at(chain)
    if not arguments:
        raise StateError(f"{what}: expected a question with derivatives, got '{question.name}', which has none")
    require_names(what, of, results)
    require_names(what, by, arguments)
    made = ForwardRequest if question is FORWARD_DYNAMICS else FunctionRequest
    return made(question, kind, tuple(x for x in results if x in of), tuple(x for x in arguments if x in by))


def computation_of(question: Question, request: Request | None, chain: ClosedChain, options: Options) -> Computation:
    """Return the computation of a question, or of derivatives of it."""
    if "world" in question.depends_on and (request is not None or question is not FORWARD_DYNAMICS):
        without_contacts(chain, question.name if request is None else f"{question.name}.{request.kind}")
    if request is not None:
        return request.computation(chain, options)
    made = forward_computation if question is FORWARD_DYNAMICS else partial(computation, question)
    return made(chain, options)
