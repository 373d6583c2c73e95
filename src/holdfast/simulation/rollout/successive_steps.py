"""Successive steps by machine code, each with evaluations at points inside it; only the last point leads on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from holdfast.compiler.kernel import aligned
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.stage_values import VALUES
from holdfast.spatial.scalar import Array

ANEW = ("count", "work", "code", "worst_margin", "worst_time")  # carried arrays with which every step begins anew

# function of the number of a step, called before it is taken, that returns the law's memory from then on; None for no
# change
Remember = Callable[[int], Array | None]

Again = Callable[[Sequence[int], Sequence[float]], Systems]  # `SuccessiveSteps.again`


class Driven(Protocol):
    """Sets the values of steps whose values at the stages are given; see `stage_values`.

    Attributes:
        memory: the memory that the controller will be given.
        memories: memory that the controller returned at the start, if there was a jump, and at the end of each step, by
            number of the step; None if it is part of the results.
        interruption: what interrupted the controller, such as Ctrl-C.
    """

    memory: Any
    memories: tuple[dict[int, Any], dict[int, Any]] | None
    interruption: BaseException | None

    def start(self, k: int, starts: CarriedArrays) -> bool:
        """Set those at the start of step k, whose carried arrays are known, and return whether there are any."""
        ...

    def step(self, k: int, ends: CarriedArrays) -> bool:
        """Set those of step k, whose carried arrays are those at its start, and return whether there are any."""
        ...

    def inside(self, k: int, length: float) -> Array:
        """Return those of a shorter step from the start of step k [s], (stages, size), as they are between its own."""
        ...


class SuccessiveSteps:
    """Memory for a number of successive steps, and the tables by which machine code finds its way in it.

    Attributes:
        ends: results at the points of the steps, (steps, points, ...) by name; the last point is the step's end.
        starts: results after the jumps at which steps begin, (steps, 1, ...) by name.
    """

    def __init__(self, kernel: StepKernel, steps: int, points: int) -> None:
        """Reserve the memory."""
        self.kernel = kernel
        self._ends, self._starts = CarriedArrays(kernel, steps, points), CarriedArrays(kernel, steps, 1, jump=True)
        self.ends, self.starts = self._ends.arrays, self._starts.arrays
        self._taken: tuple[Array, Mapping[str, Array], Array, Driven | None] | None = None
        self._again: dict[int, CarriedArrays] = {}

    def take(
        self,
        start: Systems,
        begin: Array,
        step: Array,
        jumps: Array,
        inputs: Mapping[str, Array],
        remember: Remember | None,
        driven: Driven | None = None,
    ) -> int:
        """Take steps, leave their results in `ends` and `starts`, and return how many were taken.

        Args:
            start: one system by name, at the start of the first step, with its slope.
            begin: (k,) times at which the steps begin [s].
            step: (k, points) lengths from there to the points [s].
            jumps: (k,) whether torques or inputs jump there, so that the start is evaluated anew.
            inputs: inputs by name, as for `StepKernel.run`.
            remember: called before each step; None if the memory does not change between steps.
            driven: sets the values, if they are given; a step for which it has none is the first that is not taken.
        """
        ends, starts, anew, count = self._ends, self._starts, self._ends.anew, len(begin)
        blank = ends.of_system(start)
        ends.block[:count, :, :anew] = starts.block[:count, :, :anew] = blank[:anew]
        inputs = {**inputs, "held": np.array(0.0)}
        ends.prepare(inputs, begin[:, None], step)
        if jumps.any():
            starts.prepare({**inputs, "held": np.array(1.0)}, begin[:, None], np.zeros((count, 1)))
        self._taken = blank, inputs, jumps, driven
        points, jumped, before = ends.block[:, :, anew:], starts.block[:, 0, anew:], blank[anew:]
        for k, jumping in enumerate(jumps.tolist()):
            memory = None if remember is None else remember(k)
            if driven is not None and memory is not None:
                driven.memory = memory
            if jumping:
                jumped[k] = before
                starts.set_memory(k, memory)
                if driven is not None and not driven.start(k, starts):
                    return k
                starts.run(k)
                before = jumped[k]
            points[k] = before
            if not jumping:
                ends.set_memory(k, memory)
            if driven is not None and not driven.step(k, ends):
                return k
            ends.run(k)
            before = points[k, -1]
        return count

    def again(self, steps: Sequence[int], lengths: Sequence[float]) -> Systems:
        """Return the results at further points of the steps that were taken last, (points, ...) by name.

        They are overwritten by the next call.

        Args:
            steps: number of the step of each point.
            lengths: its time since that step's start [s].
        """
        assert self._taken is not None
        blank, inputs, jumps, driven = self._taken
        count, anew = len(steps), self._ends.anew
        size = 1 << (count - 1).bit_length()  # memory for few sizes serves all counts; the last point fills it
        steps, lengths = [*steps, *[steps[-1]] * (size - count)], [*lengths, *[lengths[-1]] * (size - count)]
        memory = self._again.get(size)
        if memory is None:
            memory = self._again[size] = CarriedArrays(self.kernel, 1, size)
        for row, k in zip(memory.block[0], steps, strict=True):
            before = self._starts.block[k, 0] if jumps[k] else self._ends.block[k - 1, -1] if k else blank
            row[:anew], row[anew:] = blank[:anew], before[anew:]
        memory.prepare(inputs, self._ends.begin[None, steps, 0], np.array([lengths]))
        if driven is not None:
            memory.values[0] = [driven.inside(k, length) for k, length in zip(steps, lengths, strict=True)]
        memory.run(0)
        return {name: x[0, :count] for name, x in memory.arrays.items()}


class CarriedArrays:
    """The carried arrays of several systems in each of several runs, system by system.

    Attributes:
        block: (runs, systems, size) all numbers.
        values: (runs, systems, stages, ...) values of steps whose values at the stages are given.
        anew: how many of them, the first ones, belong to `ANEW`.
        arrays: views of the block, (runs, systems, ...) by name.
        begin: (runs, systems) times at which the steps begin [s].
    """

    def __init__(self, kernel: StepKernel, runs: int, systems: int, *, jump: bool = False) -> None:
        """Reserve the memory; with `jump`, each run is no step, but an instant at which torques or inputs jump."""
        self._kernel, self._systems, self._jump = kernel, systems, jump
        sizes = {name: int(np.prod(shape)) for name, shape in kernel.carried.items()}
        self._order = sorted(sizes, key=lambda name: name not in ANEW)
        size, self.anew = sum(sizes.values()), sum(sizes[name] for name in sizes if name in ANEW)
        self.block = aligned(runs * systems * size).reshape(runs, systems, size)
        self.arrays: Systems = {}
        for name in self._order:
            start = sum(x[0, 0].size for x in self.arrays.values())
            part = self.block[..., start : start + sizes[name]]
            self.arrays[name] = part.reshape(runs, systems, *kernel.carried[name])
        self.begin, self._step = np.zeros((2, runs, systems))
        places = {f"last.{name}": (x, size) for name, x in self.arrays.items()}
        places |= {"begin": (self.begin, 1), "step": (self._step, 1)}
        shape = kernel.law.parameters[VALUES] if kernel.structure.options.stages else (0,)
        self.values = np.zeros((runs, systems, *shape))
        if kernel.structure.options.stages:
            places[f"control.{VALUES}"] = self.values, self.values[0, 0].size
        self._places = kernel.table({}).places(places)
        self._first, self._apart = 0, 0
        self._kept: tuple[Any, ...] = ()

    def of_system(self, system: Systems) -> Array:
        """Return the numbers of one system in the order of the block, (size,)."""
        return np.concatenate([system[name].ravel() for name in self._order])

    def set_memory(self, run: int, memory: Array | None) -> None:
        """Set the law's memory of all systems of a run, unless it is None."""
        if memory is not None and "memory" in self.arrays:
            self.arrays["memory"][run] = memory

    def prepare(self, inputs: Mapping[str, Array], begin: Array, step: Array) -> None:
        """Set the inputs, and for the steps of the first k runs (k, systems) times and lengths [s].

        The very same inputs are set once, for the number of runs of that call.
        """
        count = len(begin)
        self.begin[:count], self._step[:count] = begin, step
        if not self._kept or self._kept[0] is not inputs:
            table = self._kernel.table(inputs)
            tables = table.successive(self._places, count)
            self._first, self._apart = tables.ctypes.data, tables.strides[0]
            self._kept = inputs, table, tables  # machine code reads them

    def set_step(self, begin: float, step: float) -> None:
        """Set the time and the length of the step of the only system [s]."""
        self.begin[0, 0], self._step[0, 0] = begin, step

    def run(self, k: int) -> None:
        """Take the step of a run; the machine code is made if there is none yet."""
        self._take(self._first + k * self._apart)

    @cached_property
    def _take(self) -> Callable[[int], None]:
        code = self._kernel.jump_code if self._jump else self._kernel.step_code
        return code.repeatedly(self._systems)
