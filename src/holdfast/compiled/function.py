"""A question about one chain as machine code: called for one system or a batch, differentiated, bound and exported."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from inspect import Parameter
from os import PathLike
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from holdfast.compiled import arrays, statuses
from holdfast.compiled.arrays import input_error, invalid_mask, largest_number, largest_positions
from holdfast.compiled.bound import BoundFunction
from holdfast.compiled.calls import Calls
from holdfast.compiled.computation import Computation
from holdfast.compiled.derivative_computation import computation_of
from holdfast.compiled.derivative_schedule import WITH, DerivativeKind, Request
from holdfast.compiled.derivatives import CompiledDerivatives
from holdfast.compiled.differentiated import Differentiated
from holdfast.compiled.kernels import compile_batch, compiling, kernel
from holdfast.compiled.parameters import parameters_of, parse_parameters, require_inputs
from holdfast.compiled.result import CompiledResult, Results
from holdfast.compiled.structure import Options
from holdfast.compiler.targets import Builtin
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.model import checks
from holdfast.names import called, wrong_call
from holdfast.questions.arrays import MOVING, POSES
from holdfast.questions.documentation import docstring
from holdfast.questions.question import Question
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.codegen.export import ExportedCode
    from holdfast.compiled.chain import CompiledChain


@called
class Function(Differentiated):
    """A question about a compiled chain: `compiled.inverse_dynamics(q, qd, qdd, grasp_wrench)`.

    It takes one system or a batch: any argument or parameter may have a leading batch axis, and those without it are
    shared. Results do not depend on batch size or number of threads, bit for bit. If a number is not finite, an angle
    exceeds 1e5 rad or a quaternion is not of unit length, one system raises a `StateError`; in a batch, only the
    results of that system are NaN. The state is used as given, whether or not it satisfies the grasps.

    Attributes:
        question: the question.
        request: the derivatives of it that are computed; None for the answer alone.
        compiled: the compiled chain.
        chain: the chain.
        externals: the arrays that the machine code reads and writes, by name.
        has_status: whether every system has a status, because its equations may have no solution.
    """

    def __new__(cls, compiled: CompiledChain, question: Question, *_: Any, **__: Any) -> Function:
        """Return a function with a class of its own, because Python looks `__call__` up in the class."""
        own: Any = type(cls.__name__, (cls,), {"__module__": cls.__module__, "__doc__": docstring(question)})
        return object.__new__(own)

    @classmethod
    def of(cls, *made: Any) -> Function:
        """Return a new function; see the constructor."""
        return Function(*made)

    def __init__(
        self,
        compiled: CompiledChain,
        question: Question,
        request: Request | None = None,
        options: Options | None = None,
        computation: Computation | None = None,
    ) -> None:
        """Store what is computed; the machine code is made when it is first needed.

        Args:
            compiled: the compiled chain.
            question: the question.
            request: the derivatives of it to be computed; None for the answer alone.
            options: the options of the machine code; by default those of the chain.
            computation: what machine code computes; by default it follows from the question.
        """
        self.compiled, self.chain, self.question, self.request = compiled, compiled.chain, question, request
        self._options = options or compiled.options
        self.computation = made = computation or computation_of(question, request, self.chain, self._options)
        self.externals, self.has_status = dict(made.externals), made.has_status
        self._inputs = (*made.inputs, *made.by_name)
        self._show = question.shown(self.chain)
        self._rank, self._largest = compiled.generic_rank, largest_positions(self.chain)
        self._ranks = {name: len(e.shape) for name, e in self.externals.items()}

    @cached_property
    def calls(self) -> Calls:
        """The calls of the machine code, which is made or loaded when they are first needed."""
        made = self.computation
        with compiling(self.chain, self.name, self.compiled.progress):
            code = kernel(made)
        own = parameters_of(self.chain, self._rank) | dict(made.fixed)
        return Calls(code, {name: x for name, x in own.items() if name not in self._inputs})

    @cached_property
    def _builtin(self) -> Builtin:
        """The builtin that answers plain calls, of the inputs in order and by name."""
        made, question, code, given = self.computation, self.question, self.calls.kernel, self._inputs
        first = given if tuple(self.externals)[: len(given)] == given else made.inputs
        own = self._own = self.results(None)
        builtin = Builtin(
            code.single_address,
            self.calls.own_table(),
            [self.externals[name].shape for name in first],
            self._checked,
            self.name,
            f"({', '.join(made.inputs)}, *, out=None, threads=None, **parameters)",
            question.summary,
            [name.removeprefix(WITH) for name in first],
            len(first) - len(made.inputs),
            [] if self.has_status else [largest_number(name) for name in first],
            [name in POSES for name in first],
            0 if self.has_status else 2 if question.unlimited else 1,
        )
        if not self._plain:
            return builtin
        table = np.array(self.calls.row({}, own), dtype=np.int64)
        if (only := self.only_array(own)) is not None:
            builtin.answer(table, own.memory, only.copy if only.ndim else only.item)
        else:
            builtin.answer(table, own.memory, own.memory.copy, self._of_copy)
        return builtin

    @cached_property
    def _plain(self) -> bool:
        """Whether machine code can tell which calls it may answer: from inputs and results, number by number."""
        question, chain = self.question, self.chain
        admits_all = question.require is None or len(chain.grasps) == len(chain.arms)
        mixed = (
            self.request is not None and question.unlimited
        )  # results that may be infinite, derivatives that may not
        return self.has_status or (admits_all and not question.feasibility(chain) and not mixed)

    def _of_copy(self, memory: Array) -> Any:
        layout = self.calls.layout
        if self.has_status or self.request is not None:
            return self.shown(type(self._own)(self.chain, layout, None, memory))
        return self._show({name: layout.view(name, memory, None) for name in self._names})  # in half the time

    @property
    def subject(self) -> str:
        """The chain's arms, for descriptions."""
        return ", ".join(self.chain.names)

    def __repr__(self) -> str:
        """Return the question and the chain."""
        return f"<{self.name} of {self.chain!r}>"

    @property
    def __signature__(self) -> inspect.Signature:
        """The parameters of a call, for completion and help."""
        by_name = [Parameter("out", Parameter.KEYWORD_ONLY, default=None)]
        by_name += [Parameter("threads", Parameter.KEYWORD_ONLY, default=None)]
        names = [name.replace(WITH, "with_") for name in self.computation.inputs]
        given = [Parameter(name, Parameter.POSITIONAL_OR_KEYWORD) for name in names]
        return inspect.Signature([*given, *by_name, Parameter("parameters", Parameter.VAR_KEYWORD)])

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to unpickle the function: its machine code is loaded from the cache or made again."""
        return Function, (self.compiled, self.question, self.request, self._options)

    def __call__(self, *given: Any, out: Any = None, threads: int | None = None, **parameters: Any) -> Any:
        """Return the answer for one system, or for a batch.

        Args:
            *given: the arrays of `question.inputs`, in order or by name.
            out: an earlier answer, to be overwritten; single calls that reuse it are the fastest.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: values for this call of run-time parameters. An object_mass requires an object_inertia;
                "scale" scales the chain's own with the mass.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
            SingularChainError: The configuration of a single system is singular.
        """
        # The builtin runs calls that repeat `out`, or have none, in machine code; it passes all others to `_checked`.
        type(self).__call__ = self._builtin.function  # type: ignore[method-assign]
        return self(*given, out=out, threads=threads, **parameters)

    def _checked(self, *given: Any, out: Any = None, threads: int | None = None, **parameters: Any) -> Any:
        """Answer the calls that the builtin does not."""
        arrays.require_threads(threads)
        if any(name in parameters and name not in self.externals for name in MOVING):
            return self.when_moving(*given, out=out, threads=threads, **parameters)
        if self._rank != self.compiled.generic_rank:
            self._rank = self.compiled.generic_rank
            self.calls.set_rank(self._rank)
        found = self._arrays(given, parameters)
        batch = arrays.batch_of(found, self.externals)
        inputs = {name: found[name] for name in self._inputs}
        if batch is None and not self.has_status and (wrong := input_error(inputs, self._largest)) is not None:
            raise wrong
        result = self._results_of(out, batch)
        kept = self._plain and isinstance(out, Results | CompiledDerivatives)
        if kept and batch is None and len(found) == len(inputs):
            self._builtin.expect(out, result.memory, self.calls.row(found, result)[len(found) :])
        if batch is not None:
            compile_batch(self.calls.kernel, self.chain, self.name, self.compiled.progress)
        if not self.calls(found, result, threads):
            statuses.settle(self, self.calls.own | found | _origins(parameters), result)
        if not self.has_status:
            self._settle(inputs, result)
        return overwritten(out, self.shown(result), self.name)

    def _arrays(self, given: Sequence[Any], by_name: Mapping[str, Any]) -> dict[str, Array]:
        """Return the arrays of a call as machine code reads them, inputs first.

        Raises:
            CallError: A name is missing or given twice.
            StateError: A name is unknown, or a shape is wrong.
        """
        names, further = self.computation.inputs, dict(by_name)
        placed, named = names[: len(given)], names[len(given) :]
        if len(placed) < len(given) or not further.keys() >= {*named} or not further.keys().isdisjoint(placed):
            raise wrong_call(self.__signature__, self.name, given, by_name) or AssertionError(self.name)
        values = dict(zip(placed, given, strict=True)) | {name: further.pop(name) for name in named}
        require_inputs(self.computation.by_name, further)
        values |= {name: further.pop(name) for name in self.computation.by_name}
        shapes = self.externals
        found = {name: arrays.floats(name.removeprefix(WITH), x, shapes[name].shape) for name, x in values.items()}
        if self.question.require is not None:
            self.question.require(self.chain, found)
        found |= parse_parameters(further, self.externals, self.chain) if further else {}
        if self.request is not None and self.question.differentiable is not None:
            self.question.differentiable(self.name, self.calls.own | found)
        return found

    def results(self, batch: int | None) -> Results:
        """Return new memory for the results of one system, or of a batch."""
        kind = CompiledResult if self.has_status else Results
        return kind(self.chain, self.calls.layout, batch)

    def _results_of(self, out: Any, batch: int | None) -> Results:
        """Return the memory for the results of a call: that of earlier results, if these have memory of their own.

        Raises:
            StateError: `out` belongs to another function, or has another batch size.
        """
        if out is None or not (self.has_status or self.request is not None):
            return self.results(batch)
        results = out.results if isinstance(out, CompiledDerivatives) else out
        if (out.request if isinstance(out, CompiledDerivatives) else None) != self.request:
            raise StateError("out: expected earlier derivatives of the same names; leave it out first")
        arrays.require_fit(results, self.chain, batch)
        return results

    def _settle(self, inputs: Mapping[str, Array], result: Results) -> None:
        """Refuse one system without a finite answer; make the answers of such systems in a batch NaN."""
        found = {name: result.array(name) for name in result.layout.shapes}
        if result.batch is not None:
            bad = invalid_mask(inputs, self._ranks, self._largest, result.batch)
            for x in found.values() if bad is not None else ():
                x[bad] = np.nan
        self.question.settle(self.chain, inputs, found)
        for name, x in found.items() if result.batch is None else ():
            checks.finite(np.where(np.isposinf(x), 0.0, x) if self.question.unlimited else x, name)

    def only_array(self, results: Results) -> Array | None:
        """Return the only array of the results if a user gets that, or its number, as it is; otherwise None."""
        if self.request is not None or self.has_status or not self.question.shows_one:
            return None
        return results.array(self._names[0])

    def shown(self, results: Results) -> Any:
        """Return what a user gets of the results in memory."""
        if self.request is not None:
            return CompiledDerivatives(self.request, results)
        if isinstance(results, CompiledResult):
            return results
        return self._show({name: results.array(name) for name in self._names})

    def bind(
        self,
        kind: DerivativeKind | None = None,
        *,
        of: Sequence[str] | None = None,
        by: Sequence[str] | None = None,
        **arrays_or_parameters: Any,
    ) -> BoundFunction:
        """Return the function, or derivatives of it, bound to fixed arrays: a call without arguments.

        Args:
            kind: `vjp`, `jvp` or `jacobian`; None for the answer.
            of: the results that are differentiated; by default `question.of`.
            by: the arguments by which they are differentiated; by default `question.by`.
            **arrays_or_parameters: arrays of the caller for inputs, which are read at every call (float64, C order);
                new arrays are made for the others. Parameters are given as in a call.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        if any(name in arrays_or_parameters and name not in self.externals for name in MOVING):
            return self.when_moving.bind(kind, of=of, by=by, **arrays_or_parameters)
        if kind is None:
            return BoundFunction(self, arrays_or_parameters)
        if kind not in get_args(DerivativeKind):
            raise StateError(
                f"{self.name}.bind: expected vjp, jvp or jacobian, got {checks.short(kind)}."
                f"{checks.did_you_mean(str(kind), get_args(DerivativeKind))}"
            )
        return BoundFunction(self._chosen(kind, of, by), arrays_or_parameters)

    def export(self, folder: str | PathLike[str], **options: Any) -> ExportedCode:
        """Write the function as C or object files that run without Python; see `CompiledChain.export`."""
        return self.compiled.export(folder, functions=[self.name.replace(".", "_")], **options)

    @cached_property
    def when_moving(self) -> Function:
        """The function for moving bases; it is made when the motion of a base is first given."""
        return Function(self.compiled, self.question, self.request, replace(self._options, base_motion=True))


