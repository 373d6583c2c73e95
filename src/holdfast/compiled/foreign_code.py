"""Forward dynamics and its derivatives as machine code that other libraries, such as JAX, call with their arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from holdfast.compiled.arrays import Addresses
from holdfast.compiled.derivative_schedule import FOUND
from holdfast.compiled.parameters import rank_number
from holdfast.compiled.result import UNDECIDED, ResultLayout, Results
from holdfast.compiler.kernel import Kernel
from holdfast.compiler.schedule import External
from holdfast.compiler.targets import foreign_call
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import MOVING
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.compiled.function import Function

STATUS = "status"


class ForeignCode(NamedTuple):
    """Machine code, and the chain's own values of the arrays that the caller does not give.

    Attributes:
        kernel: the machine code.
        own: the chain's own values for one system, by array name.
        results: the name of the kernel's output for every requested result.
    """

    kernel: Kernel
    own: Mapping[str, Array]
    results: Mapping[str, str]

    @property
    def externals(self) -> Mapping[str, External]:
        """The arrays that the kernel reads and writes, results last."""
        return self.kernel.externals

    def publish(self) -> int:
        """Register the code so that other compilers' programs can call it; return its key.

        The results of a system with an undecided status are NaN.
        """
        if STATUS in self.externals:
            return self.kernel.publish(STATUS, float(UNDECIDED))
        return self.kernel.publish(next(iter(self.results.values())), float("nan"))  # no number equals not-a-number

    def run(self, chain: ClosedChain, given: Mapping[str, Array], batch: int | None) -> Results:
        """Run the code as another compiler's program would, and return the results.

        Args:
            chain: the chain.
            given: the arrays by name, of one system or with a leading batch axis; float64 in C order.
            batch: the number of systems, or None for one system without a batch axis.
        """
        result = Results(chain, ResultLayout(self.externals), batch)
        addresses = Addresses(self.externals, dict(self.own))
        self.kernel.run_batch(addresses.table(given, result), 1 if batch is None else batch)
        undecided = result.array(STATUS) == UNDECIDED if STATUS in self.externals else False
        for name in result.layout.shapes:
            result.array(name)[undecided] = np.nan
        return result


def answer_code(function: Function, of: Sequence[str], parameters: Sequence[str]) -> ForeignCode:
    """Return the code of a question.

    Args:
        function: its function.
        of: the names of the requested results.
        parameters: the names of the parameters that calls will give.
    """
    moves = any(name in MOVING and name not in function.externals for name in parameters)
    return _code(function.when_moving if moves else function, {name: name for name in of})


def derivative_code(
    function: Function, kind: Literal["vjp", "jvp"], of: Sequence[str], by: Sequence[str]
) -> ForeignCode:
    """Return the code of a product with the Jacobian of a question.

    The names of its cotangents or tangents are those of the results or arguments with the prefix "with.".

    Args:
        function: its function.
        kind: `vjp` for a product with cotangents of results, `jvp` for one with tangents of arguments.
        of: the results to differentiate.
        by: the arguments by which they are differentiated.

    Raises:
        StateError: A name is unknown.
    """
    return _code(function.derived(kind, of, by), {name: f"{FOUND}{name}" for name in (by if kind == "vjp" else of)})


def handler() -> Any:
    """Return a Python capsule of the function through which XLA's programs call published code."""
    return foreign_call.capsule()


def _code(function: Function, results: Mapping[str, str]) -> ForeignCode:
    """Return the code of a function with a copy of the chain's own values, its generic rank included."""
    own = {name: np.array(x) for name, x in function.calls.own.items()}
    rank = {"generic_rank": rank_number(function.compiled.generic_rank)} if "generic_rank" in own else {}
    return ForeignCode(function.calls.kernel, own | rank, results)
