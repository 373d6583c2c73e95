"""Computations as bare machine code with arrays, to be counted and timed without the calls around it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

import holdfast as hf
from benchmarks import cone_iteration
from benchmarks.bench import trunks
from benchmarks.bench.derivative_entries import JACOBIAN, JVP, VJP, DerivativeRequest
from benchmarks.bench.entries import NAMES
from benchmarks.bench.systems import System, make_system
from holdfast.compiled.derivative_schedule import WITH
from holdfast.compiled.function import Function
from holdfast.compiler.kernel import BatchKernel, Kernel, address_of
from holdfast.compiler.schedule import External, Schedule
from holdfast.spatial.scalar import Array

STATES, SYSTEMS = 8, 256  # that a single system takes in turn, and in a batch
STEP, STEPS = 1e-3, 8  # s, and from each state

Sweep = tuple[Callable[[], None], int]  # what runs machine code, and how many times it does so, once for all lanes


@dataclass(frozen=True, eq=False)
class Example:
    """A computation and numbers for it.

    Attributes:
        externals: its arrays, by name.
        schedule: what the compiler made of it.
        arrays: the numbers of inputs, parameters and carried arrays; a further first axis is that of states.
        systems: how many systems are computed at once in lanes.
        quick: whether its machine code is compiled as for a single run.
    """

    externals: Mapping[str, External]
    schedule: Schedule
    arrays: Mapping[str, Array] = field(repr=False)
    systems: int = SYSTEMS
    quick: bool = False

    @property
    def single(self) -> bool:
        """Whether there is code for one system, in which the items of its loops share the lanes."""
        return not any(e.role == "carried" for e in self.externals.values())

    def single_sweep(self) -> Sweep:
        """Load the machine code for one system; return what runs it for every state."""
        kernel, bounds = Kernel(self.externals, lambda: self.schedule), []
        for k in range(STATES):
            bounds.append(kernel.bind())
            bounds[-1].set({name: x[k] if self._varied(name) else x for name, x in self.arrays.items()})

        def sweep() -> None:
            for bound in bounds:
                bound.run()

        return sweep, STATES

    def batch_sweep(self) -> Sweep:
        """Load the machine code for a batch; return what runs it once, or for some steps from the same states."""
        kernel, count = BatchKernel(self.externals, lambda: self.schedule, quick=self.quick), self.systems
        arrays = {}
        for name, e in self.externals.items():
            if e.role == "output" or self._varied(name):
                arrays[name] = np.ascontiguousarray(np.resize(self.arrays.get(name, np.zeros(1)), (count, *e.shape)))
            else:
                arrays[name] = np.array(self.arrays[name], dtype=float)
        sizes = [e.size if arrays[name].ndim > len(e.shape) else 0 for name, e in self.externals.items()]
        table = np.array([[address_of(x) for x in arrays.values()], sizes], dtype=np.int64).T.copy()
        once, blocks = kernel.repeatedly(count), -(-count // kernel.lanes)
        carried = {name: x.copy() for name, x in arrays.items() if self.externals[name].role == "carried"}
        steps = STEPS if carried else 1

        def run(kept: BatchKernel = kernel) -> None:  # its machine code stays in memory
            for name, x in carried.items():
                arrays[name][...] = x
            for _ in range(steps):
                once(table.ctypes.data)

        return run, steps * blocks

    def _varied(self, name: str) -> bool:
        return self.arrays.get(name, np.zeros(0)).ndim > len(self.externals[name].shape)


def of_function(function: Function, given: Mapping[str, Array]) -> Example:
    """Return a function of a compiled chain with arrays by name, one row for each state."""
    kernel = function.calls.kernel
    arrays = {**function.calls.own, **{name: x for name, x in given.items() if name in kernel.externals}}
    return Example(kernel.externals, kernel.schedule, arrays)


def inputs(system: System) -> dict[str, Array]:
    """Return the arrays of forward dynamics by name."""
    return dict(zip(NAMES, system.arrays, strict=True))


def forward(system: System) -> Example:
    """Return forward dynamics."""
    return of_function(hf.compile(system.chain).forward_dynamics, inputs(system))


def inverse(system: System) -> Example:
    """Return inverse dynamics of the same motion."""
    fast, given = hf.compile(system.chain), inputs(system)
    found = fast.forward_dynamics(*system.arrays)
    motion = {"qdd": found.qdd, "grasp_wrench": found.grasp_wrench}
    return of_function(fast.inverse_dynamics, given | motion)


def derivatives(what: str, system: System) -> Example:
    """Return derivatives of forward dynamics, as the benchmark of derivatives requests them."""
    asked = DerivativeRequest(system, what)
    kind: Any = asked.kind
    names: Any = {"of": tuple(asked.numbers), "by": tuple(asked.numbers)} | asked.names
    function = hf.compile(system.chain).forward_dynamics.derived(kind, names["of"], names["by"])
    vectors = {f"{WITH}{name}": np.repeat(x[None], system.states, axis=0) for name, x in asked.numbers.items()}
    return of_function(function, inputs(system) | vectors)


def step(system: System) -> Example:
    """Return a step of a rollout by RK4 under constant torques."""
    made = hf.compile_rollout(system.chain)
    kernel, start = made.kernel, made.start(*system.arrays[:2], *system.arrays[3:], tau=system.tau)
    given = {"begin": 0.0, "step": STEP, "held": 0.0, "object_wrench": np.zeros(6), "control.tau": system.tau}
    carried = {f"last.{name}": x for name, x in start.arrays.items()}
    arrays = {**kernel.parameters, **kernel.defaults, **given, **carried}
    arrays = {name: np.asarray(arrays[name]) for name, e in kernel.externals.items() if e.role != "output"}
    return Example(kernel.externals, kernel.step_code.schedule, arrays)


def step_of_simulate(system: System) -> Example:
    """Return the same for one system, compiled as `simulate` does it."""
    return replace(step(system), systems=1, quick=True)


def cone() -> Example:
    """Return an iteration of an interior-point method."""
    drawn = [cone_iteration.example(seed) for seed in range(STATES)]
    arrays = {name: np.array([x[name] for x in drawn]) for name in drawn[0]}
    return Example(cone_iteration.EXTERNALS, cone_iteration.schedule(), arrays)


def two_arms() -> System:
    """Return the system of the headline benchmark."""
    return make_system(2, 7, STATES)


EXAMPLES: dict[str, Callable[[], Example]] = {
    "forward dynamics": lambda: forward(two_arms()),
    "inverse dynamics": lambda: inverse(two_arms()),
    "VJP": lambda: derivatives(VJP, two_arms()),
    "JVP": lambda: derivatives(JVP, two_arms()),
    "Jacobian": lambda: derivatives(JACOBIAN, two_arms()),
    "step of a rollout": lambda: step(two_arms()),
    "step of simulate": lambda: step_of_simulate(two_arms()),
    "trunk of 3": lambda: forward(trunks.make_trunk_system(trunks.TORSO, STATES)),
    "16 x 7": lambda: forward(make_system(16, 7, STATES)),
    "cone iteration": cone,
}
