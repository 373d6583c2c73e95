"""Successive steps by machine code, each with evaluations at points inside it; only the last point leads on."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from holdfast.compiler.kernel import aligned
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.spatial.scalar import Array

ANEW = ("count", "work", "code", "worst_margin", "worst_time")  # carried arrays with which every step begins anew


class SuccessiveSteps:
    """Memory for a number of successive steps, and the addresses by which machine code finds its way in it.

    Attributes:
        steps: number of steps.
        points: number of points of each step; the last is its end.
    """

    def __init__(self, kernel: StepKernel, steps: int, points: int) -> None:
        """Reserve the memory; the machine code is made if there is none yet."""
        self.kernel, self.steps, self.points = kernel, steps, points
        sizes = {name: int(np.prod(shape)) for name, shape in kernel.carried.items()}
        order = sorted(sizes, key=lambda name: name not in ANEW)
        starts = dict(zip(order, np.cumsum([0, *(sizes[name] for name in order)]).tolist(), strict=False))
        size = sum(sizes.values())
        self._anew = sum(sizes[name] for name in order if name in ANEW)
        self._memory = aligned(steps * points * size).reshape(steps, points, size)
        self._begin, self._step = np.zeros((steps, 1)), np.zeros((steps, points))
        self.arrays: Systems = {
            name: self._memory[..., start : start + sizes[name]].reshape(steps, points, *kernel.carried[name])
            for name, start in starts.items()
        }
        self._places = {f"last.{name}": (self.arrays[name], size) for name in order}
        self._places |= {"begin": (self._begin, 0), "step": (self._step, 1)}
        self._run: Callable[[int], None] = kernel.step_code.repeatedly(points)

    def take(self, start: Systems, begin: Array, step: Array, inputs: Mapping[str, Array]) -> None:
        """Take the steps and leave their results in `arrays`, (steps, points, ...) each.

        Args:
            start: one system at its state at the start of the first step, with its slope.
            begin: (k,) times at which the steps begin [s]; at most `steps`.
            step: (k, points) lengths from there to the points [s].
            inputs: inputs by name, as for `StepKernel.run`.
        """
        count = len(begin)
        self._begin[:count, 0], self._step[:count] = begin, step
        for name, x in start.items():
            self.arrays[name][0] = x
        memory, anew, run = self._memory, self._anew, self._run
        memory[:count, :, :anew] = memory[0, 0, :anew]
        tables = self.kernel.table(inputs).successive(self._places, count)
        first, apart = tables.ctypes.data, tables.strides[0]
        for k in range(count):
            if k:
                memory[k, :, anew:] = memory[k - 1, -1, anew:]
            run(first + k * apart)
