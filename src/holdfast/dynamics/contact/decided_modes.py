"""What contacts do next, at an instant at which modes may change: impact first, then Coulomb's law for accelerations.

1. Contacts whose gap is closed and which approach collide (`impact`). Below `REST_SPEED` there is no restitution, and
   contacts that such an impact makes leave as slowly are stopped if forces press them then: a box that rocks between
   two of its edges strikes ever sooner, without end.
2. Those that neither approach nor leave stay. If their tangential velocity is zero they are at rest, else they slide.
3. At rest and sliding together, forces and accelerations satisfy Signorini's and Coulomb's laws (`solve_contacts`),
   with the direction of friction given where a contact slides. Their modes hold until the next event. A contact whose
   force has just vanished carries none, if that satisfies the laws: redundant ones could share the load otherwise.
4. If there are no such forces (Painleve), an impulse without a collision stops the slip: the contacts jam.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_at_rest
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.contact.collision import Collision, impact
from holdfast.dynamics.contact.fixed_modes import (
    DEPENDENT_CONTACT_ROWS,
    STOPPED_SPEED,
    ContactModes,
    RestResponses,
    on_contacts,
    slip_in_world,
    tangents,
)
from holdfast.dynamics.contact.rows import ContactRows, rows_in_world
from holdfast.dynamics.contact.sliding_hands import (
    Hand,
    point_owners,
    stacked_response,
    stacked_twist,
)
from holdfast.dynamics.contact.solve_contacts import solve_contacts
from holdfast.dynamics.contact.solved_contacts import ContactMode, ContactSolution, ContactStatus
from holdfast.dynamics.contact.touching_chain import CLOSED
from holdfast.dynamics.projection import quickened
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.state import State

APPROACH_SPEED = 1e-9  # m/s: a slower approach is rounding
REST_SPEED = 1e-3  # m/s: contacts that approach more slowly do not rebound
STOP_TOGETHER = 1e-5  # m/s: where one slip has stopped, slower ones have, too: friction would stop them in microseconds
JAMS = 3  # impulses without collision at one instant, at most


REMAINS = 1e-9  # of the accelerations without contact forces: a slower approach is rounding
VANISHED = 1e-6  # of the largest force: a smaller one is zero where it has just been located as such


class Reached(NamedTuple):
    """What has just been located as the zero of a signal.

    Attributes:
        touched: contacts that close.
        lifted: contacts whose normal force vanishes.
        slipping: by contact, the direction (3,) in world axes in which it begins to slip; (4,) as in `ContactModes`.
        spent: arms whose grasps have no margin left; some of their points lift or slip.
    """

    touched: list[int]
    lifted: list[int]
    slipping: Mapping[int, Array]
    spent: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class Decision(Frozen):
    """The motion just after an instant at which modes may change.

    Attributes:
        state: with the velocities after impacts.
        modes: the modes from here on.
        impulse: (k, 3) of the world on the object, world axes [N s].
        outer_impulse: (6,) impulse of the world, at contacts and bases, about the world's origin [N m s, N s].
        energy_change: change of the kinetic energy by impulses [J].
        jammed: whether an impulse without a collision acted.
        rebounding: (k,) how much longer ever smaller rebounds would go on that are left out, because they are slow: the
            sum of 2 v e^i / a, i = 1, 2 ..., for an approach by v and an acceleration -a; 0 without them [s].
        status: of the forces from here on.
        rocked: contacts that would have rocked to and fro, too slowly to follow.
    """

    state: State
    modes: ContactModes
    impulse: Array
    outer_impulse: Array
    energy_change: float
    jammed: bool
    rebounding: Array
    status: ContactStatus
    rocked: tuple[int, ...] = ()


def decided(
    chain: ClosedChain,
    state: State,
    accelerate: Callable[[State], Array],
    held: Array | None = None,
    reached: Reached | None = None,
    hands: tuple[Hand, ...] = (),
    responses: RestResponses | None = None,
) -> Decision:
    """Return velocities and modes just after an instant. O(n) + O(l) + O(k) but for the solver's rounds.

    Args:
        chain: the chain, without the grasps of `hands`.
        state: the state just before; it satisfies the grasps.
        accelerate: returns the acceleration of object and tips without contact forces at a state, (6 + 6 hands,).
        held: rows of the grasps to impose, see `held_rows`.
        reached: what has just been located: contacts that are closed whatever their gap, whose normal force is zero,
            or which begin to slip.
        hands: hands that slide or may begin to; their points follow the contacts with the world.
        responses: the chain's responses at rest; by default those of the reference.

    Raises:
        StateError: no impulses or forces satisfy the laws of contact.
    """
    at_rest = responses or RestResponses(chain, held, hands)
    rows = at_rest.rows(state)
    k, d = rows.C.shape[:2]
    near = rows.gap <= CLOSED
    reached = Reached([], [], {}) if reached is None else reached
    near[reached.touched] = True
    meets = ContactModes(np.where(near, ContactMode.STICKS, ContactMode.OPEN), np.zeros((k, d)), hands)
    # or rebounds would sum up errors of location, and to close one of several later would push others in
    state = on_contacts(chain, state, meets, velocities=False, responses=at_rest)
    closed = np.flatnonzero(near)
    base = np.zeros(6)
    total, slow, change, jammed, jams = np.zeros((k, 3)), np.zeros(k), 0.0, False, False
    mode, slip, solution, begins, rocks = np.zeros(k, int), np.zeros((k, d)), None, frozenset[int](), closed[:0]
    for _ in range(1 + JAMS):
        rows, P = at_rest.rows(state), at_rest.mobility(state)
        u = rows.velocity(stacked_twist(chain, state, hands))
        strikes = bool(len(closed) and (u[closed, 2].min() < -APPROACH_SPEED or jammed))
        slowly = strikes and not jammed and u[closed, 2].min() > -REST_SPEED
        if strikes:
            rebounds = u[:, 2] < -REST_SPEED
            e = np.where(rebounds[closed], rows.restitution[closed], 0.0)
            before = u[closed]
            if jammed:  # the least approach: it is answered by an impulse that does not vanish with it
                jams = True
                before = before - np.eye(d)[2] * (APPROACH_SPEED * max(1.0, float(np.abs(u).max())))
            found = impact(P, rows.C[closed], before, rows.friction[closed], e)
            require_resolved(found, "impulses")
            left_out = (found.impulse[:, 2] > 0.0) & ~rebounds[closed] & (rows.restitution[closed] > 0.0)
            slow[closed] = np.where(left_out, -before[:, 2], slow[closed])
            change += found.energy_change + float((found.impulse * rows.carried[closed]).sum())
            motion = holding(chain_at_rest(chain, state), held)
            state, of_bases = _pushed(motion, state, hands, found.wrench)
            total[closed] += rows_in_world(rows.axes[closed], found.impulse)
            base, u = base + of_bases, rows.velocity(stacked_twist(chain, state, hands))
        stays = closed[np.abs(u[closed, 2]) < 10.0 * APPROACH_SPEED]
        rocks = np.setdiff1d(closed[u[closed, 2] < REST_SPEED], stays) if slowly else stays[:0]
        while True:  # what rocks to and fro between contacts too slowly to follow rests on all that press then
            rest, still, of_bases = np.union1d(stays, rocks), state, np.zeros(6)
            stopping = np.zeros((k, d))
            if len(rocks):
                A = rows.C[rest, 2]
                stopping[rest, 2] = np.linalg.lstsq(A @ P @ A.T, -u[rest, 2], rcond=DEPENDENT_CONTACT_ROWS)[0]
                motion = holding(chain_at_rest(chain, state), held)
                still, of_bases = _pushed(motion, state, hands, stopping[rest, 2] @ A)
            moving = _accelerated(at_rest, still, accelerate, rest, P, reached)
            lifts = rocks[moving[1][rocks] == ContactMode.OPEN]
            if not len(lifts):
                break
            rocks = np.setdiff1d(rocks, lifts)
        state, mode, slip, begins, solution = moving
        total, base = total + rows_in_world(rows.axes, stopping), base + of_bases
        change += float((stopping * (0.5 * u + rows.carried)).sum())
        jammed = solution.status in (ContactStatus.JAMMED, ContactStatus.UNRESOLVED)
        if not jammed:
            break
    assert solution is not None
    require_resolved(solution, "forces")
    still = rows.restitution < 1.0
    pull = np.ones(k)
    if slow.any():
        pull = -(rows.C @ accelerate(state) + rows.drift)[:, 2]
    e = np.where(still, rows.restitution, 0.0)
    rebounding = np.where((slow > 0.0) & (pull > 0.0), 2.0 * slow * e / (np.maximum(pull, 1e-300) * (1.0 - e)), 0.0)
    of_world = k - len(point_owners(hands))
    for l, p in zip(rows.point[:of_world], total, strict=False):
        base += np.concatenate([np.cross(state.object_frame.p + l, p), p])
    modes = ContactModes(mode, slip, hands, begins)
    return Decision(state, modes, total, base, change, jams, rebounding, solution.status, tuple(rocks.tolist()))


def _pushed(motion: ChainMotion, state: State, hands: tuple[Hand, ...], push: Array) -> tuple[State, Array]:
    """Return the state after impulses on object and tips, and the bases' impulse about the world's origin, (6,)."""
    response = stacked_response(motion, state, hands, push)
    base = _base_impulse(motion, response.found)
    for hand, one in zip(hands, response.bases, strict=True):
        base = base + shift_wrench(motion.chain.arms[hand.arm].base.p, one)
    return quickened(state, response.change), base


def _base_impulse(motion: ChainMotion, found: Solution) -> Array:
    """Return the impulse of all bases on the chain about the world's origin, (6,)."""
    chain, whole, total = motion.chain, chain_solution(motion, found, "auto"), np.zeros(6)
    for (name, arm), impulse in zip(chain.arms.items(), whole.base_wrench, strict=True):
        if name not in chain.mounted_on:
            total += shift_wrench(arm.base.p, impulse)
    if chain.trunk is not None and whole.trunk_base_wrench is not None and not chain.floats:
        total += shift_wrench(chain.trunk.base.p, whole.trunk_base_wrench)
    return total


