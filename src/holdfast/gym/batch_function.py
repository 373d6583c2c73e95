"""Compiling a Python function for a batch of systems: a task's observation, reward and termination."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from holdfast.compiled.traced_chain import Given, traced
from holdfast.compiler.kernel import BatchKernel
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External
from holdfast.spatial.scalar import Array


class BatchFunction:
    """A function from named arrays to named arrays, written like a control law and compiled at its first call.

    The results of a system are identical to the bit whatever the size of the batch.

    Attributes:
        function: the function for one system; it can also be called with numbers.
        inputs: shapes of its arguments, by name.
        outputs: shapes of its results, by name.
    """

    def __init__(
        self, function: Callable[[Given], Mapping[str, Any]], inputs: Mapping[str, Shape], outputs: Mapping[str, Shape]
    ) -> None:
        self.function, self.inputs, self.outputs = function, dict(inputs), dict(outputs)
        externals = {name: External(shape, "input") for name, shape in inputs.items()}
        externals |= {name: External(shape, "output") for name, shape in outputs.items()}
        self._kernel = BatchKernel(externals, lambda: traced(externals, function))

    def __call__(self, count: int, given: Mapping[str, Array], threads: int = 1) -> dict[str, Array]:
        """Return the results of the function for every system, (count, *shape) each.

        Args:
            count: number of systems.
            given: arguments by name, (count, *shape) each, or (*shape) if all systems share it.
            threads: number of threads.
        """
        arrays = {name: np.asarray(given[name], dtype=float, order="C") for name in self.inputs}
        found = {name: np.empty((count, *shape)) for name, shape in self.outputs.items()}
        self._kernel.run_arrays(arrays | found, count, threads)
        return found
