"""Machine code bound to fixed arrays: a call without arguments, its status, and its parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from holdfast.compiled import statuses
from holdfast.compiled.calls import Calls
from holdfast.compiled.parameters import parse_parameters, rank_number
from holdfast.compiled.result import UNDECIDED, CompiledResult
from holdfast.dynamics.result import Status
from holdfast.errors import StateError
from holdfast.names import named, no_arguments

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain


@named
class BoundCall:
    """A call without arguments that overwrites the same result each time; for one thread at a time.

    It checks nothing and raises nothing: the call returns the `Status`, and if that is SINGULAR or INVALID the
    results are NaN.

    Attributes:
        run: the machine code as a function without arguments; it returns the status as an integer, 0 for OK.
    """

    def __init__(self, compiled: CompiledChain, calls: Calls) -> None:
        self._compiled, self._externals, self._bound = compiled, calls.kernel.externals, calls.bind()
        self._written = CompiledResult(compiled.chain, calls.layout, None)
        self._bound.use({name: self._written.array(name) for name in calls.layout.shapes})
        self.run = self._bound.run

    def __repr__(self) -> str:
        """Return the kind of call and the chain's arms."""
        return f"<{type(self).__name__} of {', '.join(self._compiled.chain.names)}>"

    def __call__(self, *none: Any) -> Status:
        """Compute the results from the inputs."""
        if none:
            no_arguments("bound call", none)
        code = self.run()
        if code == 0:
            return Status.OK
        if code == UNDECIDED:
            statuses.resolve_undecided(self._compiled, self._bound.arrays, self._written)
            self._bound.set({"generic_rank": rank_number(self._compiled.generic_rank or 0)})
            self.run()
        return self._written.status

    def set(self, **parameters: Any) -> None:
        """Change run-time parameters, named as in `CompiledChain.forward_dynamics`.

        Raises:
            StateError: A parameter has an unknown name, a wrong shape or a number that is not finite.
        """
        found = parse_parameters(parameters, self._externals, self._compiled.chain)
        for name, x in found.items():
            if x.ndim > len(self._externals[name].shape):
                raise StateError(f"set: {name}: expected numbers of one system, got a batch of {len(x)}")
        self._bound.set(found)
