"""Derivatives of a question as machine code returns them: views of its memory, taken apart when they are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from holdfast.compiled.derivative_schedule import FOUND
from holdfast.compiled.result import Results, SolvedResults
from holdfast.model import checks
from holdfast.questions.derivatives import Derivatives
from holdfast.spatial.scalar import Array


class CompiledDerivatives(Derivatives):
    """Derivatives of a question: `found.q` or `found["q"]`, and of a Jacobian `found["qdd", "q"]`.

    A call with `out=found` overwrites them. A Jacobian of forward dynamics is a view of an array that is stored column
    by column; other Jacobians are new arrays.

    Attributes:
        request: the derivatives that were requested: a `Request`, or a `ForestRequest`.
        results: the memory that holds them.
    """

    request: Any
    results: Results
    _views: dict[Any, Array]  # Jacobians of forward dynamics, made when first asked for

    def __init__(self, request: Any, results: Results) -> None:
        self.__dict__.update(request=request, results=results, _views={})

    @property
    def result(self) -> Any:  # type: ignore[override]
        """The answer at the same arguments, such as a `ForwardResult`."""
        of = self.results
        if isinstance(of, SolvedResults):
            return of
        question = self.request.question
        return question.shown(of.chain)({name: of.array(name) for name in question.names_at(of.chain)})

    @property
    def parts(self) -> Mapping[Any, Array]:  # type: ignore[override]
        """All derivatives by name, or by result and argument."""
        return {name: self[name] for name in self._names()}

    def _names(self) -> Iterator[Any]:
        request = self.request
        if request.kind == "jacobian":
            return ((of, by) for of in request.results for by in request.arguments)
        return iter(request.arguments if request.kind == "vjp" else request.results)

    def __repr__(self) -> str:
        """Return the kind of derivatives, of which results and by which arguments they are."""
        request = self.request
        return f"<Derivatives: {request.kind} of {', '.join(request.results)} by {', '.join(request.arguments)}>"

    def __getattr__(self, name: str) -> Array:
        """Return the derivatives of one name."""
        if name.startswith("_") or f"{FOUND}{name}" not in self.results.layout.shapes:
            known = [x.removeprefix(FOUND) for x in self.results.layout.shapes if x.startswith(FOUND)]
            raise AttributeError(f"no derivative '{name}'.{checks.did_you_mean(name, known)}")
        return self.results.array(f"{FOUND}{name}")

    def __getitem__(self, name: str | tuple[str, str]) -> Array:
        """Return the derivatives of one name, or of a result by an argument, (*result's shape, *argument's shape)."""
        if isinstance(name, str):
            return getattr(self, name)
        found = self._views.get(name)
        if found is None:
            of, by = name
            stored = getattr(self, f"{of}.{by}")
            found = self.request.matrix(self.results.chain, of, by, stored)
            if found.base is not None and isinstance(self.results, SolvedResults):
                self._views[name] = found
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to copy or unpickle the derivatives: as values by name."""
        return Derivatives, (self.result, {name: x.copy() for name, x in self.parts.items()})