def _accelerated(
    at_rest: RestResponses,
    state: State,
    accelerate: Callable[[State], Array],
    stays: Array,
    P: Array,
    reached: Reached,
) -> tuple[State, Array, Array, frozenset[int], ContactSolution]:
    """Return the state with velocities on the contacts that stay, modes, slips and which begin, and the forces."""
    chain, hands, rows = at_rest.chain, at_rest.hands, at_rest.rows(state)
    u = rows.velocity(stacked_twist(chain, state, hands))
    (k, d), along = u.shape, tangents(u)
    mode, slip = np.zeros(k, int), np.zeros((k, d))
    sizes = np.linalg.norm(u[:, along], axis=1)
    slowest = float(sizes[stays[rows.friction[stays] > 0.0]].min(initial=np.inf))
    stopped = STOPPED_SPEED if slowest > STOPPED_SPEED else STOP_TOGETHER
    for j in stays:
        slides = sizes[j] > stopped or rows.friction[j] == 0.0
        mode[j] = ContactMode.SLIPS if slides else ContactMode.STICKS
    state = on_contacts(chain, state, ContactModes(mode, slip, hands), responses=at_rest)
    rows = at_rest.rows(state)
    u = rows.velocity(stacked_twist(chain, state, hands))
    direction = np.where((sizes > stopped)[:, None], u[:, along] / np.maximum(sizes, stopped)[:, None], 0.0)
    direction /= np.maximum(np.linalg.norm(direction, axis=1), 1e-300)[:, None]
    direction[sizes <= stopped] = 0.0
    direction[rows.friction == 0.0] = 0.0
    b = rows.C @ accelerate(state) + rows.drift
    stays, found = _without_force(P, rows, b, direction, stays, reached.lifted)
    mode[:] = ContactMode.OPEN
    largest = float(np.abs(found.force).max(initial=0.0))
    of_world, owners = k - len(point_owners(hands)), point_owners(hands)
    spent = [of_world + i for i, one in enumerate(owners) if hands[one].arm in reached.spent]
    slipping = {**reached.slipping, **_beginning(rows, stays, of_world, found, spent, largest)}
    lifted = {*reached.lifted, *spent}
    for j, m, a, f in zip(stays.tolist(), found.mode, found.velocity, found.force, strict=True):
        mode[j] = ContactMode.OPEN if j in lifted and f[2] <= VANISHED * largest else m
        if mode[j] == ContactMode.STICKS and j in slipping:
            mode[j], slip[j] = ContactMode.SLIPS, np.resize(np.append(slipping[j], 0.0), d)
            continue
        if mode[j] == ContactMode.OPEN:
            continue
        if direction[j].any():
            mode[j] = ContactMode.SLIPS
        if rows.friction[j] == 0.0:
            mode[j] = ContactMode.CLOSED
        if mode[j] == ContactMode.SLIPS:
            t = direction[j] if direction[j].any() else a[along] / max(float(np.linalg.norm(a[along])), 1e-300)
            slip[j] = slip_in_world(rows.axes[j], t)
    slips = np.flatnonzero((mode == ContactMode.SLIPS) & (rows.friction > 0.0))
    return state, mode, slip, frozenset(j for j in slips.tolist() if not direction[j].any()), found


