"""Which derivatives of forward dynamics machine code computes, in the terms of a forest or of its chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from holdfast.compiled.derivative_schedule import FOUND, WITH
from holdfast.compiled.forest_schedule import TracedSolution, gradients, rates
from holdfast.compiled.forest_terms import ForestTerms, forest_result_shapes
from holdfast.compiled.result import INDETERMINATE, Results
from holdfast.compiled.traced_chain import Given
from holdfast.dynamics.tree.mechanism_terms import ForestPlace
from holdfast.errors import StateError
from holdfast.questions.arrays import Shape
from holdfast.spatial.scalar import Array

OF_CLOSURES = ("grasp_wrench", "closure_wrench", "coupling_force")


@dataclass(frozen=True)
class ForestRequest:
    """A request for derivatives of forward dynamics.

    Attributes:
        kind: `vjp` (the product of cotangents of results with the Jacobian) or `jvp` (that with tangents of arguments).
        results: the results to differentiate.
        arguments: the arguments by which they are differentiated.
    """

    kind: Literal["vjp", "jvp"]
    results: tuple[str, ...]
    arguments: tuple[str, ...]

    @property
    def name(self) -> str:
        """The request's name in the key of the cache."""
        return f"{self.kind}({','.join(self.results)};{','.join(self.arguments)})"

    def given(self, terms: ForestTerms) -> dict[str, Shape]:
        """Return the shapes of cotangents of results (`vjp`), or of tangents of arguments (`jvp`), by array."""
        of, names = (terms.outputs, self.results) if self.kind == "vjp" else (_shapes(terms), self.arguments)
        return {f"{WITH}{name}": of[name] for name in names}

    def found(self, terms: ForestTerms) -> dict[str, Shape]:
        """Return the shapes of gradients by argument (`vjp`), or of rates of results (`jvp`), by array."""
        of, names = (_shapes(terms), self.arguments) if self.kind == "vjp" else (terms.outputs, self.results)
        return {f"{FOUND}{name}": of[name] for name in names}

    def outputs(self, terms: ForestTerms, solved: TracedSolution, given: Given) -> dict[str, Any]:
        """Return the derivatives by array, of traced arrays."""
        by = {name: terms.arguments_by[name] for name in self.arguments}
        results = {name: terms.results_of[name] for name in self.results}
        if self.kind == "vjp":
            bars = _zeros(results, forest_result_shapes(terms.forest))
            for name, place in results.items():
                place.add(given[f"{WITH}{name}"], bars)
            found = gradients(solved, bars, [*dict.fromkeys(place.name for place in by.values())])
            return {f"{FOUND}{name}": place.of(found) for name, place in by.items()}
        values = solved.given.values([place.name for place in by.values()])
        along = _zeros(by, {name: (*x.shape, 1) for name, x in values.items()})
        for name, place in by.items():
            place.add(given[f"{WITH}{name}"], along, 1)
        moved = rates(solved, along)
        return {f"{FOUND}{name}": place.of(moved, 1)[..., 0] for name, place in results.items()}

    def settle(self, terms: ForestTerms, result: Results) -> None:
        """Refuse derivatives of forces that are not unique; in a batch they become NaN."""
        choices = [name for name in self.results if name in OF_CLOSURES]
        low = np.atleast_1d(result.array("status")) == INDETERMINATE
        if not choices or not low.any():
            return
        if result.batch is None:
            require_unique(terms, choices[0])
        for name in self.found(terms):
            if self.kind == "vjp" or name.removeprefix(FOUND) in choices:
                result.array(name)[low] = np.nan


def require_unique(terms: ForestTerms, name: str) -> None:
    """Refuse derivatives of forces that are not unique.

    Raises:
        StateError: always.
    """
    others = ", ".join(name for name in terms.outputs if name not in OF_CLOSURES)
    raise StateError(
        f"{name}: the forces are not unique here, and machine code finds one choice among them, whose derivative means"
        f" nothing; try those of {others}"
    )


def _shapes(terms: ForestTerms) -> dict[str, Shape]:
    return {name: place.shape for name, place in terms.arguments_by.items()}


def _zeros(places: Mapping[str, ForestPlace], shapes: Mapping[str, Shape]) -> dict[str, Array]:
    return {place.name: np.zeros(shapes[place.name]).astype(object) for place in places.values()}
