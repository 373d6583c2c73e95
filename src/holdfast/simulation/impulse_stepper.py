"""Steps with impulses of contacts: the midpoint rule, in which every gap stays open or closed at the step's end.

    x_m = x + h/2 v, on the grasps;   v_1 = v + h a(x_m, v_m)                                 without contacts
    0 <= u_n + h/2 drift_n + gap / h  _|_  lambda_n >= 0,   Coulomb's law with u_t + h/2 drift_t       (at x_m)
    x+ = x + h/2 (v + v+),   at a touch x + h v+;   then grasps and closed gaps are closed

v_m = (v + v+) / 2 is that of a first pass with v_m = v. The rows are those at x_m, the gap is that at x; h/2 drift
takes the rows to the end of the step, which makes steps without a touch second-order. Candidates are the contacts
within reach of the step, whatever their gap would be without contact forces: one contact may push the object onto
another. A contact that lands faster than twice the speed that gravity gives in a step rebounds with e times its speed
at the step's start, so that no energy is made of the time between touch and end: lambda_n u_n <= 0 and lambda_t u_t
<= 0 in every step. The order of the run is one across a touch.

Reference: J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988; M. Jean, The non-smooth
contact dynamics method, 1999.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.sequential import rest_response
from holdfast.dynamics.contact.decided_modes import require_resolved
from holdfast.dynamics.contact.fixed_modes import ContactModes, Touch, on_contacts
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.dynamics.contact.solve_contacts import solve_contacts
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.dynamics.contact.touch import impulse_response
from holdfast.dynamics.contact.touching_chain import CLOSED
from holdfast.dynamics.projection import Change, displaced_by, largest_gaps, quickened
from holdfast.dynamics.result import ForwardResult
from holdfast.errors import ClosureError, SingularChainError, StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.world.touching import Touching
from holdfast.simulation.contact_stepper import ContactStepper
from holdfast.simulation.instant import Instant, evaluate
from holdfast.simulation.step import Gaps, back_on_constraint
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.scalar import Array
from holdfast.state import State

PASSES = 2  # the second has the mean velocity of the step, which makes forces that depend on it second-order
OPEN_BY = 1e-13  # m: a deeper penetration is pushed out


class Impulses(NamedTuple):
    """The contacts in one step.

    Attributes:
        force: (k, 3) impulses over the step's length, contact axes [N].
        mode: (k,) numbers of `ContactMode`.
        landed: whether a contact touches that was open before.
        change: change of all velocities by impulses without rebounds.
        rebound: that by rebounds beside it.
        wrench: (6,) impulse of all contacts on the object about C in the step's middle, rebounds included.
    """

    force: Array
    mode: Array
    landed: bool
    change: Change
    rebound: Change
    wrench: Array


@dataclass(frozen=True, eq=False)
class ImpulseStepper(ContactStepper):
    """Takes midpoint steps with impulses of contacts; see `Stepper`. The modes are those at the stretch's start."""

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        found = []
        for end in ends:
            try:
                found.append(self._stepped(now, end))
            except (SingularChainError, ClosureError, StateError) as cause:
                found.append(Advance(end, None, NO_GAPS, np.zeros(4), failure=cause))
        return found

    def again(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a step's end from which a run is resumed; its impulses are those of the step before."""
        contacts = partial(_as_found, force=np.zeros((len(self.modes.mode), 3)), mode=self.modes.mode)
        of = self.environment, self.controller, t, state, memory
        return evaluate(*of, generic_rank=self.generic_rank, contacts=contacts)

    def _stepped(self, now: Instant, end: float) -> Advance:
        """Return the chain one step later."""
        h, held, t = end - now.t, now.result.held, now.t + 0.5 * (end - now.t)
        middle = self._on_grasps(t, displaced_by(now.state, _scaled(0.5 * h, _velocity(now.state))), held)[0]
        gap = contact_rows(_touching(now.chain), now.state.object_frame, now.state.object_twist).gap
        ends = at = found = None
        for _ in range(PASSES):
            moving = middle if ends is None else _between(middle, ends)
            of = self.environment, self.controller, t, moving, now.memory
            at = evaluate(*of, generic_rank=self.generic_rank, held=held)
            acceleration = Change(at.result.qdd, at.result.object_acceleration, at.result.base_acceleration)
            free = quickened(middle, _scaled(h, acceleration))
            turning = free.object_twist if ends is None else ends.object_twist
            found = impulses(at.chain, gap, middle, free, turning, h, held)
            ends = quickened(free, found.change)
        assert ends is not None and at is not None and found is not None
        if found.landed:
            later = displaced_by(now.state, _scaled(h, _velocity(ends)))
        else:
            halfway = displaced_by(now.state, _scaled(0.5 * h, _velocity(now.state)))
            later = displaced_by(halfway, _scaled(0.5 * h, _velocity(ends)))
        moving = quickened(ends, found.rebound)
        work = 0.5 * float(found.wrench @ (middle.object_twist + moving.object_twist))
        later = replace(later, qd=moving.qd, object_twist=moving.object_twist, base_twist=moving.base_twist)
        later, gaps = self._on_grasps(end, later, held)
        closed = ContactModes(np.where(found.force[:, 2] > 0.0, ContactMode.CLOSED, ContactMode.OPEN), np.zeros((0, 3)))
        later_chain = self.environment.chain_at(end)
        later = pushed_out(later_chain, on_contacts(later_chain, later, closed, held, velocities=False), held)
        if at.chain.grasps:
            later, _ = self._on_grasps(end, later, held)  # what was pushed far, as by a landing, has opened them
            later = pushed_out(later_chain, on_contacts(later_chain, later, closed, held, velocities=False), held)
            after = largest_gaps(at.chain, later, at.inputs.shaped(at.chain))
            both = (gaps.position[0], after.position), (gaps.velocity[0], after.velocity)
            gaps = Gaps(*(np.array(pair) for pair in both))
        contacts = partial(_as_found, force=found.force, mode=found.mode)
        of = self.environment, self.controller, end, later, now.memory
        instant = evaluate(*of, generic_rank=self.generic_rank, contacts=contacts)
        of_forces = h * at.power + np.array([0.0, 0.0, 0.0, work])
        return Advance(end, instant, gaps, of_forces)

    def _on_grasps(self, t: float, state: State, held: Array | None) -> tuple[State, Gaps]:
        if not self.environment.chain.grasps:
            return state, NO_GAPS
        return back_on_constraint(self.environment, t, state, held)


def impulses(
    chain: ClosedChain, gap: Array, middle: State, free: State, turning: Array, h: float, held: Array | None
) -> Impulses:
    """Return the impulses of the contacts within reach of a step. O(n) + O(l) + O(k).

    Args:
        chain: the chain, with its bases and shapes of the world in the middle of the step.
        gap: (k,) gaps at the step's start [m].
        middle: that in its middle, with velocities of the start.
        free: the same with the velocities at the end without contacts.
        turning: (6,) the object's twist with which the rows turn from the middle to the end.
        h: the step's length [s].
        held: rows of the grasps to impose.

    Raises:
        StateError: no impulses satisfy the laws of contact.
    """
    gap = np.maximum(gap, 0.0)
    rows = contact_rows(_touching(chain), middle.object_frame, turning)
    u0, u1 = rows.velocity(middle.object_twist), rows.velocity(free.object_twist) + 0.5 * h * rows.drift
    own = 2.0 * h * float(np.linalg.norm(chain.gravity))
    reach = np.linalg.norm(u0, axis=1) + np.linalg.norm(u1, axis=1) + own
    k, near = len(gap), np.flatnonzero(gap <= CLOSED + h * reach)
    impulse, mode = np.zeros((k, 3)), np.zeros(k, int)
    none = Change(0.0 * free.qd, np.zeros(6), None if free.base_twist is None else np.zeros(6))
    if not len(near):
        return Impulses(impulse, mode, False, none, none, np.zeros(6))
    motion = holding(chain_at_rest(chain, middle), held)
    b = u1[near].copy()
    b[:, 2] += gap[near] / h
    found = solve_contacts(rest_response(motion).mobility, rows.C[near], b, rows.friction[near])
    require_resolved(found, "impulses")
    impulse[near], mode[near] = found.force, found.mode
    change = impulse_response(motion, middle, found.wrench)[0]
    lands = (u0[:, 2] < -own) & (impulse[:, 2] > 0.0)
    more = np.zeros(k)
    rebounds = lands & (rows.restitution > 0.0)
    if rebounds.any():
        target = -gap / h
        grown = (-rows.restitution * u0[:, 2] - target) / np.where(rebounds, target - u1[:, 2], 1.0)
        more = np.where(rebounds, np.maximum(grown, 0.0), 0.0)
    extra = more[:, None] * impulse
    rebound = impulse_response(motion, middle, rows.wrench(extra))[0] if more.any() else none
    whole = impulse + extra
    landed = bool((lands & (gap > CLOSED)).any())
    return Impulses(whole / h, mode, landed, change, rebound, rows.wrench(whole))


def pushed_out(chain: ClosedChain, state: State, held: Array | None) -> State:
    """Return the state moved by the least displacement (kinetic metric) that ends penetrations."""
    for _ in range(2):
        rows = contact_rows(_touching(chain), state.object_frame, np.zeros(6))
        if rows.gap.min() >= -OPEN_BY:
            break
        near = np.flatnonzero(rows.gap < 1e-6)
        motion = holding(chain_at_rest(chain, state), held, positions=True)
        b = np.zeros((len(near), 3))
        b[:, 2] = rows.gap[near]
        found = solve_contacts(rest_response(motion).mobility, rows.C[near], b, np.zeros(len(near)))
        state = displaced_by(state, impulse_response(motion, state, found.wrench)[0])
    return state


def _touching(chain: ClosedChain) -> Touching:
    assert chain.touching is not None
    return chain.touching


def _as_found(chain: ClosedChain, state: State, free: ForwardResult, force: Array, mode: Array) -> Touch:
    """Return the contacts with known forces."""
    del free
    rows = contact_rows(_touching(chain), state.object_frame, state.object_twist)
    u, k = rows.velocity(state.object_twist), len(mode)
    return Touch(rows, force, u, ContactModes(mode, np.zeros((k, 3))), np.full(k, np.inf))


def _between(state: State, end: State) -> State:
    """Return a state with the mean of its velocities and those of another."""
    mean = _scaled(0.5, Change(end.qd - state.qd, end.object_twist - state.object_twist, None))
    found = quickened(state, mean)
    if state.base_twist is None or end.base_twist is None:
        return found
    return replace(found, base_twist=0.5 * (state.base_twist + end.base_twist))


def _velocity(state: State) -> Change:
    return Change(state.qd, state.object_twist, state.base_twist)


def _scaled(by: float, change: Change) -> Change:
    return Change(by * change.qd, by * change.object, None if change.base is None else by * change.base)
