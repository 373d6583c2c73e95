"""Machine code of a function of a forest, all numbers of which are constants, bound to arrays of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.computation import Computation
from holdfast.compiled.kernels import batch_kernel, kernel
from holdfast.compiled.traced_chain import Given, externals, traced
from holdfast.compiler.kernel import BatchKernel, Bound
from holdfast.compiler.schedule import Schedule
from holdfast.model.fingerprint import code_key
from holdfast.model.forest import Forest
from holdfast.questions.arrays import Shape
from holdfast.spatial.scalar import Array


class _Structure(NamedTuple):
    """What names machine code of a forest."""

    chain: Forest
    key: str


class ForestCode:
    """A function of a forest as machine code, for one system at a time, or for several side by side."""

    def __init__(
        self,
        forest: Forest,
        name: str,
        inputs: Sequence[str],
        outputs: Mapping[str, Shape],
        function: Callable[[Given], Mapping[str, Any]],
        guarded: tuple[str, ...] = (),
    ) -> None:
        """Compile a function, or load its machine code.

        Args:
            forest: the forest.
            name: a name of the function, on which its machine code depends.
            inputs: names of its arguments.
            outputs: the shapes of its results by name; if one is a status, those `guarded` are NaN where it is bad.
            function: takes the traced arguments and returns the results by name.
            guarded: names of results.
        """
        wrenches, forces = (len(forest.closures), 6), (len(forest.couplings),)
        shapes: dict[str, Shape] = {"link_wrench": (len(forest.bodies), 6), "contact": (len(forest.closures), 7)}
        shapes |= dict.fromkeys(("q", "rates"), (forest.position_count,))
        shapes |= dict.fromkeys(("qd", "qdd", "tau", "needed", "free"), (forest.velocity_count,))
        shapes |= {"asked": (forest.constraint_row_count,)}
        shapes |= {"closure_wrench": wrenches, "coupling_force": forces, **outputs}
        found, status = externals(inputs, (), outputs, shapes), "status" if "status" in outputs else None

        def schedule() -> Schedule:
            return traced(found, function, status, guarded)

        structure: Any = _Structure(forest, f"{code_key(forest)}/{name}")
        self._made, self._outputs = Computation("forest", structure, found, schedule, tuple(inputs)), outputs

    def __call__(self, **given: Array) -> Mapping[str, Array]:
        """Return arguments and results by name, in memory that the next call overwrites."""
        for name, x in given.items():
            self._bound.arrays[name][...] = x
        self._bound.run()
        return self._bound.arrays

    def of_each(self, count: int, **given: Array) -> Mapping[str, Array]:
        """Return the results for several systems by name, with their number as first axis.

        Args:
            count: the number of systems.
            **given: the arguments, with one row for each system, or one value that all share.
        """
        found = {name: np.zeros((count, *shape)) for name, shape in self._outputs.items()}
        self._batch.run_arrays(given | found, count, 1)
        return found

    @cached_property
    def _bound(self) -> Bound:
        return kernel(self._made).bind()

    @cached_property
    def _batch(self) -> BatchKernel:
        return batch_kernel(self._made, quick=True)
