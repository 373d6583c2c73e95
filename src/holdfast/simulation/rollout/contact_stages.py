"""Steps in fixed modes of contacts with the world whose stages are machine code; see `ContactStepper`.

Every stage takes the object's acceleration without contact forces and its mobility from machine code, solves for the
forces of the closed contacts, and takes the stage again with them, all ends of a step in one call.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.compiled.bound import BoundFunction
from holdfast.compiled.chain import compile
from holdfast.compiled.computation import Computation
from holdfast.compiled.kernels import kernel
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import Given, traced, unit_pose
from holdfast.compiler.kernel import Bound, Kernel
from holdfast.compiler.schedule import External
from holdfast.dynamics.contact.fixed_modes import ContactModes, RestResponses, Touch, on_contacts, touch_with
from holdfast.dynamics.contact.rows import ContactRows, contact_rows
from holdfast.dynamics.projection import Change, Gap
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.checkpoint import Origin
from holdfast.simulation.contact_stepper import TOUCH_WRENCH
from holdfast.simulation.instant import Instant
from holdfast.simulation.rollout.between_steps import ACCOUNTS
from holdfast.simulation.rollout.compiled_steppers import StagewiseStepper
from holdfast.simulation.rollout.fused_stepper import systems_at
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.rows import StageInputs, instant_of, late, slope_at
from holdfast.simulation.step import EvaluationRequest, Gaps, ProjectionRequest, StageRequest
from holdfast.spatial.frozen import NOT_GIVEN, changed
from holdfast.spatial.scalar import Array
from holdfast.state import State


@dataclass(frozen=True, eq=False)
class CompiledResponses(RestResponses):
    """The responses of a chain at rest by machine code; for chains whose grasps are independent, without springs.

    Attributes:
        touched: the chain with the points and shapes, which `chain` has not.
    """

    touched: ClosedChain = NOT_GIVEN

    @cached_property
    def _mobility(self) -> BoundFunction:
        return compile(self.chain).object_mobility.bind()

    @cached_property
    def _forward(self) -> BoundFunction:
        return compile(self.chain, generic_rank=self.chain.constraint_row_count).bind(gravity=np.zeros(3))

    @cached_property
    def _closure(self) -> BoundFunction:
        return compile(self.chain).closure.bind()

    @cached_property
    def _code_of_rows(self) -> Kernel:
        return _rows_kernel(self.touched)

    @cached_property
    def _rows(self) -> Bound:
        return self._code_of_rows.bind()

    @cached_property
    def friction(self) -> Array:
        """Coefficients of friction, (k,)."""
        return self._of_shapes("friction")

    @cached_property
    def restitution(self) -> Array:
        """Coefficients of restitution, (k,)."""
        return self._of_shapes("restitution")

    def _of_shapes(self, name: str) -> Array:
        assert self.touched.touching is not None
        return np.array([getattr(one.shape, name) for one in self.touched.touching.candidates])

    def rows(self, state: State) -> ContactRows:
        """Return the contacts' rows."""
        return self.rows_of(state.object_pose, state.object_twist)

    def rows_of(self, pose: Array, twist: Array) -> ContactRows:
        """Return the contacts' rows for an object with a pose (7,) and a twist (6,)."""
        of = self._rows
        of.arrays["object_pose"][...], of.arrays["object_twist"][...] = pose, twist
        of.run()
        gap, C, drift, carried, point, axes = (of.arrays[name].copy() for name in ContactRows._fields[:6])
        return ContactRows(gap, C, drift, carried, point, axes, self.friction, self.restitution)

    def gaps_of(self, pose: Array, twist: Array) -> Array:
        """Return the contacts' gaps (..., k) of objects with poses (..., 7) and twists (..., 6), as in `rows`."""
        return self.fields_of(pose, twist)["gap"]

    def fields_of(self, pose: Array, twist: Array) -> dict[str, Array]:
        """Return gaps, directions and axes of contacts as in `rows`, (..., k, ...), of objects as in `gaps_of`."""
        code = self._code_of_rows
        lead = pose.shape[:-1]
        count = math.prod(lead)
        given = {"object_pose": pose, "object_twist": twist}
        arrays = {name: np.ascontiguousarray(x).reshape(count, -1) for name, x in given.items()}
        outputs = {name: np.empty((count, *one.shape)) for name, one in code.externals.items() if name not in given}
        code.run_arrays(arrays | outputs, count, threads=1)
        return {name: x.reshape(*lead, *x.shape[1:]) for name, x in outputs.items()}

    def gaps(self, state: State) -> Gap:
        """Return the largest position and velocity residuals of any grasp."""
        of = self._closure
        for name in ("q", "qd", "object_pose", "object_twist"):
            of.arrays[name][...] = getattr(state, name)
        found = [*of().values()]
        position, velocity = ([float(np.abs(one[k]).max(initial=0.0)) for one in found] for k in (0, 1))
        return Gap(max(position, default=0.0), max(velocity, default=0.0))

    def mobility(self, state: State, positions: bool = False) -> Array:
        """Return the object's mobility (6, 6)."""
        of = self._mobility
        of.arrays["q"][...], of.arrays["object_pose"][...] = state.q, state.object_pose
        return np.array(of())

    def change(self, state: State, push: Array, positions: bool = False) -> Change:
        """Return the change of the velocities by an impulse (6,) on the object."""
        of = self._forward
        of.arrays["q"][...], of.arrays["object_pose"][...] = state.q, state.object_pose
        of.arrays["object_wrench"][...] = push
        if of.run() != 0:
            return super().change(state, push, positions)
        found = of.result
        return Change(found.qdd.copy(), found.object_acceleration.copy(), None)


