"""Forward dynamics and its derivatives as code that other libraries call with arrays of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from holdfast.compiled.arrays import Addresses
from holdfast.compiled.derivative_schedule import FOUND
from holdfast.compiled.externals import FLOATING, MOVING
from holdfast.compiled.not_compiled import NotCompiledError
from holdfast.compiled.result import UNDECIDED, CompiledResult, ResultLayout
from holdfast.compiler.kernel import Kernel
from holdfast.compiler.schedule import External
from holdfast.compiler.targets import foreign_call
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain

STATUS = "status"


class ForeignCode(NamedTuple):
    """Machine code, and the chain's own numbers for what is not given.

    Attributes:
        kernel: the code; its arrays are named as those of `externals`.
        own: arrays by name, of one system.
        results: the outputs that are asked for, by the names they have there.
    """

    kernel: Kernel
    own: Mapping[str, Array]
    results: Mapping[str, str]

    @property
    def externals(self) -> Mapping[str, External]:
        """The arrays it takes and returns, results last."""
        return self.kernel.externals

    def publish(self) -> int:
        """Let other compilers' programs call it; a system whose rank is low and not judged has not-a-number."""
        return self.kernel.publish(STATUS, float(UNDECIDED))

    def run(self, compiled: CompiledChain, given: Mapping[str, Array], batch: int | None) -> CompiledResult:
        """Return what such a program finds, by a call from here.

        Args:
            compiled: the chain whose code it is.
            given: arrays of one system, or with a leading axis of `batch`; float64, C order.
            batch: how many systems, None for one without an axis.
        """
        result = CompiledResult(compiled.chain, ResultLayout(self.externals), batch)
        addresses = Addresses(self.externals, dict(self.own))
        self.kernel.run_batch(addresses.table(given, result), 1 if batch is None else batch)
        undecided = result.array(STATUS) == UNDECIDED
        for name in result.layout.shapes:
            result.array(name)[undecided] = np.nan
        return result


def forward_code(compiled: CompiledChain, of: Sequence[str], parameters: Sequence[str]) -> ForeignCode:
    """Return forward dynamics.

    Args:
        compiled: the chain.
        of: the results.
        parameters: the names of those that will be given.

    Raises:
        NotCompiledError: the trunk's base floats.
    """
    if compiled.chain.floats:
        lacking = " and ".join(FLOATING)
        raise NotCompiledError(f"to_jax: a floating base, whose {lacking} are a state of their own, is not there yet")
    moves = not compiled.options.base_motion and any(name in MOVING for name in parameters)
    code = compiled.moving if moves else compiled
    return ForeignCode(code.calls.kernel, _judged(code.calls.own, compiled), {name: name for name in of})


def derivative_code(
    compiled: CompiledChain, kind: Literal["vjp", "jvp"], of: Sequence[str], by: Sequence[str]
) -> ForeignCode:
    """Return a product with the Jacobian of forward dynamics; what it is taken with is named "with." and its name.

    Args:
        compiled: the chain.
        kind: whether cotangents of results are given, or tangents of arguments.
        of: the results.
        by: the arguments.

    Raises:
        StateError: names that are not there.
        NotCompiledError: the chain has springs between bodies.
    """
    code = compiled._derivatives(kind, of, by, dict.fromkeys(by))
    names = by if kind == "vjp" else of
    return ForeignCode(code.calls.kernel, _judged(code.calls.own, compiled), {name: f"{FOUND}{name}" for name in names})


def handler() -> Any:
    """Return the function through which XLA's programs call published code, as a capsule."""
    return foreign_call.capsule()


def _judged(own: Mapping[str, Array], compiled: CompiledChain) -> dict[str, Array]:
    """Return the chain's own numbers as they are now, the rank by which postures are judged among them."""
    rank = -1.0 if compiled.generic_rank is None else float(compiled.generic_rank)
    return {name: np.array(x) for name, x in own.items()} | {"generic_rank": np.array(rank)}
