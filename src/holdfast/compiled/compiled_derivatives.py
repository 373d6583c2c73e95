"""Derivatives of forward dynamics as machine code, called with checked arrays for one system or a batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.compiled import arrays, statuses
from holdfast.compiled.calls import Calls
from holdfast.compiled.derivative_schedule import FOUND, UNITS, WITH, ForwardRequest, derivative_shapes, given_names
from holdfast.compiled.externals import FLOATING, LINKS, MOVING, TRUNK_LINKS
from holdfast.compiled.kernels import compile_batch, kernel
from holdfast.compiled.parameters import WRENCHES, parameters_of, parse_parameters, require_inputs
from holdfast.compiled.result import INDETERMINATE, CompiledResult
from holdfast.compiled.structure import Options, Structure
from holdfast.compiler.targets import Builtin
from holdfast.dynamics.closed.forward_derivatives import results_of
from holdfast.dynamics.derivatives import STATE_AND_TORQUES
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain

NOT_UNIQUE = ("grasp_wrench", "base_wrench")  # results that are not unique if the constraint's rank is low


class Derivatives:
    """Derivatives of forward dynamics: `found.q` or `found["q"]`, and of a Jacobian `found["qdd", "q"]`.

    Attributes:
        result: the result of forward dynamics at the same state.
        request: the derivatives that were requested.
    """

    result: CompiledResult
    request: ForwardRequest
    _blocks: dict[Any, Array]  # views for `found[of, by]`, made when first asked for

    def __init__(self, result: CompiledResult, request: ForwardRequest) -> None:
        self.__dict__.update(result=result, request=request, _blocks={})

    def __repr__(self) -> str:
        """Return the kind of derivatives, of which results and by which arguments they are."""
        request = self.request
        return f"<Derivatives: {request.kind} of {', '.join(request.results)} by {', '.join(request.arguments)}>"

    def __getattr__(self, name: str) -> Array:
        """Return the derivatives of one name."""
        if name.startswith("_") or f"{FOUND}{name}" not in self.result.layout.shapes:
            known = [x.removeprefix(FOUND) for x in self.result.layout.shapes if x.startswith(FOUND)]
            raise AttributeError(f"no derivative '{name}'.{checks.did_you_mean(name, known)}")
        return self.result.array(f"{FOUND}{name}")

    def __getitem__(self, name: str | tuple[str, str]) -> Array:
        """Return the derivatives of one name, or of a result by an argument, (*result's shape, *argument's shape)."""
        if isinstance(name, str):
            return getattr(self, name)
        found = self._blocks.get(name)
        if found is None:
            found = self._blocks[name] = self._block(*name)
        return found

    def _block(self, of: str, by: str) -> Array:
        columns, shapes = getattr(self, f"{of}.{by}"), derivative_shapes(self.result.chain)
        lead = columns.shape[:-2]
        whole = columns.reshape(*lead, *shapes[by], *shapes[of])
        first, middle = len(lead), len(lead) + len(shapes[by])
        order = [*range(first), *range(middle, whole.ndim), *range(first, middle)]
        return whole.transpose(order)


class CompiledDerivatives:
    """Derivatives of forward dynamics as machine code.

    Attributes:
        request: the derivatives that it computes.
        externals: the arrays that the machine code reads and writes, by name.
        calls: the calls of the machine code.
    """

    def __init__(self, compiled: CompiledChain, request: ForwardRequest, moving: bool) -> None:
        """Compile the derivatives, or load their machine code.

        Args:
            compiled: the compiled chain.
            request: the derivatives to compute.
            moving: whether bases move.
        """
        self._compiled, self.request, self._rank, chain = compiled, request, compiled.generic_rank, compiled.chain
        structure = Structure(chain, options_of(compiled.options, request.arguments, moving))
        self.externals = request.externals(structure)
        own = parameters_of(chain, compiled.generic_rank)
        if UNITS in self.externals:
            own[UNITS] = np.eye(self.externals[UNITS].shape[0])
        code = kernel(request.name, structure, self.externals, lambda: request.schedule(structure))
        self.calls = Calls(code, own)
        names = *given_names(chain), *(f"{WITH}{name}" for name in request.given)
        self._shapes = [(name, self.externals[name].shape) for name in names]
        shapes = [shape for _, shape in self._shapes]
        # The builtin runs calls that repeat `out` in machine code and passes all others to `_checked`.
        self._builtin = Builtin(code.single_address, self.calls.own_table(), shapes, self._checked, request.kind)

    def __call__(
        self, given: Sequence[Any], parameters: dict[str, Any], out: Derivatives | None, threads: int
    ) -> Derivatives:
        """Return the derivatives together with the result of forward dynamics.

        Args:
            given: state and torques without those of a floating base; then the cotangents or tangents, in the request's
                order.
            parameters: the parameters of this call, by the names that users know.
            out: earlier derivatives to be overwritten.
            threads: the number of threads for a batch.
        """
        arrays.require_threads(threads)
        if self._compiled.chain.floats:
            require_inputs(FLOATING, parameters)
            of_state = len(STATE_AND_TORQUES)
            given = *given[:of_state], *(parameters.pop(name) for name in FLOATING), *given[of_state:]
        if self._rank != self._compiled.generic_rank:
            self._set_rank()
        if parameters or threads > 1:
            return self._checked(*given, out=out, threads=threads, parameters=parameters)
        return self._builtin.function(*given, out=out)

    def _checked(
        self, *given: Any, out: Derivatives | None, threads: int = 1, parameters: Mapping[str, Any] | None = None
    ) -> Derivatives:
        """Run the calls that the builtin does not handle."""
        compiled, chain = self._compiled, self._compiled.chain
        found = {
            name: arrays.floats(name.removeprefix(WITH), x, shape)
            for (name, shape), x in zip(self._shapes, given, strict=True)
        }
        if parameters:
            found |= parse_parameters(parameters, self.externals, chain)
        batch = arrays.batch_of(found, self.externals)
        if out is None:
            out = Derivatives(CompiledResult(chain, self.calls.layout, batch), self.request)
        else:
            checks.instance(out, Derivatives, "out", StateError)
            if out.request != self.request:
                raise StateError("out: expected earlier derivatives of the same names; leave it out first")
            arrays.require_fit(out.result, chain, batch)
            if batch is None and not parameters:
                self._builtin.expect(out, out.result.memory, self.calls.row(found, out.result)[len(found) :])
        if batch is not None:
            compile_batch(self.calls.kernel, chain, f"forward_dynamics_{self.request.kind}", self._compiled.progress)
        if not self.calls(found, out.result, threads):
            self._resolve_undecided(found, out.result)
            if self._rank != compiled.generic_rank:
                self._set_rank()
        return out

    def _set_rank(self) -> None:
        """Let the status be decided by the generic rank that the chain has been found to have."""
        self._rank = self._compiled.generic_rank
        self.calls.set_rank(self._rank)

    def _resolve_undecided(self, found: Mapping[str, Array], result: CompiledResult) -> None:
        """Resolve undecided statuses, and reject derivatives of forces that are not unique.

        For one system they raise a StateError; in a batch they become NaN.
        """
        own = self.calls.own | dict(found)
        statuses.resolve_undecided(self._compiled, own, result)
        if result.batch is None:
            statuses.require_answer(self._compiled, own, result)
        low = np.atleast_1d(result.array("status")) == INDETERMINATE
        choices = [name for name in self.request.results if name in NOT_UNIQUE]
        if not low.any() or not choices:
            return
        if result.batch is None:
            others = ", ".join(name for name in results_of(result.chain) if name not in NOT_UNIQUE)
            raise StateError(
                f"{choices[0]}: the forces are not unique here, and machine code finds one choice among them, whose"
                f" derivative means nothing; try those of {others}"
            )
        for name in self.request.found(result.chain):
            if self.request.kind == "vjp" or name.partition(".")[0] in choices:
                result.array(f"{FOUND}{name}")[low] = np.nan


def options_of(options: Options, arguments: Sequence[str], moving: bool) -> Options:
    """Return the options for derivatives: arguments of the derivatives must be run-time parameters."""
    varied = any(name in MOVING for name in arguments)
    return replace(
        options,
        link_inertia=options.link_inertia or any(name in (*LINKS, *TRUNK_LINKS) for name in arguments),
        link_wrenches=options.link_wrenches or any(name in WRENCHES for name in arguments),
        base_motion=options.base_motion or moving or varied,
    )
