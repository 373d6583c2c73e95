"""A step with impulses of contacts: the midpoint rule, in which every gap stays open or closed at the step's end.

    x_m = x + h/2 v, on the grasps;   v_1 = v + h a(x_m, v_m)                                 without contacts
    0 <= u_n + h/2 drift_n + gap / h  _|_  lambda_n >= 0,   Coulomb's law with u_t + h/2 drift_t       (at x_m)
    x+ = x + h/2 (v + v+),   at a touch x + h v+;   then grasps and closed gaps are closed

v_m = (v + v+) / 2 is that of a first pass with v_m = v. The rows are those at x_m, the gap is that at x; h/2 drift
takes the rows to the end of the step, which makes steps without a touch second-order. Candidates are the contacts
within reach of the step, whatever their gap would be without contact forces: one contact may push the object onto
another. A contact that lands faster than twice the speed that gravity gives in a step rebounds with e times the speed
that it has where the gap closes, u^2 = u_n^2 + 2 a gap, or less: a step with a rebound ends with at most the energy of
its start and of the work of drives and the moving world. The order of the run is one across a touch.

One text: `impulse_stepper` runs it on floats, `rollout.traced_impulses` traces it to machine code.

Reference: J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988; M. Jean, The non-smooth
contact dynamics method, 1999.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest, chain_motion
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.contact.contact_forces import FoundForces
from holdfast.dynamics.contact.rows import ContactRows, contact_rows
from holdfast.dynamics.contact.touching_chain import CLOSED, PushResponse, push_response
from holdfast.dynamics.energy import total_kinetic_energy, total_potential_energy
from holdfast.dynamics.projection import (
    Change,
    Gap,
    constraint_impulses,
    displaced_by,
    largest_gaps,
    position_contact,
    position_mismatch,
    project_velocities,
    quickened,
)
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.world.touching import Touching
from holdfast.spatial.linalg import pseudo_solution
from holdfast.spatial.scalar import Array, Scalar, array, each, maximum, minimum, reciprocal, select, sqrt, where
from holdfast.spatial.vector import largest
from holdfast.state import Inputs, State

PASSES = 2  # the second has the mean velocity of the step, which makes forces that depend on it second-order
ROUNDS_AT_END = 5  # of Newton's method for the positions at the step's end
PARTS_OF_STEP = (2, 4, 16)  # of a step whose impulses are not found, or which leaves gaps
OPEN_BY = 1e-13  # m: a deeper penetration is pushed out
PUSH_SWEEPS = 3  # over the places of rims, to find those that push


class ImpulseProblem(NamedTuple):
    """The contacts of a step, of which those out of reach get no impulse.

    Attributes:
        mobility: (6, 6) P of the object in the chain, in the step's middle.
        rows: the contacts' rows there.
        free: (k, 3) velocities at the end without impulses; normal ones with gap / h.
        near: 1 for each contact within reach, else 0.
        start: (k, 3) impulses to begin with, world axes.
    """

    mobility: Array
    rows: ContactRows
    free: Array
    near: Sequence[Scalar]
    start: Array


class SteppedChain(Protocol):
    """What a step asks: the reference answers on floats and refuses what fails, a trace answers with its own text."""

    @property
    def held(self) -> Array | None:
        """The rows of the grasps that the step imposes, see `held_rows`."""
        ...

    def at(self, t: Scalar, state: State) -> tuple[ClosedChain, Inputs]:
        """Return the chain with bases and shapes of the world at their poses at a time [s], and its shaped inputs."""
        ...

    def on_grasps(self, t: Scalar, state: State) -> State:
        """Return a state projected onto the grasps, positions and velocities."""
        ...

    def accelerated(self, t: Scalar, state: State) -> tuple[Change, Array]:
        """Return the accelerations without contacts, and the power (4,) in the order of `balance.WORK_TERMS` [W]."""
        ...

    def resolve(self, problem: ImpulseProblem) -> FoundForces:
        """Return the impulses that satisfy the laws of Signorini and Coulomb."""
        ...


class Impulses(NamedTuple):
    """The contacts in one step.

    Attributes:
        rows: the contacts' rows in its middle.
        impulse: (k, 3) without rebounds, contact axes [N s].
        extra: (k, 3) what rebounds add to it.
        mode: (k,) numbers of `ContactMode`.
        residual: violation of the laws, relative to the velocities, or to 1 m/s if they are slower.
        landed: 1 if a contact touches that was open before, else 0.
        change: change of all velocities by the impulses.
        rebound: that by rebounds beside it.
    """

    rows: ContactRows
    impulse: Array
    extra: Array
    mode: Array
    residual: Scalar
    landed: Scalar
    change: Change
    rebound: Change


class ImpulseStep(NamedTuple):
    """The result of a step.

    Attributes:
        state: the state at its end, on grasps and closed contacts.
        drift: largest gaps of the grasps before projection.
        gaps: those after it.
        work: (4,) work done during the step, in the order of `balance.WORK_TERMS` [J].
        force: (k, 3) impulses over the step's length, contact axes [N].
        mode: (k,) numbers of `ContactMode`.
        residual: the largest violation of the laws of contact, as in `Impulses`.
        rows: the contacts at its end.
    """

    state: State
    drift: Gap
    gaps: Gap
    work: Array
    force: Array
    mode: Array
    residual: Scalar
    rows: ContactRows


def impulse_step(chain: SteppedChain, start: State, t: Scalar, h: Scalar, force: Array) -> ImpulseStep:
    """Return a step from a state on the grasps. O(n) + O(l) + O(k).

    Args:
        chain: the chain with its controls and surroundings.
        start: the state.
        t: the step's start [s].
        h: its length [s]. A step of length zero projects the state, without any contact.
        force: (k, 3) forces with which the search begins, world axes [N].
    """
    middle_t, end_t, v = t + 0.5 * h, t + h, _velocity(start)
    gap = contact_rows(_touching(chain.at(t, start)[0]), start.object_frame, start.object_twist).gap
    middle = chain.on_grasps(middle_t, displaced_by(start, _scaled(0.5 * h, v)))
    still = holding(chain_at_rest(chain.at(middle_t, middle)[0], middle), chain.held)
    response = push_response(still, middle)

    def passed(moving: State, turning: Array | None, begin: Array) -> tuple[State, Impulses, Array]:
        acceleration, power = chain.accelerated(middle_t, moving)
        free = quickened(middle, _scaled(h, acceleration))
        turning = free.object_twist if turning is None else turning
        found = impulses(chain, response, gap, middle, free, turning, h, begin)
        return quickened(free, found.change), found, power

    ends, found, power = passed(middle, None, h * force)
    worst = found.residual
    for _ in range(PASSES - 1):
        ends, found, power = passed(_between(middle, ends), ends.object_twist, found.rows.in_world(found.impulse))
        worst = maximum(worst, found.residual)
    first = _of_each(lambda a, b: select(found.landed > 0.0, a, b), _velocity(ends), v)
    later = displaced_by(displaced_by(start, _scaled(0.5 * h, first)), _scaled(0.5 * h, _velocity(ends)))
    later = State(later.q, ends.qd, later.object_pose, ends.object_twist, later.base_pose, ends.base_twist)
    end_chain, inputs = chain.at(end_t, later)
    pressed = [where(one[2] > 0.0, 1.0, 0.0) for one in found.impulse]
    end = _on_grasps_and_contacts(end_chain, later, chain.held, pressed)
    gained = _energy(end_chain, inputs, end) - _energy(*chain.at(t, start), start) - h * power.sum()
    part = _without_gain(found, gained, ends.object_twist)
    impulse, rebound = found.impulse + part * found.extra, _scaled(part, found.rebound)
    later, end = quickened(later, rebound), quickened(end, rebound)
    work = 0.5 * (found.rows.wrench(impulse) @ (middle.object_twist + end.object_twist))
    if end_chain.grasps:
        motion = chain_motion(end_chain, end, np.zeros(end_chain.joint_count), inputs)
        end = project_velocities(holding(motion, chain.held), end)
    drift, gaps = (largest_gaps(end_chain, one, inputs) for one in (later, end))
    rows = contact_rows(_touching(end_chain), end.object_frame, end.object_twist)
    over = where(h > 0.0, reciprocal(where(h > 0.0, h, 1.0)), 0.0)
    of_contacts = array([0.0, 0.0, 0.0, work])
    return ImpulseStep(end, drift, gaps, h * power + of_contacts, over * impulse, found.mode, worst, rows)


def impulses(
    chain: SteppedChain,
    response: PushResponse,
    gap: Array,
    middle: State,
    free: State,
    turning: Array,
    h: Scalar,
    start: Array,
) -> Impulses:
    """Return the impulses of the contacts within reach of a step. O(n) + O(l) + O(k).

    Args:
        chain: the chain.
        response: its response to impulses in the middle of the step.
        gap: (k,) gaps at the step's start [m].
        middle: the state in its middle, with velocities of the start.
        free: the same with the velocities at the end without contacts.
        turning: (6,) the object's twist with which the rows turn from the middle to the end.
        h: the step's length [s].
        start: (k, 3) impulses with which the search begins, world axes [N s].
    """
    gap, of = maximum(gap, 0.0), response.motion.chain
    rows = contact_rows(_touching(of), middle.object_frame, turning, 0.5 * h)
    u0, u1 = rows.velocity(middle.object_twist), rows.velocity(free.object_twist) + (0.5 * h) * rows.drift
    own = 2.0 * h * _length(of.gravity)
    over = where(h > 0.0, reciprocal(where(h > 0.0, h, 1.0)), 0.0)

    def within_reach(gap: Scalar, before: Array, after: Array) -> Scalar:
        reach = _length(before) + _length(after) + own
        return where(h > 0.0, where(gap <= CLOSED + h * reach, 1.0, 0.0), 0.0)

    near = each(within_reach, gap, u0, u1)
    b = array([[*u[:2], u[2] + over * g] for u, g in zip(u1, gap, strict=True)])
    problem = ImpulseProblem(response.mobility, rows, b, near, start)
    found = chain.resolve(problem)
    size = largest([one * x for one, row in zip(near, b, strict=True) for x in row])

    def rebounding(g: Scalar, before: Array, after: Array, e: Scalar, pushed: Array, C: Array) -> tuple[Array, Scalar]:
        lands = where(before[2] < -own, where(pushed[2] > 0.0, 1.0, 0.0), 0.0)
        target = -over * g  # the speed at which the gap closes in the step
        falls = before[2] * before[2] + 2.0 * over * g * (before[2] - after[2])
        faster = maximum(e * sqrt(maximum(falls, 0.0)) - target, 0.0)  # than where it strikes, by the free acceleration
        alone = C[2] @ problem.mobility @ C[2]
        gain = maximum(target - after[2], alone * pushed[2])  # what the impulse changes, with others or alone
        more = where(e > 0.0, lands, 0.0) * faster * reciprocal(where(gain > 0.0, gain, 1.0))
        return more * pushed, where(g > CLOSED, lands, 0.0)

    parts = each(rebounding, gap, u0, u1, rows.restitution, found.force, rows.C)
    extra, landed = array([more for more, _ in parts]), largest([one for _, one in parts])
    change, rebound = response.change(found.wrench), response.change(rows.wrench(extra))
    residual = found.residual * minimum(size, 1.0)
    return Impulses(rows, found.force, extra, found.mode, residual, landed, change, rebound)


def _without_gain(found: Impulses, gained: Scalar, twist: Array) -> Scalar:
    """Return the largest part g <= 1 of the rebounds with which the step makes no energy; see `collision`.

    With the rebounds' impulses D, from the velocities u, the energy is `gained` + g D . u + 1/2 g^2 |D|^2.

    Args:
        found: the impulses.
        gained: energy made without rebounds [J].
        twist: (6,) the object's twist without them.
    """
    square = found.rows.wrench(found.extra) @ found.rebound.object
    along = (found.extra * found.rows.velocity(twist)).sum()
    of_world = (found.impulse * found.rows.carried).sum()
    allowed = maximum(of_world - gained, 0.0)
    part = (sqrt(along * along + 2.0 * square * allowed) - along) * reciprocal(where(square > 0.0, square, 1.0))
    return where(square > 0.0, minimum(part, 1.0), 1.0)


def _energy(chain: ClosedChain, inputs: Inputs, state: State) -> Scalar:
    return total_kinetic_energy(chain, state, inputs) + total_potential_energy(chain, state)


def _on_grasps_and_contacts(chain: ClosedChain, state: State, held: Array | None, pressed: Sequence[Scalar]) -> State:
    """Return positions on grasps and contacts, by the least displacement in the kinetic metric of the whole chain.

    Every round of Newton's method closes the grasps, then the gaps of contacts that press or penetrate, by pushes on
    the object that the grasps share. A contact stays closed in the later rounds: pushed out one at a time, two corners
    push each other in.

    Args:
        chain: the chain at that time.
        state: the state.
        held: rows of the grasps to impose, see `held_rows`.
        pressed: 1 for each contact that presses, else 0.
    """
    for _ in range(ROUNDS_AT_END):
        motion = holding(chain_at_rest(chain, state), held, positions=True)
        change, pressed = _closing(motion, state, pressed)
        state = displaced_by(state, change)
    return state


def _closing(motion: ChainMotion, state: State, pressed: Sequence[Scalar]) -> tuple[Change, Sequence[Scalar]]:
    """Return the displacement of one round, and 1 for each contact that it closes, else 0.

    A place that wanders is pushed out, but never drawn in: one that bends little runs far around a rim to close a small
    gap, and where rim and edge of a hole meet, both describe one contact, so that one would draw against the other.
    """
    of = _touching(motion.chain)
    rows, rims = contact_rows(of, state.object_frame, np.zeros(6)), [one.feature.wanders for one in of.candidates]
    closed, gap = None, rows.gap
    if motion.chain.grasps:
        contacts = each(position_contact, motion.contacts)
        closed, _ = constraint_impulses(motion, contacts, position_mismatch(motion, state))
        gap = gap + rows.C[:, 2] @ closed.object
    response = push_response(motion, state)
    P = response.mobility
    kept = [0.0 if rim else one for rim, one in zip(rims, pressed, strict=True)]
    shut = array([where(g < -OPEN_BY, 1.0, one) for g, one in zip(gap, kept, strict=True)])

    def pushed_out(shut: Array) -> tuple[Array, Array]:
        A = (shut * rows.C[:, 2].T).T
        return A, pseudo_solution(A @ P @ A.T, -shut * gap)

    A, push = pushed_out(shut)
    for _ in range(PUSH_SWEEPS if any(rims) else 0):
        later = gap + rows.C[:, 2] @ (P @ (A.T @ push))
        of_rims = [
            where(where(one > 0.0, x, -OPEN_BY - g) > 0.0, 1.0, 0.0)
            for one, x, g in zip(shut, push, later, strict=True)
        ]
        shut = array([new if rim else one for rim, new, one in zip(rims, of_rims, shut, strict=True)])
        A, push = pushed_out(shut)
    change = response.change(A.T @ push)
    return change if closed is None else _of_each(lambda a, b: a + b, closed, change), list(shut)


def _touching(chain: ClosedChain) -> Touching:
    assert chain.touching is not None
    return chain.touching


def _length(x: Array) -> Scalar:
    return sqrt(x @ x)


def _velocity(state: State) -> Change:
    return Change(state.qd, state.object_twist, state.base_twist)


def _scaled(by: Scalar, change: Change) -> Change:
    return Change(by * change.qd, by * change.object, None if change.base is None else by * change.base)


def _of_each(f: Callable[[Array, Array], Array], a: Change, b: Change) -> Change:
    """Return a function of the parts of two changes."""
    return Change(f(a.qd, b.qd), f(a.object, b.object), None if a.base is None or b.base is None else f(a.base, b.base))


def _between(state: State, end: State) -> State:
    """Return a state with the mean of its velocities and those of another."""
    return quickened(state, _scaled(0.5, _of_each(lambda a, b: b - a, _velocity(state), _velocity(end))))
