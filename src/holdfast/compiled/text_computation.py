"""Derivatives of a chain's other functions as computations: the reference's texts, made linear as they are traced."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np

from holdfast.compiled.arm_functions import COMPUTATIONS, Computation
from holdfast.compiled.derivative_schedule import FOUND, UNITS, WITH, derivative_shapes
from holdfast.compiled.externals import STATE, shapes
from holdfast.compiled.recorded_loops import recorded_loops
from holdfast.compiled.traced_chain import Given, traced_inputs, traced_state
from holdfast.compiler.program import Shape
from holdfast.dynamics.energy_derivatives import KINETIC, POTENTIAL
from holdfast.dynamics.inverse_derivatives import TORQUES
from holdfast.dynamics.linear_text import LinearText, Text, linear_text
from holdfast.dynamics.varied_case import VariedCase
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, concatenate

TEXTS = {text.name: text for text in (TORQUES, KINETIC, POTENTIAL)}


class TextRequest(NamedTuple):
    """A request for derivatives of a function that is evaluated directly, without solving the equations of motion.

    Attributes:
        function: its name, one of `TEXTS`.
        kind: `vjp`, `jvp` or `jacobian`, as in `derivative_schedule.Request`.
        results: the results to differentiate.
        arguments: the arguments by which they are differentiated.
    """

    function: str
    kind: Literal["vjp", "jvp", "jacobian"]
    results: tuple[str, ...]
    arguments: tuple[str, ...]

    @property
    def name(self) -> str:
        """The request's name in the key of the cache."""
        return f"{self.function}_{self.kind}({','.join(self.results)};{','.join(self.arguments)})"

    @property
    def text(self) -> Text:
        """The function as it is differentiated."""
        return TEXTS[self.function]

    @property
    def given(self) -> tuple[str, ...]:
        """The results that have cotangents (`vjp`) or the arguments that have tangents (`jvp`)."""
        return {"vjp": self.results, "jvp": self.arguments, "jacobian": ()}[self.kind]

    @property
    def own(self) -> tuple[str, ...]:
        """What the function is given besides the state."""
        return own_inputs(self.function)

    def found(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return the shapes of the derivatives: by argument (`vjp`), by result (`jvp`), or of `blocks` (`jacobian`)."""
        known = self.shapes(chain)
        if self.kind == "jacobian":
            sizes = {
                by: sum(size_of(part) * size_of(own) for part, own in blocks(self.text, chain, by, known[by]))
                for by in self.arguments
            }
            return {f"{of}.{by}": (sizes[by],) for of in self.results for by in self.arguments}
        return {name: known[name] for name in (self.arguments if self.kind == "vjp" else self.results)}

    def shapes(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return the shapes of results, and of gradients by arguments."""
        known = shapes(chain)
        of_results = {name: known.get(name, ()) for name in self.text.results}
        return derivative_shapes(chain) | {name: known[name] for name in self.own} | of_results

    def matrix(self, chain: ClosedChain, of: str, by: str, found: Array) -> Array:
        """Return a Jacobian, (..., *shape of the result, *shape of the argument), of its blocks (..., numbers)."""
        known, lead, begin = self.shapes(chain), found.shape[:-1], 0
        whole = np.zeros((*lead, math.prod(known[of]), math.prod(known[by])))
        for part, entries in blocks(self.text, chain, by, known[by]):
            end = begin + size_of(part) * size_of(entries)
            whole[..., part, entries] = found[..., begin:end].reshape(*lead, size_of(part), size_of(entries))
            begin = end
        return whole.reshape((*lead, *known[of], *known[by]))

    def computation(self, chain: ClosedChain) -> Computation:
        """Return the computation of the function's results and these derivatives."""
        base, known = COMPUTATIONS[self.function], self.shapes(chain)
        given = {f"{WITH}{name}": known[name] for name in self.given}
        fixed: dict[str, Any] = {}
        if self.kind == "jacobian":
            fixed[UNITS] = np.eye(max(map(size_of, parts_of(self.text, chain))))
        return replace(
            base,
            inputs=(*base.inputs, *given),
            function=self._outputs,
            whole={name: known[name] for name in self.text.results}
            | {f"{FOUND}{name}": shape for name, shape in self.found(chain).items()},
            by_grasp="grasp_wrench" in base.inputs or "grasp_pose" in self.arguments,
            further=given,
            fixed=fixed,
        )

    def _outputs(self, chain: ClosedChain, x: Given) -> Mapping[str, Any]:
        """Return the function's results and their derivatives by running the reference's functions on traced arrays."""
        case = VariedCase(chain, traced_state(chain, x), traced_inputs(chain, x), {name: x[name] for name in self.own})
        with recorded_loops():
            at = linear_text(self.text, case, self.arguments)
        return {**at.results, **{f"{FOUND}{name}": of for name, of in self._found(at, x).items()}}

    def _found(self, at: LinearText, x: Given) -> dict[str, Any]:
        given = {name: x[f"{WITH}{name}"] for name in self.given}
        if self.kind == "jacobian":
            chain, known = at.case.chain, self.shapes(at.case.chain)
            rows = {of: at.rows(of, x[UNITS]) for of in self.results}
            return {
                f"{of}.{by}": concatenate(
                    rows[of][by].reshape(math.prod(known[of]), math.prod(known[by]))[part, entries].ravel()
                    for part, entries in blocks(self.text, chain, by, known[by])
                )
                for of in self.results
                for by in self.arguments
            }
        return at.gradient(given) if self.kind == "vjp" else at.rates(given)


def own_inputs(function: str) -> tuple[str, ...]:
    """Return what a function is given besides the state."""
    return tuple(name for name in COMPUTATIONS[function].inputs if name not in STATE)


def parts_of(text: Text, chain: ClosedChain) -> Sequence[slice]:
    """Return the entries of a text's results, flat and in order, that are differentiated together."""
    return [slice(0, 1)] if text.parts is None else text.parts(chain)


def blocks(text: Text, chain: ClosedChain, by: str, shape: Shape) -> list[tuple[slice, slice]]:
    """Return for each part of the results the entries of an argument that it may depend on, flat.

    Arms on bases of their own depend on what is theirs and on gravity; only these blocks are computed and stored.

    Args:
        text: the function as it is differentiated.
        chain: the chain.
        by: the argument.
        shape: the shape of its gradient.
    """
    found = []
    for row, part in enumerate(parts_of(text, chain)):
        own = slice(0, math.prod(shape))
        if text.parts is not None and chain.trunk is None and by != "gravity":
            mine = part if shape[:1] == (chain.joint_count,) else slice(row, row + 1)
            size = math.prod(shape[1:])
            of_others = by.startswith(("object", "grasp_pose"))
            own = slice(0, 0) if of_others else slice(size * mine.start, size * mine.stop)
        found.append((part, own))
    return found


def size_of(part: slice) -> int:
    """Return how many entries there are."""
    return part.stop - part.start
