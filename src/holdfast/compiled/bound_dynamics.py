"""Forward dynamics tied to arrays that stay, for control loops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from holdfast.compiled.parameters import taken
from holdfast.compiled.result import UNDECIDED, CompiledResult
from holdfast.compiler.kernel import Kernel
from holdfast.dynamics.result import Status
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain


class BoundDynamics:
    """Write into the inputs, call, read `result`; for one thread at a time. Made by `CompiledChain.bind`.

    Nothing is checked and nothing is raised: the call returns the `Status`, and where that is
    SINGULAR or INVALID the results are not-a-number.

    Attributes:
        q, qd, tau, object_pose, object_twist, object_wrench: the inputs; write with `bound.q[...] = q`.
        link_wrench: an input too, if it was asked for in `compile`.
        result: the last call's result.
        run: the bare call without arguments: a number, 0 if the status is OK.
    """

    def __init__(self, compiled: CompiledChain, kernel: Kernel, parameters: Mapping[str, Array]) -> None:
        self._compiled, self._bound = compiled, kernel.bind()
        self._externals = kernel.externals
        for name, x in parameters.items():
            self._bound.arrays[name][...] = x
        inputs = self._bound.arrays
        self.q, self.qd, self.tau = inputs["q"], inputs["qd"], inputs["tau"]
        self.object_pose, self.object_twist = inputs["object_pose"], inputs["object_twist"]
        self.object_wrench, self.link_wrench = inputs["object_wrench"], inputs.get("link_wrench")
        self.result = CompiledResult(compiled.chain, kernel.externals, None)
        self._bound.use(self.result.arrays)
        self._bound.prepare()
        self.run = self._bound.run

    def __call__(self) -> Status:
        """Compute `result` from the inputs."""
        code = self.run()
        if code == 0:
            return Status.OK
        if code == UNDECIDED:
            self._decide()
        return self.result.status

    def set(self, **parameters: Any) -> None:
        """Change run-time parameters, named as in `CompiledChain.forward_dynamics`.

        Raises:
            StateError: an unknown name, a wrong shape, a number that is not finite.
        """
        for name, x in taken(parameters, self._externals).items():
            self._bound.arrays[name][...] = x
        self._bound.prepare()

    def _decide(self) -> None:
        """Find the generic rank, and compute again."""
        from holdfast.compiled import verdict

        verdict.settle(self._compiled, self._bound.arrays, self.result)
        self._bound.arrays["generic_rank"][...] = float(self._compiled.generic_rank or 0)
        self._bound.prepare()
        self.run()