def _without_force(
    P: Array, rows: ContactRows, b: Array, direction: Array, stays: Array, lifted: Sequence[int]
) -> tuple[Array, ContactSolution]:
    """Return the contacts that may carry a load, and forces; what has just lost its force has none, if that holds.

    Redundant contacts have many shares. Another one, in which such a contact carries a load again, would not last.

    Args:
        P: mobility of object and tips.
        rows: the contacts.
        b: (k, 3 or 4) accelerations without contact forces.
        direction: (k, 2 or 3) in which contacts slide already; 0 for those at rest.
        stays: contacts that neither approach nor leave.
        lifted: those whose normal force has just vanished.
    """
    bears = np.setdiff1d(stays, lifted)
    for some in (bears, stays):
        found = solve_contacts(P, rows.C[some], b[some], rows.friction[some], slide=direction[some])
        left = np.setdiff1d(stays, some)
        a = b[left, 2] + rows.C[left, 2] @ found.change
        resolved = found.status not in (ContactStatus.JAMMED, ContactStatus.UNRESOLVED)
        if len(some) == len(stays) or (resolved and a.min() >= -REMAINS * np.abs(b[stays]).max(initial=0.0)):
            break
    return some, found


def _beginning(
    rows: ContactRows, stays: Array, of_world: int, found: ContactSolution, spent: list[int], largest: float
) -> dict[int, Array]:
    """Return the directions in which points of hands begin to slip that can no longer hold, though they seem to.

    These are the ones at their limits. If there is none, although no other forces would hold it, it is all that
    press: the hand then fails as a whole.
    """
    along = tangents(found.force)
    seem = [
        (j, f)
        for j, m, f in zip(stays.tolist(), found.mode, found.force, strict=True)
        if j in spent and f[2] > VANISHED * largest
    ]
    used = [np.linalg.norm(f[along]) >= (1.0 - VANISHED) * rows.friction[j] * f[2] for j, f in seem]
    changed = any(m != ContactMode.STICKS for j, m in zip(stays.tolist(), found.mode, strict=True) if j in spent)
    alone = set(stays.tolist()) <= {*range(of_world, len(rows.gap))}
    whole = (alone or found.status is ContactStatus.OK) and not (changed or any(used))
    used = [True] * len(seem) if whole else used
    return {
        j: slip_in_world(rows.axes[j], -f[along] / max(float(np.linalg.norm(f[along])), 1e-300))
        for (j, f), limit in zip(seem, used, strict=True)
        if limit
    }


def require_resolved(found: Collision | ContactSolution, what: str) -> None:
    """Refuse impulses or forces that do not satisfy the laws of contact.

    Raises:
        StateError: with the residual.
    """
    if found.status in (ContactStatus.JAMMED, ContactStatus.UNRESOLVED):
        raise StateError(
            f"contacts: {found.status.value} ({what}, residual {found.residual:.1e}); try fewer contacts at once, or"
            " less friction"
        )
