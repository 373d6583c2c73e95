"""The derivatives of a function of a compiled chain, each a function made when it is first requested."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from holdfast.compiled.computation import Computation
from holdfast.compiled.derivative_computation import request_of
from holdfast.compiled.derivative_schedule import WITH, DerivativeKind, Request
from holdfast.compiled.derivatives import CompiledDerivatives
from holdfast.compiled.parameters import require_inputs
from holdfast.compiled.structure import Options
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called, wrong_call
from holdfast.questions.derivatives import unit_cotangent
from holdfast.questions.question import Question

_PLACED = inspect.Parameter.POSITIONAL_OR_KEYWORD
_FURTHER = inspect.Parameter("further", inspect.Parameter.VAR_KEYWORD)

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain
    from holdfast.compiled.function import Function


@called
class Differentiated:
    """The part of a `Function` that differentiates it."""

    compiled: CompiledChain
    chain: ClosedChain
    question: Question
    request: Request | None
    computation: Computation
    _options: Options

    if TYPE_CHECKING:

        def __call__(self, *given: Any, **further: Any) -> Any:
            """See `Function`."""

        @classmethod
        def of(cls, *made: Any) -> Function:
            """See `Function`."""
            ...

    @property
    def name(self) -> str:
        """The name of the question, with the kind of derivatives if these are computed."""
        return self.question.name if self.request is None else f"{self.question.name}.{self.request.kind}"

    def vjp(
        self,
        *given: Any,
        by: Sequence[str] | None = None,
        out: Any = None,
        threads: int | None = None,
        **cotangents_and_parameters: Any,
    ) -> CompiledDerivatives:
        """Return the gradients of sum(cotangent . result), at a few times the cost of the answer.

        Args:
            *given: the arguments of the question, in order or by name.
            by: the arguments of which gradients are returned; by default `question.by`.
            out: earlier derivatives of the same names, to be overwritten.
            threads: as in a call.
            **cotangents_and_parameters: cotangents by result, and parameters as in a call.

        Returns:
            The gradient by every argument, in the shape of the argument; by poses (.., 6) [turn; shift]. In a batch,
            gradients of a system without an answer are NaN.

        Raises:
            StateError: A name, shape or number is wrong, or a cotangent belongs to forces that are not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        further, results = cotangents_and_parameters, self._names
        cotangents = {name: further.pop(name) for name in results if name in further}
        cotangents = cotangents or unit_cotangent(self.question, self.chain)
        by = self.question.by if by is None else by
        return self.derived("vjp", tuple(cotangents), by)._with(given, cotangents, further, out, threads)

    def jvp(
        self,
        *given: Any,
        along: Mapping[str, Any] | None = None,
        of: Sequence[str] | None = None,
        out: Any = None,
        threads: int | None = None,
        **parameters: Any,
    ) -> CompiledDerivatives:
        """Return the rates of the results along tangents of the arguments, at a few times the cost of the answer.

        Args:
            *given: the arguments of the question, in order or by name.
            along: the tangents by argument, each in the shape of the argument's gradient; (d, ...) for d directions of
                one system at once, (batch, ...) for a batch.
            of: the results; by default all.
            out: earlier derivatives of the same names, to be overwritten.
            threads: as in a call.
            **parameters: parameters as in a call.

        Returns:
            The rate of every result, in the shape of the result, with a leading axis if there are several directions
            or a batch.

        Raises:
            StateError: A name, shape or number is wrong, or a requested force is not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        checks.instance(along, Mapping, f"{self.name}.jvp: along", StateError)
        assert along is not None
        return self.derived("jvp", self._names if of is None else of, tuple(along))._with(
            given, along, parameters, out, threads
        )

    def jacobian(
        self,
        *given: Any,
        of: Sequence[str] | None = None,
        by: Sequence[str] | None = None,
        out: Any = None,
        threads: int | None = None,
        **parameters: Any,
    ) -> CompiledDerivatives:
        """Return the Jacobian.

        Args:
            *given: the arguments of the question, in order or by name.
            of: the results; by default `question.of`.
            by: the arguments; by default `question.by`.
            out: earlier derivatives of the same names, to be overwritten.
            threads: as in a call.
            **parameters: parameters as in a call.

        Returns:
            `found[of, by]`, with the axes of the result and then those of the argument's gradient; a batch comes first.

        Raises:
            StateError: A name, shape or number is wrong, or a requested force is not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        return self._chosen("jacobian", of, by)._with(given, {}, parameters, out, threads)

    def _chosen(self, kind: DerivativeKind, of: Sequence[str] | None, by: Sequence[str] | None) -> Function:
        """Return the function of some derivatives, by default those of the question."""
        results = self.question.of or self._names
        return self.derived(kind, results if of is None else of, self.question.by if by is None else by)

    def derived(self, kind: DerivativeKind, of: Sequence[str], by: Collection[str]) -> Function:
        """Return the function of some derivatives; its machine code is made when it is first requested.

        Raises:
            StateError: A name is unknown, or the question cannot be differentiated.
        """
        try:
            asked = kind, type(of), tuple(of), type(by), tuple(by)  # types: a string is not a list of names
            return self._made[asked]
        except (KeyError, TypeError):  # asked for the first time, or no names
            request = request_of(self.question, self.chain, kind, of, by)
        if (found := self._made.get(request)) is None:
            found = self._made[request] = type(self).of(self.compiled, self.question, request, self._options)
        self._made[kind, type(of), tuple(of), type(by), tuple(by)] = found
        return found

    def _with(
        self, given: Sequence[Any], vectors: Mapping[str, Any], further: dict[str, Any], out: Any, threads: int | None
    ) -> CompiledDerivatives:
        """Return derivatives, of the question's inputs, cotangents or tangents, and parameters."""
        assert self.request is not None
        own, values = [name for name in self.computation.inputs if not name.startswith(WITH)], [*given]
        inputs = self.question.inputs
        if len(given) > len(inputs) or any(name not in further for name in inputs[len(given) :]):
            asked = inspect.Signature([inspect.Parameter(name, _PLACED) for name in inputs] + [_FURTHER])
            raise wrong_call(asked, self.name, given, further) or AssertionError(self.name)
        require_inputs([name for name in own if name not in inputs], further)
        values += [further.pop(name) for name in own[len(given) :]]
        values += [vectors[name] for name in self.request.given]
        if threads is None:
            return self(*values, out=out, **further)
        return self(*values, out=out, threads=threads, **further)

    @cached_property
    def _names(self) -> tuple[str, ...]:
        """The names of the results that can be differentiated."""
        return self.question.names_at(self.chain)

    @cached_property
    def _made(self) -> dict[Any, Function]:
        return {}
