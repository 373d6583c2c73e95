"""The machine code of one step of many systems: its arrays, and the data that systems carry between steps."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from copy import copy
from functools import cached_property, partial
from typing import Any

import numpy as np

from holdfast.compiled.computation import Computation
from holdfast.compiled.kernels import batch_kernel
from holdfast.compiled.structure import Options
from holdfast.compiled.traced_chain import Given, framed, traced
from holdfast.compiler.kernel import BatchKernel, address_of
from holdfast.compiler.schedule import External
from holdfast.control.compiled_law import PACKAGES
from holdfast.control.controller import ControlLaw
from holdfast.control.traced_law import law_key
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.simulation.accounts import Forces
from holdfast.simulation.environment import GivenInputs
from holdfast.simulation.joint_friction import joint_friction
from holdfast.simulation.rollout import traced_step
from holdfast.simulation.rollout.between_steps import SMALLEST_FORCES, SystemQuestion
from holdfast.simulation.rollout.step_code import SERIAL_STEP, StepCode
from holdfast.simulation.rollout.traced_step import StepModel
from holdfast.simulation.rollout.user_functions import Motions
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial.scalar import Array

Systems = dict[str, Array]  # carried arrays by name, (systems, *shape) each


class Table:
    """The addresses and strides of the arrays of machine code.

    Attributes:
        rows: (arrays, 2) address and stride of each array, in numbers of 8 bytes; 0 for one that all systems share.
    """

    def __init__(self, externals: Mapping[str, External], arrays: Mapping[str, Array]) -> None:
        """Store the arrays of machine code, and those among them that calls need not give."""
        self._layout = {name: (row, e.size, len(e.shape)) for row, (name, e) in enumerate(externals.items())}
        self.rows, self._kept = np.zeros((len(externals), 2), np.int64), []
        self._enter(arrays)

    def with_arrays(self, given: Mapping[str, Array]) -> Table:
        """Return the table with further arrays, which live as long as it does; names without a row are left out."""
        other = copy(self)
        other.rows, other._kept = self.rows.copy(), [*self._kept]
        other._enter(given)
        return other

    def places(self, arrays: Mapping[str, tuple[Array, int]]) -> Array:
        """Return where arrays of several runs lie, as `successive` takes it, (4, arrays).

        Args:
            arrays: by name, an array whose first axis is the run, and the stride of its systems in numbers of 8 bytes.
        """
        rows = [(self._layout[name][0], x.ctypes.data, x.strides[0], stride) for name, (x, stride) in arrays.items()]
        return np.array(rows).T

    def successive(self, places: Array, count: int) -> Array:
        """Return the tables of the first of several successive runs, (count, arrays, 2); see `places`."""
        found = np.tile(self.rows, (count, 1, 1))
        row, address, apart, stride = places
        found[:, row, 0], found[:, row, 1] = address + np.arange(count)[:, None] * apart, stride
        return found

    def _enter(self, given: Mapping[str, Array]) -> None:
        places, rows = [], []
        for name, x in given.items():
            if name in self._layout:
                row, size, rank = self._layout[name]
                kept = np.asarray(x, dtype=float, order="C")
                self._kept.append(kept)
                places.append(row)
                rows.append((address_of(kept), size if kept.ndim > rank else 0))
        if places:
            self.rows[places] = rows


class StepKernel:
    """The compiled step of one chain with one control law.

    Attributes:
        chain: the chain.
        law: the control law.
        motions: motions of the moving bases.
        acting: wrenches that are part of the machine code, in addition to those of a call.
        structure: the structure of the chain for the compiler.
        model: chain, law and surroundings together, for tracing.
        generic_rank: rank of the constraint away from singular configurations; -1 if it is unknown.
        code: how steps of this kind of chain become machine code.
        adjoints: the adjoint kernels created so far.
        carried: shapes of the arrays that a system carries between two steps.
        externals: input and output arrays of the machine code.
        parameters: parameters of the chain, with the names of the machine code.
        defaults: default values of optional inputs.
    """

    def __init__(
        self,
        chain: ClosedChain,
        law: ControlLaw,
        tableau: Tableau,
        generic_rank: int,
        *,
        motions: Motions | None = None,
        acting: GivenInputs | None = None,
        options: Options | None = None,
        quick: bool = False,
        code: StepCode = SERIAL_STEP,
    ) -> None:
        """Store what is to be compiled at the first step; `quick` shortens the compilation at the cost of run time."""
        self.chain, self.law, self.motions, self.acting = chain, law, dict(motions or {}), acting
        self.generic_rank, self.code, self._quick = generic_rank, code, quick
        self.structure = structure = code.structure(chain, options or Options(), generic_rank)
        self.carried = code.carried(chain, law, structure.options)
        self.externals = externals = code.externals(structure, law, self.carried)
        self.model = StepModel(structure, law, self.motions, acting)
        step, slopes, self._instant = code.functions(self.model, tableau)
        self.step_code = batch_kernel(self.computation(f"step/{tableau.name}", externals, step), quick)
        self._slopes = batch_kernel(self.computation("evaluation", externals, slopes), quick)
        self._questions: dict[SystemQuestion, tuple[BatchKernel, Table, Mapping[str, External]]] = {}
        self.adjoints: dict[Any, Any] = {}  # values are `adjoint.AdjointKernel`, created on demand
        own = code.parameters(chain, generic_rank)
        self.parameters = {name: own[name] for name, e in externals.items() if e.role == "parameter"}
        self.defaults: Systems = dict.fromkeys(("least_margin", "least_joint_margin"), np.array(-np.inf))
        self.defaults |= {"keep_rows": np.array(0.0), "search": np.array(1.0), "notice": np.array(0.0)}
        self._required = externals.keys() - self.parameters.keys() - self.defaults.keys()
        self._own = Table(externals, self.parameters | self.defaults)

    @cached_property
    def jump_code(self) -> BatchKernel:
        """Machine code of instants at which torques or inputs jump; the input `held` has to be set."""
        if self._instant is None:
            return self.step_code
        return batch_kernel(self.computation("instant", self.externals, self._instant), self._quick)

    def with_new_inputs(self, tableau: Tableau) -> Computation:
        """Return the computation of a step that also evaluates the slope at its start, as its inputs have changed."""

        def step(given: Given) -> dict[str, Any]:
            return traced_step.step(self.model, tableau, {**given, **traced_step.evaluation(self.model, given)})

        return self.computation("", self.externals, step)

    def computation(
        self, what: str, externals: Mapping[str, External], function: Callable[[Given], Mapping[str, Any]]
    ) -> Computation:
        """Return a computation for this chain and law.

        Args:
            what: name of what is computed, part of the key in the cache.
            externals: input and output arrays.
            function: takes the traced arrays and returns the outputs by name.
        """
        law, moving = self.law, self._surroundings
        friction = hashlib.sha256(joint_friction(self.chain).tobytes()).hexdigest()
        key = f"{what}/{self._law_key}/{list(law.parameters.items())}/{len(law.memory)}/{friction}/{moving}"
        name = key if what and self._law_key and moving is not None else ""
        return Computation(name, self.structure, externals, partial(traced, externals, function), packages=PACKAGES)

    def systems(self, state: Mapping[str, Array], memory: Array | None = None, count: int | None = None) -> Systems:
        """Return systems of which only the states are set; a step of length zero projects and evaluates them.

        Args:
            state: arrays with the names of `state_fields`, with one row per system or one value for all.
            memory: memory of the law, likewise; by default its initial memory.
            count: number of systems if no array has rows.
        """
        count = len(state["object_pose"]) if count is None else count
        found = {name: np.zeros((count, *shape)) for name, shape in self.carried.items()}
        for name, x in state.items():
            found[name][...] = x
        if "memory" in found:
            found["memory"][...] = self.law.memory if memory is None else memory
        if "worst_margin" in found:
            found["worst_margin"][...] = np.inf
        if "held_rows" in found:
            found["held_rows"][...] = 1.0
        return found

    def run(
        self,
        systems: Systems,
        inputs: Mapping[str, Array],
        parameters: Mapping[str, Array],
        repeats: int = 1,
        threads: int | None = None,
        *,
        slopes_only: bool = False,
    ) -> None:
        """Take a number of steps in place; a system that fails keeps its last good state and gets a status code.

        Args:
            systems: systems from `systems` (see `require_own`), whose slopes were evaluated with the same inputs.
            inputs: inputs by name, with one value for all systems or one row per system. No margin stops a system
                unless one is given. A system that passes a singular configuration is stopped unless "search" is 0.
            parameters: parameters that differ from those of the chain, likewise.
            repeats: number of steps.
            threads: as for `Rollout.step`.
            slopes_only: take no step, but evaluate the slopes at the current states again, with new inputs.
        """
        given = {**parameters, **inputs, **{f"last.{name}": x for name, x in systems.items()}}
        assert self._required <= given.keys(), "machine code would read where nothing is"
        table = self.table(given)
        code = self._slopes if slopes_only else self.step_code
        code.run_batch(table.rows, len(systems["object_pose"]), threads, repeats)
        del table  # its arrays must live until the machine code has read them

    def table(self, given: Mapping[str, Array]) -> Table:
        """Return the table of the step's arrays, among them the given ones."""
        return self._own.with_arrays(given)

    def ask(
        self,
        question: SystemQuestion,
        systems: Systems,
        inputs: Mapping[str, Array],
        parameters: Mapping[str, Array],
    ) -> Systems:
        """Return the answers to a question about systems, (systems, ...) each.

        Args:
            question: the question, which may overwrite carried arrays.
            systems: systems at their current states, with the forces there.
            inputs: inputs by name as for `run`, among them the time "begin" of each system, and a "step" of zero.
            parameters: parameters that differ from those of the chain, likewise.
        """
        if question not in self._questions:
            self._questions[question] = self._made(question)
        code, own, outputs = self._questions[question]
        count = len(systems["object_pose"])
        found = {name: np.zeros((count, *of_one.shape)) for name, of_one in outputs.items()}
        given = {**parameters, **inputs, **{f"last.{name}": x for name, x in systems.items()}, **found}
        table = own.with_arrays(given)
        code.run_batch(table.rows, count)
        del table  # its arrays must live until the machine code has read them
        return found

    def choose_forces(self, systems: Systems, inputs: Mapping[str, Array], parameters: Mapping[str, Array]) -> None:
        """Replace forces that are not unique, in place, by the smallest ones with the same motion, and their margins.

        Arguments as in `ask`; the systems may be views of larger arrays.
        """
        if not self.structure.options.held:
            return
        given = {name: np.ascontiguousarray(x) for name, x in systems.items()}
        self.ask(SMALLEST_FORCES, given, inputs, parameters)
        for name in (*Forces._fields, "margin"):
            if name in given and given[name] is not systems[name]:
                systems[name][...] = given[name]

    def _made(self, question: SystemQuestion) -> tuple[BatchKernel, Table, Mapping[str, External]]:
        """Return the machine code of a question, which does not depend on the law, its table, and its outputs."""
        more = question.parameters(self.chain)
        outputs = {name: External(shape, "output") for name, shape in question.shapes(self.chain).items()}
        needed = {n: e for n, e in self.externals.items() if not n.startswith(("control.", "added_"))}
        arrays = {**needed, **{name: External(x.shape, "parameter") for name, x in more.items()}, **outputs}

        def of_systems(given: Given) -> Mapping[str, Any]:
            system = traced_step.TracedSystem(self.model, given)
            state = framed(system.state)
            surroundings = system.surroundings(system.time(0.0), state)
            return question.compute(system, surroundings[0], state, surroundings[1], self.generic_rank)

        moving = self._surroundings
        name = "" if moving is None else f"{question.name}/{self.generic_rank}/{list(arrays.items())}/{moving}"
        made = Computation(name, self.structure, arrays, partial(traced, arrays, of_systems), packages=PACKAGES)
        return batch_kernel(made, quick=True), Table(arrays, {**self.parameters, **self.defaults, **more}), outputs

    @cached_property
    def _law_key(self) -> str:
        return law_key(self.law, self.chain)

    @cached_property
    def _surroundings(self) -> str | None:
        """What identifies the motions of bases and the additional wrenches; None if nothing does."""
        return exact_fingerprint([self.motions, self.acting])

    def require_own(self, systems: Systems) -> None:
        """Refuse systems whose arrays do not have the shapes and the layout that the machine code expects.

        Raises:
            StateError: the systems belong to another chain or law, or cannot be written in place.
        """
        count = len(systems["object_pose"])
        for name, shape in self.carried.items():
            x, expected = systems.get(name), (count, *shape)
            if x is None or x.shape != expected:
                found = "none" if x is None else f"shape {x.shape}"
                raise StateError(
                    f"systems: {name}: expected shape {expected}, got {found}; try systems that `start` of this rollout"
                    " returned"
                )
            if x.dtype != np.float64 or not (x.flags.c_contiguous and x.flags.aligned and x.flags.writeable):
                raise StateError(f"systems: {name}: expected float64 in C order, writeable; try writing into the array")
