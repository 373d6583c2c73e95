"""Steps with impulses of contacts on floats; see `impulse_step`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from holdfast.dynamics.contact.contact_forces import (
    RESOLVED,
    ContactProblem,
    FoundForces,
    contact_problem,
    found_forces,
)
from holdfast.dynamics.contact.fixed_modes import ContactModes, Touch
from holdfast.dynamics.contact.rows import ContactRows, contact_rows
from holdfast.dynamics.contact.solve_contacts import surely
from holdfast.dynamics.projection import LEFT_OPEN, WIDEST_GAP, Change
from holdfast.dynamics.result import ForwardResult
from holdfast.errors import ClosureError, SingularChainError, StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.contact_stepper import ContactStepper
from holdfast.simulation.environment import Environment
from holdfast.simulation.impulse_step import PARTS_OF_STEP, ImpulseProblem, ImpulseStep, impulse_step
from holdfast.simulation.instant import ContactsAt, Instant, evaluate
from holdfast.simulation.step import Gaps, back_on_constraint
from holdfast.simulation.stepper import NO_GAPS, Advance, together
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class SteppedReference:
    """What a step asks, on floats; see `impulse_step.SteppedChain`.

    Attributes:
        environment: the chain, its base motions and external inputs.
        evaluate: function (t, state) that returns the chain there with its controls, without contacts.
        held: rows of the grasps that the step imposes.
    """

    environment: Environment
    evaluate: partial[Instant]
    held: Array | None

    def at(self, t: float, state: State) -> tuple[ClosedChain, Inputs]:
        """Return the chain and its shaped inputs."""
        chain, inputs = self.environment.at(t, state)
        return chain, inputs.shaped(chain)

    def on_grasps(self, t: float, state: State) -> State:
        """Return a state projected onto the grasps.

        Raises:
            ClosureError: the step is too long for that.
        """
        return back_on_constraint(self.environment, t, state, self.held)[0] if self.environment.chain.grasps else state

    def accelerated(self, t: float, state: State) -> tuple[Change, Array]:
        """Return the accelerations and the power without contacts."""
        at = self.evaluate(t=t, state=state)
        return Change(at.result.qdd, at.result.object_acceleration, at.result.base_acceleration), at.power

    def resolve(self, problem: ImpulseProblem) -> FoundForces:
        """Return the impulses, by as many ways as it takes.

        Raises:
            StateError: none are found that satisfy the laws.
        """
        rows, near = problem.rows, np.flatnonzero(problem.near)
        force, mode = np.zeros((len(rows.gap), 3)), np.zeros(len(rows.gap), int)
        if not len(near):
            return FoundForces(force, np.zeros(6), np.zeros(6), force, mode, 0.0)
        of_near = rows.C[near], problem.free[near], rows.friction[near]
        reduced = contact_problem(problem.mobility, *of_near, np.zeros(len(near)), np.zeros((len(near), 2)), False)
        begin = np.einsum("kia,ka->ki", rows.axes[near], problem.start[near])
        found = _resolved(reduced, begin if begin.any() else None)
        force[near], mode[near] = found.force, found.mode
        return found._replace(force=force, mode=mode)


def _resolved(problem: ContactProblem, start: Array | None) -> FoundForces:
    """Return the forces of a problem.

    Raises:
        StateError: with the residual.
    """
    with np.errstate(all="ignore"):  # a step of the solver that overflows is not taken
        found = found_forces(problem, surely(problem, start))
    size = max(float(np.abs(c.free).max()) for c in problem.contacts)
    if not found.residual * min(size, 1.0) <= RESOLVED:
        raise StateError(
            f"contacts: no impulses were found that satisfy the laws to {RESOLVED:g} of the velocities or m/s; the best"
            f" ones violate them by {found.residual:.1e}; try fewer contacts at once, or less friction"
        )
    return found


@dataclass(frozen=True, eq=False)
class ImpulseStepper(ContactStepper):
    """Takes midpoint steps with impulses of contacts; see `Stepper`. The modes are those at the stretch's start."""

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return [self._surely(now, end) for end in ends]

    def _surely(self, now: Instant, end: float) -> Advance:
        """Return the result of a step, in parts if it fails."""
        whole = found = self._attempted(now, end)
        for parts in PARTS_OF_STEP:
            if found.failure is None:
                break
            found = self._of_parts(now, end, parts)
        return whole if found.instant is None else found

    def _attempted(self, now: Instant, end: float) -> Advance:
        try:
            return self._stepped(now, end)
        except (SingularChainError, ClosureError, StateError) as cause:
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=cause)

    def _of_parts(self, now: Instant, end: float, parts: int) -> Advance:
        """Return the result of a step in equal parts, with the mean of their contact forces."""
        at, done, forces = now, [], []
        for k in range(1, parts + 1):
            part = self._attempted(at, end if k == parts else now.t + k / parts * (end - now.t))
            if part.instant is None:
                return replace(part, t=end)
            assert part.instant.touch is not None
            at = replace(part.instant, memory=now.memory)
            done.append(part)
            forces.append(part.instant.touch.force)
        whole = together(done)
        assert whole.instant is not None
        assert whole.instant.touch is not None
        touch = replace(whole.instant.touch, force=np.mean(forces, axis=0))
        return replace(whole, instant=replace(whole.instant, touch=touch))

    def again(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a step's end from which a run is resumed; its impulses are those of the step before."""
        contacts = partial(touch_of, np.zeros((len(self.modes.mode), 3)), self.modes.mode)
        return self._at_end(t, state, memory, contacts)

    def _stepped(self, now: Instant, end: float) -> Advance:
        """Return the chain one step later.

        Raises:
            ClosureError: grasps stay open, or closed contacts penetrate.
        """
        of, held = (self.environment, self.controller), now.result.held
        at = partial(evaluate, *of, memory=now.memory, generic_rank=self.generic_rank, held=held)
        chain, h = SteppedReference(self.environment, at, held), end - now.t
        found = impulse_step(chain, now.state, now.t, h, np.zeros((len(self.modes.mode), 3)))
        _require_closed(found)
        touch = _touch(found.state, found.rows, found.force, found.mode)
        instant = self._at_end(end, found.state, now.memory, lambda *_: touch)
        gaps = Gaps(*(np.array(pair) for pair in zip(found.drift, found.gaps, strict=True)))
        return Advance(end, instant, gaps, found.work)

    def _at_end(self, t: float, state: State, memory: Any, contacts: ContactsAt) -> Instant:
        of = self.environment, self.controller, t, state, memory
        return evaluate(*of, generic_rank=self.generic_rank, contacts=contacts)


def _require_closed(found: ImpulseStep) -> None:
    """Refuse a step that is too long for its grasps or contacts.

    Raises:
        ClosureError: they stay open, or penetrate.
    """
    if not found.drift.position <= WIDEST_GAP or not found.gaps.position <= LEFT_OPEN:
        raise ClosureError(
            f"the step leaves the grasps open by {found.drift.position:.3g} (m or rad), and its projection by"
            f" {found.gaps.position:.3g}; try a smaller time step"
        )
    if not found.rows.gap.min() >= -LEFT_OPEN:
        raise ClosureError(
            f"the step leaves the object {-found.rows.gap.min():.3g} m within a shape of the world, which its"
            " projection does not mend; try a smaller time step"
        )


def touch_of(force: Array, mode: Array, chain: ClosedChain, state: State, free: ForwardResult) -> Touch:
    """Return contacts at a step's end with the forces (k, 3), world axes, and modes of the step."""
    del free
    assert chain.touching is not None
    return touch_with_rows(contact_rows(chain.touching, state.object_frame, state.object_twist), state, force, mode)


def touch_with_rows(rows: ContactRows, state: State, force: Array, mode: Array) -> Touch:
    """Return the same with the contacts' rows at that state."""
    return _touch(state, rows, np.einsum("kia,ka->ki", rows.axes, force), mode)


def _touch(state: State, rows: ContactRows, force: Array, mode: Array) -> Touch:
    u, k = rows.velocity(state.object_twist), len(mode)
    never = np.full(k, np.inf)
    return Touch(rows, force, u, ContactModes(mode, np.zeros((k, 3))), never, never)
