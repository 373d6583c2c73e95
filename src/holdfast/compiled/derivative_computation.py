"""Derivatives of a chain's other functions as computations: the reference's functions, linearised while traced."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.compiled.arm_functions import COMPUTATIONS, Computation, own_inputs, traced_case
from holdfast.compiled.derivative_schedule import FOUND, UNITS, WITH, Request, derivative_shapes
from holdfast.compiled.externals import LINKS, shapes
from holdfast.compiled.recorded_loops import recorded_loops
from holdfast.compiled.traced_chain import Given
from holdfast.compiler.program import Shape
from holdfast.dynamics.closure_derivatives import CLOSURE
from holdfast.dynamics.energy_derivatives import KINETIC, POTENTIAL
from holdfast.dynamics.inverse_derivatives import TORQUES
from holdfast.dynamics.linearised_function import Differentiable, LinearisedFunction, Part, linearised_function
from holdfast.forces.force_derivatives import MARGINS, OF_LIMITS, WRISTS
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, concatenate

DIFFERENTIABLE = {
    function.name: function for function in (TORQUES, KINETIC, POTENTIAL, CLOSURE, MARGINS, OF_LIMITS, WRISTS)
}
OF_EACH_JOINT = {"q", "qd", "qdd", "tau", "armature", "damping", "link_wrench", *LINKS}  # arguments, row by row


@dataclass(frozen=True)
class FunctionRequest(Request):
    """A request for derivatives of a function that is evaluated directly, without solving the equations of motion.

    Attributes:
        function: its name, one of `DIFFERENTIABLE`.
    """

    function: str

    @property
    def name(self) -> str:
        """The request's name in the key of the cache."""
        return self.name_for(self.function)

    @property
    def definition(self) -> Differentiable:
        """The function as it is differentiated."""
        return DIFFERENTIABLE[self.function]

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
        known = shapes(chain)
        of_results = {name: self.definition.shape(chain, name) for name in self.definition.results}
        return derivative_shapes(chain) | {name: known[name] for name in own_inputs(self.function, chain)} | of_results

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
        parts = self.definition.parts_of(chain, of)
        return [(part.entries, own_entries(self.definition, chain, part, by, shape)) for part in parts]

    def computation(self, chain: ClosedChain) -> Computation:
        """Return the computation of the function's results and these derivatives."""
        base, known = COMPUTATIONS[self.function], self.shapes(chain)
        given = {f"{WITH}{name}": known[name] for name in self.given}
        fixed: dict[str, Any] = {}
        if self.kind == "jacobian":
            parts = [part.entries for of in self.results for part in self.definition.parts_of(chain, of)]
            fixed[UNITS] = np.eye(max(map(size_of, parts), default=0))
        return replace(
            base,
            inputs=(*base.inputs, *given),
            function=self._outputs,
            results={},
            whole={name: known[name] for name in self.definition.results}
            | {f"{FOUND}{name}": shape for name, shape in self.found(chain).items()},
            by_grasp=base.by_grasp or "grasp_wrench" in base.inputs or "grasp_pose" in self.arguments,
            further=given,
            fixed=fixed,
        )

    def _outputs(self, chain: ClosedChain, x: Given) -> Mapping[str, Any]:
        """Return the function's results and their derivatives by running the reference's functions on traced arrays."""
        case = traced_case(chain, x, self.function)
        with recorded_loops():
            at = linearised_function(self.definition, case, self.arguments)
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


def own_entries(function: Differentiable, chain: ClosedChain, part: Part, by: str, shape: Shape) -> slice:
    """Return the entries of an argument, flat, on which a part of a result may depend.

    Arms on bases of their own depend on what is theirs, on gravity, and some results also on the object. Where springs
    or bushings act, everything may depend on everything.

    Args:
        function: the function as it is differentiated.
        chain: the chain.
        part: the part.
        by: the argument.
        shape: the shape of its gradient.
    """
    whole, none, size = slice(0, math.prod(shape)), slice(0, 0), math.prod(shape[1:])
    if function.parts is None or chain.trunk is not None or by == "gravity" or part.arm is None:
        return whole
    if COMPUTATIONS[function.name].by_place(chain):
        return whole
    if by.startswith(("object", "grasp_pose")) and not function.of_object:
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