class NotCompiledError(MethodNotApplicable, AttributeError):
    """A compiled chain has no such method; the message says why and what to use instead."""


def _origins(parameters: Mapping[str, Any]) -> dict[str, Array]:
    """Return the positions of given bases, which only the search for the generic rank needs."""
    given = parameters.get("base_pose")
    return {} if given is None else {"base_p": np.array(given, dtype=float)[..., 4:]}


def overwritten(out: Any, answer: Any, what: str) -> Any:
    """Return `out` with the numbers of an answer; the answer itself if `out` is None or has the same memory.

    Raises:
        StateError: `out` is no earlier answer of the same shape.
    """
    if out is None:
        return answer
    if isinstance(answer, CompiledResult | CompiledDerivatives):
        return out
    parts, targets = arrays_in(answer), arrays_in(out)
    if [x.shape for x in parts] != [x.shape for x in targets] or not all(x.flags.writeable for x in targets):
        raise StateError(f"{what}: out: expected an earlier answer with arrays of the same shapes; leave it out")
    for x, target in zip(parts, targets, strict=True):
        target[...] = x
    return out


def arrays_in(answer: Any) -> list[Array]:
    """Return the arrays of an answer, which may be nested in tuples and mappings."""
    if isinstance(answer, Mapping | tuple):
        parts = answer.values() if isinstance(answer, Mapping) else answer
        return [x for part in parts for x in arrays_in(part)]
    return [answer] if isinstance(answer, np.ndarray) else []
