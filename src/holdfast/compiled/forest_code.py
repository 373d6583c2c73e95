"""Machine code of a function of a forest, all numbers of which are constants, bound to arrays of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from holdfast.compiled.computation import Computation
from holdfast.compiled.kernels import kernel
from holdfast.compiled.traced_chain import Given, externals, traced
from holdfast.compiler.kernel import Bound
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
    """A function of a forest as machine code, for one system at a time."""

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
        shapes: dict[str, Shape] = {"q": (forest.position_count,), "link_wrench": (len(forest.bodies), 6)}
        shapes |= dict.fromkeys(("qd", "qdd", "tau"), (forest.velocity_count,))
        shapes |= {"closure_wrench": wrenches, "coupling_force": forces, **outputs}
        found, status = externals(inputs, (), outputs, shapes), "status" if "status" in outputs else None

        def schedule() -> Schedule:
            return traced(found, function, status, guarded)

        structure: Any = _Structure(forest, f"{code_key(forest)}/{name}")
        self._bound: Bound = kernel(Computation("forest", structure, found, schedule, tuple(inputs))).bind()

    def __call__(self, **given: Array) -> Mapping[str, Array]:
        """Return arguments and results by name, in memory that the next call overwrites."""
        for name, x in given.items():
            self._bound.arrays[name][...] = x
        self._bound.run()
        return self._bound.arrays
