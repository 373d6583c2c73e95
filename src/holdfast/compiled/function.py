"""A question about one chain as machine code: called for one system or a batch, differentiated, bound and exported."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from holdfast.compiled import arrays, statuses
from holdfast.compiled.bound import BoundFunction
from holdfast.compiled.calls import Calls
from holdfast.compiled.derivative_computation import computation_of, request_of
from holdfast.compiled.derivative_schedule import WITH, Kind, Request
from holdfast.compiled.derivatives import CompiledDerivatives
from holdfast.compiled.faults import fault, faulty, largest_positions
from holdfast.compiled.kernels import compile_batch, compiling, kernel
from holdfast.compiled.parameters import parameters_of, parse_parameters, require_inputs
from holdfast.compiled.result import CompiledResult, Results, results_behind
from holdfast.compiled.structure import Options
from holdfast.compiler.targets import Builtin
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.questions.arrays import MOVING
from holdfast.questions.derivatives import unit_cotangent
from holdfast.questions.question import Question
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.codegen.export import ExportedCode
    from holdfast.compiled.chain import CompiledChain


class Function:
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
        calls: the calls of the machine code.
        has_status: whether every system has a status, because its equations may have no solution.
    """

    def __new__(cls, *_: Any) -> Function:
        """Return a function with a class of its own, because Python looks `__call__` up in the class."""
        own: Any = type(cls.__name__, (cls,), {"__module__": cls.__module__, "__doc__": cls.__doc__})
        return object.__new__(own)

    def __init__(
        self,
        compiled: CompiledChain,
        question: Question,
        request: Request | None = None,
        options: Options | None = None,
    ) -> None:
        """Make the machine code, or load it from the cache.

        Args:
            compiled: the compiled chain.
            question: the question.
            request: the derivatives of it to be computed; None for the answer alone.
            options: the options of the machine code; by default those of the chain.
        """
        self.compiled, self.chain, self.question, self.request = compiled, compiled.chain, question, request
        self._options, self._made = options or compiled.options, dict[Any, Function]()
        with compiling(self.chain, self.name, compiled.progress):
            self.computation = made = computation_of(question, request, self.chain, self._options)
            self.externals, self.has_status = dict(made.externals), made.has_status
            code = kernel(made.name, made.structure, self.externals, made.schedule)
        self._inputs = given = (*made.inputs, *made.by_name)
        own = parameters_of(self.chain, compiled.generic_rank) | dict(made.fixed)
        self.calls = Calls(code, {name: x for name, x in own.items() if name not in given})
        self._rank, self._largest = compiled.generic_rank, largest_positions(self.chain)
        self._ranks = {name: len(e.shape) for name, e in self.externals.items()}
        first = given if tuple(self.externals)[: len(given)] == given else made.inputs
        self._builtin = Builtin(
            code.single_address,
            self.calls.own_table(),
            [self.externals[name].shape for name in first],
            self._checked,
            self.name,
            f"({', '.join(made.inputs)}, *, out=None, threads=1, **parameters)",
            question.summary,
            [name.removeprefix(WITH) for name in first],
            len(first) - len(made.inputs),
        )
        # The builtin runs calls that repeat `out` in machine code and passes all others to `_checked`.
        type(self).__call__ = self._builtin.function  # type: ignore[method-assign]

    @property
    def name(self) -> str:
        """The name of the question, with the kind of derivatives if these are computed."""
        return self.question.name if self.request is None else f"{self.question.name}.{self.request.kind}"

    def __repr__(self) -> str:
        """Return the question and the chain."""
        return f"<{self.name} of {self.chain!r}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to unpickle the function: its machine code is loaded from the cache or made again."""
        return Function, (self.compiled, self.question, self.request, self._options)

    def __call__(self, *given: Any, out: Any = None, threads: int = 1, **parameters: Any) -> Any:
        """Return the answer for one system, or for a batch.

        Args:
            *given: the arrays of `question.inputs`, in order or by name.
            out: an earlier answer, to be overwritten; single calls that reuse it are the fastest.
            threads: the number of threads for a batch.
            **parameters: values for this call of run-time parameters. An object_mass requires an object_inertia;
                "scale" scales the chain's own with the mass.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
            SingularChainError: The configuration of a single system is singular.
        """
        raise AssertionError("every function has a class of its own")

    def _checked(self, *given: Any, out: Any = None, threads: int = 1, **parameters: Any) -> Any:
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
        if batch is None and not self.has_status and (wrong := fault(inputs, self._largest)) is not None:
            raise wrong
        result = self.results(batch) if out is None else self._results_of(out, batch)
        if out is not None and batch is None and len(found) == len(inputs) and self.has_status:
            self._builtin.expect(out, result.memory, self.calls.row(found, result)[len(found) :])
        if batch is not None:
            compile_batch(self.calls.kernel, self.chain, self.name, self.compiled.progress)
        if not self.calls(found, result, threads):
            statuses.settle(self, self.calls.own | found | _origins(parameters), result)
        if not self.has_status:
            self._settle(inputs, result)
        return self.shown(result) if out is None else out

    def _arrays(self, given: Sequence[Any], by_name: Mapping[str, Any]) -> dict[str, Array]:
        """Return the arrays of a call as machine code reads them, inputs first.

        Raises:
            StateError: A name is unknown, missing or given twice, or a shape is wrong.
        """
        names, further = self.computation.inputs, dict(by_name)
        values = dict(zip(names, given, strict=False))
        if len(given) > len(names):
            raise StateError(f"{self.name}: expected {', '.join(names)}, got {len(given)} arguments")
        if twice := [name for name in values if name in further]:
            raise StateError(f"{self.name}: {twice[0]}: expected it once, got it in order and by name")
        values |= {name: further.pop(name) for name in names[len(given) :] if name in further}
        if lacking := [name for name in names if name not in values]:
            raise StateError(f"{self.name}: expected {', '.join(names)}, got no {lacking[0]}")
        require_inputs(self.computation.by_name, further)
        values |= {name: further.pop(name) for name in self.computation.by_name}
        shapes = self.externals
        found = {name: arrays.floats(name.removeprefix(WITH), x, shapes[name].shape) for name, x in values.items()}
        if self.question.require is not None:
            self.question.require(self.chain, found)
        return found | parse_parameters(further, self.externals, self.chain) if further else found

    def results(self, batch: int | None) -> Results:
        """Return new memory for the results of one system, or of a batch."""
        kind = CompiledResult if self.has_status else Results
        return kind(self.chain, self.calls.layout, batch)

    def _results_of(self, out: Any, batch: int | None) -> Results:
        """Return the memory behind an earlier answer.

        Raises:
            StateError: It is no answer of this function, or one of another batch size.
        """
        results = out.results if isinstance(out, CompiledDerivatives) else out
        if isinstance(out, CompiledDerivatives) and out.request != self.request:
            raise StateError("out: expected earlier derivatives of the same names; leave it out first")
        if not self.has_status and self.request is None:
            results = results_behind(out, self.chain, self.calls.layout)
        arrays.require_fit(results, self.chain, batch)
        return results

    def _settle(self, inputs: Mapping[str, Array], result: Results) -> None:
        """Refuse one system without a finite answer; make the answers of such systems in a batch NaN."""
        found = {name: result.array(name) for name in result.layout.shapes}
        if result.batch is not None:
            bad = faulty(inputs, self._ranks, self._largest, result.batch)
            for x in found.values() if bad is not None else ():
                x[bad] = np.nan
        else:
            for name, x in found.items():
                checks.finite(np.where(np.isposinf(x), 0.0, x) if self.question.unlimited else x, name)
        self.question.settle(self.chain, inputs, found)

    def shown(self, results: Results) -> Any:
        """Return what a user gets of the results in memory."""
        if self.request is not None:
            return CompiledDerivatives(self.request, results)
        if isinstance(results, CompiledResult):
            return results
        return self.question.shown(
            self.chain, {name: results.array(name) for name in self.question.names_at(self.chain)}
        )

    def vjp(
        self, *given: Any, by: Sequence[str] = (), out: Any = None, threads: int = 1, **cotangents_and_parameters: Any
    ) -> CompiledDerivatives:
        """Return the gradients of sum(cotangent . result), at a few times the cost of the answer.

        Args:
            *given: the arguments of the question, in order or by name.
            by: the arguments of which gradients are returned; by default `question.by`.
            out: earlier derivatives of the same names, to be overwritten.
            threads: the number of threads for a batch.
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
        return self.derived("vjp", tuple(cotangents), by or self.question.by)._with(
            given, cotangents, further, out, threads
        )

    def jvp(
        self,
        *given: Any,
        along: Mapping[str, Any],
        of: Sequence[str] | None = None,
        out: Any = None,
        threads: int = 1,
        **parameters: Any,
    ) -> CompiledDerivatives:
        """Return the rates of the results along tangents of the arguments, at a few times the cost of the answer.

        Args:
            *given: the arguments of the question, in order or by name.
            along: the tangents by argument, each in the shape of the argument's gradient; (d, ...) for d directions of
                one system at once, (batch, ...) for a batch.
            of: the results; by default all.
            out: earlier derivatives of the same names, to be overwritten.
            threads: the number of threads for a batch.
            **parameters: parameters as in a call.

        Returns:
            The rate of every result, in the shape of the result, with a leading axis if there are several directions
            or a batch.

        Raises:
            StateError: A name, shape or number is wrong, or a requested force is not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        checks.instance(along, Mapping, f"{self.name}.jvp: along", StateError)
        return self.derived("jvp", self._names if of is None else of, tuple(along))._with(
            given, along, parameters, out, threads
        )

    def jacobian(
        self,
        *given: Any,
        of: Sequence[str] = (),
        by: Sequence[str] = (),
        out: Any = None,
        threads: int = 1,
        **parameters: Any,
    ) -> CompiledDerivatives:
        """Return the Jacobian.

        Args:
            *given: the arguments of the question, in order or by name.
            of: the results; by default `question.of`.
            by: the arguments; by default `question.by`.
            out: earlier derivatives of the same names, to be overwritten.
            threads: the number of threads for a batch.
            **parameters: parameters as in a call.

        Returns:
            `found[of, by]`, (*shape of the result, *shape of the argument's gradient), with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or a requested force is not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        of, by = of or self.question.of or self._names, by or self.question.by
        return self.derived("jacobian", of, by)._with(given, {}, parameters, out, threads)

    def bind(
        self,
        kind: Kind | None = None,
        *,
        of: Sequence[str] = (),
        by: Sequence[str] = (),
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
        if kind not in get_args(Kind):
            raise StateError(
                f"{self.name}.bind: expected vjp, jvp or jacobian, got {checks.short(kind)}."
                f"{checks.did_you_mean(str(kind), get_args(Kind))}"
            )
        return BoundFunction(
            self.derived(kind, of or self.question.of or self._names, by or self.question.by), arrays_or_parameters
        )

    def export(self, folder: str | PathLike[str], **options: Any) -> ExportedCode:
        """Write the function as C or object files that run without Python; see `CompiledChain.export`."""
        return self.compiled.export(folder, functions=[self.name.replace(".", "_")], **options)

    def derived(self, kind: Kind, of: Sequence[str], by: Collection[str]) -> Function:
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
            found = self._made[request] = Function(self.compiled, self.question, request, self._options)
        self._made[kind, type(of), tuple(of), type(by), tuple(by)] = found
        return found

    def _with(
        self, given: Sequence[Any], vectors: Mapping[str, Any], further: dict[str, Any], out: Any, threads: int
    ) -> CompiledDerivatives:
        """Return derivatives, of the question's inputs, cotangents or tangents, and parameters."""
        assert self.request is not None
        inputs, values = self.question.inputs, [*given]
        if len(given) > len(inputs):
            raise StateError(f"{self.name}: expected {', '.join(inputs)}, got {len(given)} arguments")
        own = (
            self.computation.inputs[: -len(self.request.given) or None]
            if self.request.given
            else self.computation.inputs
        )
        for name in own[len(given) :]:
            if name not in further:
                require_inputs([name] if name not in inputs else (), further)
                raise StateError(f"{self.name}: expected {', '.join(inputs)}, got no {name}")
            values.append(further.pop(name))
        values += [vectors[name] for name in self.request.given]
        if threads == 1:
            return self(*values, out=out, **further)
        return self(*values, out=out, threads=threads, **further)

    @cached_property
    def when_moving(self) -> Function:
        """The function for moving bases; it is made when the motion of a base is first given."""
        return Function(self.compiled, self.question, self.request, replace(self._options, base_motion=True))

    @cached_property
    def _names(self) -> tuple[str, ...]:
        """The names of the results that can be differentiated."""
        return self.question.names_at(self.chain)


def _origins(parameters: Mapping[str, Any]) -> dict[str, Array]:
    """Return the positions of given bases, which only the search for the generic rank needs."""
    given = parameters.get("base_pose")
    return {} if given is None else {"base_p": np.array(given, dtype=float)[..., 4:]}