def _rows_kernel(chain: ClosedChain) -> Kernel:
    """Return machine code of `contact_rows` for the points and shapes of a chain."""
    touching = chain.touching
    assert touching is not None
    k = len(touching.candidates)
    found = {"gap": (k,), "C": (k, 3, 6), "drift": (k, 3), "carried": (k, 3), "point": (k, 3), "axes": (k, 3, 3)}
    externals = {"object_pose": External((7,), "input"), "object_twist": External((6,), "input")}
    externals |= {name: External(shape, "output") for name, shape in found.items()}

    def rows(given: Given) -> dict[str, Array]:
        frame = unit_pose(given["object_pose"], given["object_twist"][3:])
        return {name: getattr(contact_rows(touching, frame, given["object_twist"]), name) for name in found}

    structure = Structure(chain, Options())
    return kernel(Computation("contact_rows", structure, externals, lambda: traced(externals, rows)))


@dataclass(frozen=True, eq=False)
class StagewiseContactStepper(StagewiseStepper):
    """Takes steps in fixed modes by machine code; their ends are projected onto grasps and closed contacts.

    Attributes:
        modes: what the contacts do, with slip directions at the start of the stretch.
        responses: the chain's responses at rest.
        kernels: its machine code, which the steppers of all stretches share; empty until it is needed.
    """

    modes: ContactModes = NOT_GIVEN
    responses: CompiledResponses = NOT_GIVEN
    kernels: list[StepKernel] = field(default_factory=list)

    @cached_property
    def kernel(self) -> StepKernel:
        """A compiled step of length zero; see `StagewiseStepper`."""
        if not self.kernels:
            self.kernels.append(super().kernel)
        return self.kernels[0]

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state; see `Stepper`."""
        now, gaps = super().start(t, state, memory)
        closed = on_contacts(now.chain, now.state, self.modes, responses=self.responses)
        return self.evaluate(t, closed, memory), gaps

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state without projection."""
        found, (stage,), (touch,) = self._touching([t], [state], memory, None, [self.modes])
        return replace(instant_of(found, 0, stage), touch=touch)

    def replies(self, now: Instant, requests: Sequence[EvaluationRequest]) -> list[Any]:
        """Return the replies to requests; see `Stepper`. The slip directions of `now` hold for the step."""
        modes = self.modes if now.touch is None else now.touch.modes
        times, states, held = [one.t for one in requests], [one.state for one in requests], now.result.held
        if isinstance(requests[0], ProjectionRequest):
            settled = replace(modes, begins=frozenset())
            found = [self._on_contacts(*one, settled) for one in self._closed(times, states, held)]
            if not modes.begins:
                return found
            closed = [state for state, _ in found]  # whose slips turn into their directions at the step's end
            touches = self._touching(times, closed, now.memory, held, [modes] * len(times))[2]
            turned = [replace(touch.modes, begins=modes.begins) for touch in touches]
            return [self._on_contacts(*one, own) for one, own in zip(found, turned, strict=True)]
        rows = held if isinstance(requests[0], StageRequest) else None
        ends = [one.until if isinstance(one, StageRequest) else one.t for one in requests]
        each = [modes if now.touch is None else now.touch.modes_within(end - now.t) for end in ends]
        found, stages, touches = self._touching(times, states, now.memory, rows, each)
        return [
            slope_at(found["slope"][row], one)
            if isinstance(one, StageRequest)
            else _late(found, row, stages[row], touches[row])
            for row, one in enumerate(requests)
        ]

    def accelerations(self, origin: Origin, state: State) -> Array:
        """Return the acceleration of the object without contact forces, (6,), at a time and with a memory."""
        stage = self._driven(self._stage_inputs(origin.t, state), state, origin.memory)
        return self._run([state], [stage], origin.memory, None, held=True)["object_acceleration"][0]

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        systems = systems_at(self.kernel, arrays)
        stages = self._stages_of(t.tolist(), systems)
        pushed = [_with_wrench(one, wrench) for one, wrench in zip(stages, arrays[TOUCH_WRENCH], strict=True)]
        inputs, parameters = self._given(pushed, held=True)
        return self.kernel.ask(ACCOUNTS, systems, inputs, parameters)

    def _on_contacts(self, state: State, gaps: Gaps, modes: ContactModes) -> tuple[State, Gaps]:
        """Return a state on the grasps that is moved onto the closed contacts, and the gaps."""
        chain = self.environment.chain
        if not len(modes.closed):
            return state, gaps
        closed = on_contacts(chain, state, modes, responses=self.responses)
        after = self.responses.gaps(closed)
        both = (gaps.position[0], after.position), (gaps.velocity[0], after.velocity)
        return closed, Gaps(*(np.array(pair) for pair in both))

    def _touching(
        self, times: list[float], states: list[State], memory: Any, rows: Array | None, modes: Sequence[ContactModes]
    ) -> tuple[Systems, list[StageInputs], list[Touch]]:
        """Return the systems at the given states with contact forces, their inputs with these, and the contacts."""
        stages = [
            self._driven(self._stage_inputs(t, state), state, memory) for t, state in zip(times, states, strict=True)
        ]
        found = self._run(states, stages, memory, rows, held=True)
        touches = [
            touch_with(self.responses, state, alpha, of)
            for state, alpha, of in zip(states, found["object_acceleration"], modes, strict=True)
        ]
        stages = [_with_wrench(one, at.rows.wrench(at.force)) for one, at in zip(stages, touches, strict=True)]
        if any(at.force.any() for at in touches):
            found = self._run(states, stages, memory, rows, held=True)
        if rows is None:
            self.kernel.choose_forces(found, *self._given(stages, held=True))
        return found, stages, touches


def _with_wrench(at: StageInputs, wrench: Array) -> StageInputs:
    given = at.inputs.object_wrench
    return replace(at, inputs=changed(at.inputs, object_wrench=wrench if given is None else given + wrench))


def _late(found: Systems, row: int, at: StageInputs, touch: Touch) -> Instant:
    """Return one system with its contacts as an instant that is evaluated in full only when this is needed."""
    tau = found["drive"][row] if at.tau is None else at.tau
    made = late(found, row, at.t, at.chain, tau, lambda: replace(instant_of(found, row, at), touch=touch))
    vars(made)["touch"] = touch
    return made


@functools.lru_cache(maxsize=8)  # a run has a stretch, and a stepper, for every change of modes
def responses_of(chain: ClosedChain) -> CompiledResponses:
    """Return the responses of a chain at rest by machine code."""
    return CompiledResponses(changed(chain, touching=None), touched=chain)
