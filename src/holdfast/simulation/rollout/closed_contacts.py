"""The stepper of runs by events with closed contacts: whole steps in fixed modes by machine code.

What takes decisions goes by stages: slips that begin, loads of sliding contacts that are not shared by least norm,
steps that fail. Where nothing slides, the share of a load changes no motion, and is found after the steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from holdfast.dynamics.contact.fixed_modes import ContactModes, Touch
from holdfast.dynamics.contact.load_share import within_cones
from holdfast.dynamics.contact.masked_modes import FOREVER
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.simulation.checkpoint import Origin
from holdfast.simulation.contact_stepper import TOUCH_WRENCH
from holdfast.simulation.instant import Instant
from holdfast.simulation.rollout.between_steps import ACCOUNTS
from holdfast.simulation.rollout.contact_stages import CompiledResponses, StagewiseContactStepper
from holdfast.simulation.rollout.fused_stepper import FusedStepper, Taken, systems_at
from holdfast.simulation.rollout.kernel import Systems
from holdfast.simulation.rollout.rows import StageInputs, instant_of, state_rows
from holdfast.simulation.rollout.traced_modes import IN_MODES
from holdfast.simulation.sample import HAND_WRENCH, kept_modes
from holdfast.simulation.step import EvaluationRequest, Gaps
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.frozen import NOT_GIVEN, changed
from holdfast.spatial.scalar import Array
from holdfast.state import State


@dataclass(frozen=True, eq=False)
class ClosedContactStepper(FusedStepper):
    """Takes whole steps with contacts in fixed modes; see `ContactStepper`.

    Attributes:
        modes: what the contacts do, with slip directions at the start of the stretch.
        responses: the chain's responses at rest.
        stages: takes what takes decisions.
    """

    contacts: ClassVar[str] = IN_MODES

    modes: ContactModes = NOT_GIVEN
    responses: CompiledResponses = NOT_GIVEN
    stages: StagewiseContactStepper = NOT_GIVEN

    def in_modes(self, modes: ContactModes, stages: StagewiseContactStepper) -> ClosedContactStepper:
        """Return the stepper of another stretch, which shares machine code and memory."""
        made = replace(self, modes=modes, stages=stages)
        vars(made)["_takers"] = self._takers
        return made

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state, projected onto grasps and closed contacts; see `Stepper`."""
        now, gaps = self.stages.start(t, state, memory)
        return self.evaluate(t, now.state, memory), gaps

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state without projection."""
        return self._at_once(t, state, memory, self.modes) or self.stages.evaluate(t, state, memory)

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`. The slip directions of `now` hold for them."""
        if not self.follows(now):
            return self.stages.advance(now, ends)
        whole = [t for t in ends if not self._modes_within(now, t).straight]
        found = {one.t: one for one in super().advance(now, whole)} if whole else {}
        if left := [t for t in ends if t not in found or found[t].instant is None]:
            found |= {one.t: self._again(one, now) for one in self.stages.advance(now, left)}
        return [found[t] for t in ends]

    def replies(self, now: Instant, requests: Sequence[EvaluationRequest]) -> list[Any]:
        """Return the replies to requests; see `Stepper`."""
        return self.stages.replies(now, requests)

    def accelerations(self, origin: Origin, state: State) -> Array:
        """Return the acceleration of the object without contact forces, (6,), at a time and with a memory."""
        return self.stages.accelerations(origin, state)

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        inputs = self._inputs(t, np.array(0.0), True)
        inputs["object_wrench"] = inputs["object_wrench"] + arrays[TOUCH_WRENCH]
        return self.kernel.ask(ACCOUNTS, systems_at(self.kernel, arrays), inputs, {})

    def follows(self, now: Instant) -> bool:
        """Return whether steps from an instant may be taken together: no slip begins there."""
        return not self._modes_at(now).begins

    def start_of(self, now: Instant, count: int = 1) -> Systems:
        """Return a number of systems at the start of steps from an instant; see `FusedStepper`."""
        systems = super().start_of(now, count)
        _enter(systems, self._modes_at(now))
        turning, stops = (np.inf, np.inf) if now.touch is None else (now.touch.turning_time, now.touch.stops_in)
        systems["touch_turning"][...] = np.minimum(turning, FOREVER)
        systems["touch_stops"][...] = np.minimum(stops, FOREVER)
        return systems

    def modes_before(self, starts: Mapping[str, Array], k: int, modes: ContactModes | None) -> ContactModes | None:
        """Return the modes in which the end of a step is evaluated, which are those at its start."""
        return replace(self.modes, slip=starts["touch_slip"][k].copy(), begins=frozenset(), straight=frozenset())

    def of_samples(self, x: Mapping[str, Array]) -> Systems:
        """Return what samples (k, ...) record of contacts, as `arrays_of` does of an instant."""
        mode, found = x["touch_mode"].astype(int), list[Systems]()
        for k, force in enumerate(x["touch_push"]):
            rows = self.responses.rows_of(x["object_pose"][k], x["object_twist"][k])
            of_forces = {"touch_force": rows.in_world(force), TOUCH_WRENCH: rows.wrench(force)}
            found.append(of_forces | kept_modes(rows, force, mode[k]))
        none = np.zeros((len(mode), len(self.environment.chain.arms), 6))
        return {"touch_mode": mode, HAND_WRENCH: none} | {
            name: np.array([one[name] for one in found]) for name in found[0]
        }

    def take(
        self,
        now: Instant,
        times: Array,
        jumps: Array,
        remember: Callable[[int, Systems], Array | None] | None,
    ) -> Taken:
        """Return the results of successive steps; see `FusedStepper`."""
        taken = super().take(now, times, jumps, remember)
        return taken._replace(again=lambda steps, lengths: self._with_shares(taken.again(steps, lengths)))

    def _choose_forces(self, systems: Systems, t: Array) -> None:
        super()._choose_forces(systems, t)
        self._with_shares(systems)

    def _with_shares(self, systems: Systems) -> Systems:
        """Return systems whose loads are shared as `load_share` does; those of least norm are replaced in place."""
        rows = np.flatnonzero((systems["touch_shared"] < 0.5) & (systems["code"] == 0.0))
        if not len(rows):
            return systems
        push = systems["touch_push"][rows]
        modes = replace(self.modes, mode=systems["touch_mode"][rows[0]].astype(int))
        of, units = modes.imposed()
        found = self.responses.fields_of(systems["object_pose"][rows], systems["object_twist"][rows])
        D = np.einsum("smia,mi->sma", found["C"][:, of], units)
        x = np.einsum("smi,mi->sm", push[:, of], units)
        share = within_cones(of, D, self.responses.friction, modes.mode == ContactMode.STICKS, x)
        push = np.zeros(push.shape)
        np.add.at(push.swapaxes(0, 1), of, (share[..., None] * units).swapaxes(0, 1))
        systems["touch_push"][rows] = push
        systems["touch_force"][rows] = np.einsum("ska,skai->ski", push, found["axes"])
        systems["touch_shared"][rows] = 1.0
        return systems

    def instant(self, systems: Systems, row: int, t: float, memory: Any) -> Instant:
        """Return one of several systems as an instant with its contacts; see `FusedStepper`."""
        made = super().instant(systems, row, t, memory)
        vars(made)["touch"] = self._touch(systems, row)
        return made

    def _modes_at(self, now: Instant) -> ContactModes:
        return self.modes if now.touch is None else now.touch.modes

    def _modes_within(self, now: Instant, end: float) -> ContactModes:
        return self.modes if now.touch is None else now.touch.modes_within(end - now.t)

    def _advance(self, systems: Systems, row: int, end: float, memory: Any) -> Advance:
        if systems["code"][row] != 0.0:
            return Advance(end, None, NO_GAPS, np.zeros(4))
        return super()._advance(systems, row, end, memory)

    def _again(self, reached: Advance, now: Instant) -> Advance:
        """Return the result of a step by stages whose end is evaluated as anew from a checkpoint."""
        if reached.instant is None:
            return reached
        of = reached.t, reached.instant.state, now.memory
        return replace(reached, instant=self._at_once(*of, self._modes_within(now, reached.t)) or reached.instant)

    def _at_once(self, t: float, state: State, memory: Any, modes: ContactModes) -> Instant | None:
        """Return the chain at a state by machine code; None if that takes decisions."""
        if modes.begins or modes.straight:
            return None
        systems = self.kernel.systems(state_rows([state]), memory)
        _enter(systems, modes)
        inputs = self._inputs(np.array([t]), np.array(0.0), True) | {"keep_rows": np.array(0.0)}
        self.kernel.run(systems, inputs, {})
        return self.instant(self._with_shares(systems), 0, t, memory) if systems["code"][0] == 0.0 else None

    def _whole(self, systems: Systems, row: int, t: float, memory: Any) -> Instant:
        given, push = self._acting.object_wrench, systems[TOUCH_WRENCH][row]
        acting = changed(self._acting, object_wrench=push.copy() if given is None else given + push)
        made = instant_of(systems, row, StageInputs(t, self.environment.chain, acting, None, memory))
        return replace(made, touch=self._touch(systems, row))

    def _touch(self, systems: Systems, row: int) -> Touch:
        x = {name: systems[name][row] for name in systems if name.startswith(("touch_", "object_"))}
        rows = self.responses.rows_of(x["object_pose"], x["object_twist"])._replace(gap=x["touch_gap"].copy())
        mode, turning = x["touch_mode"].astype(int), float(x["touch_turning"])
        modes = replace(self.modes, mode=mode, slip=x["touch_slip"].copy(), begins=frozenset(), straight=frozenset())
        speed = np.where(mode == ContactMode.SLIPS, x["touch_speed"], np.inf)
        stops = np.where(x["touch_stops"] < FOREVER, x["touch_stops"], np.inf)
        velocity, force = rows.velocity(x["object_twist"]), x["touch_push"].copy()
        return Touch(rows, force, velocity, modes, speed, stops, turning if turning < FOREVER else np.inf)


def _enter(systems: Systems, modes: ContactModes) -> None:
    systems["touch_mode"][...], systems["touch_slip"][...] = modes.mode, modes.slip
