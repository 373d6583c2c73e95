"""What contacts do next, at an instant at which modes may change: impact first, then Coulomb's law for accelerations.

1. Contacts whose gap is closed and which approach collide (`impact`). Below `REST_SPEED` there is no restitution.
2. Those that neither approach nor leave stay. If their tangential velocity is zero they are at rest, else they slide.
3. At rest and sliding together, forces and accelerations satisfy Signorini's and Coulomb's laws (`solve_contacts`),
   with the direction of friction given where a contact slides. Their modes hold until the next event.
4. If there are no such forces (Painleve), an impulse without a collision stops the slip: the contacts jam.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_at_rest
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.sequential import rest_response
from holdfast.dynamics.contact.collision import Collision, impact
from holdfast.dynamics.contact.fixed_modes import ContactModes, on_contacts
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.dynamics.contact.solve_contacts import solve_contacts
from holdfast.dynamics.contact.solved_contacts import ContactMode, ContactSolution, ContactStatus
from holdfast.dynamics.contact.touch import impulse_response
from holdfast.dynamics.contact.touching_chain import CLOSED
from holdfast.dynamics.projection import quickened
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.state import State

APPROACH_SPEED = 1e-9  # m/s: a slower approach is rounding
STOPPED_SPEED = 1e-6  # m/s: a slower slip has stopped
REST_SPEED = 1e-3  # m/s: contacts that approach more slowly do not rebound
JAMS = 3  # impulses without collision at one instant, at most


VANISHED = 1e-6  # of the largest force: a smaller one is zero where it has just been located as such


class Reached(NamedTuple):
    """What has just been located as the zero of a signal.

    Attributes:
        touched: contacts that close.
        lifted: contacts whose normal force vanishes.
        slipping: by contact, the direction (3,) in world axes in which it begins to slip.
    """

    touched: list[int]
    lifted: list[int]
    slipping: Mapping[int, Array]


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
    """

    state: State
    modes: ContactModes
    impulse: Array
    outer_impulse: Array
    energy_change: float
    jammed: bool
    rebounding: Array
    status: ContactStatus


def decided(
    chain: ClosedChain, state: State, accelerate: Any, held: Array | None = None, reached: Reached | None = None
) -> Decision:
    """Return velocities and modes just after an instant. O(n) + O(l) + O(k) but for the solver's rounds.

    Args:
        chain: the chain, with `touching`.
        state: the state just before; it satisfies the grasps.
        accelerate: returns the object's acceleration (6,) without contact forces at a state.
        held: rows of the grasps to impose, see `held_rows`.
        reached: what has just been located: contacts that are closed whatever their gap, whose normal force is zero,
            or which begin to slip.

    Raises:
        StateError: no impulses or forces satisfy the laws of contact.
    """
    assert chain.touching is not None
    rows = contact_rows(chain.touching, state.object_frame, state.object_twist)
    k = len(rows.gap)
    near = rows.gap <= CLOSED
    reached = Reached([], [], {}) if reached is None else reached
    near[reached.touched] = True
    closed = np.flatnonzero(near)
    base = np.zeros(6)
    total, slow, change, jammed, jams = np.zeros((k, 3)), np.zeros(k), 0.0, False, False
    mode, slip, solution = np.zeros(k, int), np.zeros((k, 3)), None
    for _ in range(1 + JAMS):
        rows = contact_rows(chain.touching, state.object_frame, state.object_twist)
        motion = holding(chain_at_rest(chain, state), held)
        P, u = rest_response(motion).mobility, rows.velocity(state.object_twist)
        if len(closed) and (u[closed, 2].min() < -APPROACH_SPEED or jammed):
            rebounds = u[:, 2] < -REST_SPEED
            e = np.where(rebounds[closed], rows.restitution[closed], 0.0)
            before = u[closed]
            if jammed:  # the least approach: it is answered by an impulse that does not vanish with it
                jams = True
                before = before - [0.0, 0.0, APPROACH_SPEED * max(1.0, float(np.abs(u).max()))]
            found = impact(P, rows.C[closed], before, rows.friction[closed], e)
            require_resolved(found, "impulses")
            left_out = (found.impulse[:, 2] > 0.0) & ~rebounds[closed] & (rows.restitution[closed] > 0.0)
            slow[closed] = np.where(left_out, -before[:, 2], slow[closed])
            total[closed] += np.einsum("kia,ki->ka", rows.axes[closed], found.impulse)
            change += found.energy_change + float((found.impulse * rows.carried[closed]).sum())
            jump, solution = impulse_response(motion, state, found.wrench)
            base += _base_impulse(motion, solution)
            state = quickened(state, jump)
            u = rows.velocity(state.object_twist)
        stays = closed[np.abs(u[closed, 2]) < 10.0 * APPROACH_SPEED]
        state, mode, slip, solution = _accelerated(chain, state, accelerate, held, stays, P, reached)
        jammed = solution.status in (ContactStatus.JAMMED, ContactStatus.UNRESOLVED)
        if not jammed:
            break
    assert solution is not None
    require_resolved(solution, "forces")
    still = rows.restitution < 1.0
    pull = -(rows.C @ accelerate(state) + rows.drift)[:, 2] if slow.any() else np.ones(k)
    e = np.where(still, rows.restitution, 0.0)
    rebounding = np.where((slow > 0.0) & (pull > 0.0), 2.0 * slow * e / (np.maximum(pull, 1e-300) * (1.0 - e)), 0.0)
    for l, p in zip(rows.point, total, strict=True):
        base += np.concatenate([np.cross(state.object_frame.p + l, p), p])
    return Decision(state, ContactModes(mode, slip), total, base, change, jams, rebounding, solution.status)


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
    chain: ClosedChain, state: State, accelerate: Any, held: Array | None, stays: Array, P: Array, reached: Reached
) -> tuple[State, Array, Array, ContactSolution]:
    """Return the state with velocities on the contacts that stay, their modes and slips, and the forces."""
    assert chain.touching is not None
    rows = contact_rows(chain.touching, state.object_frame, state.object_twist)
    k, u = len(rows.gap), rows.velocity(state.object_twist)
    mode, slip = np.zeros(k, int), np.zeros((k, 3))
    sizes = np.hypot(u[:, 0], u[:, 1])
    for j in stays:
        slides = sizes[j] > STOPPED_SPEED or rows.friction[j] == 0.0
        mode[j] = ContactMode.SLIPS if slides else ContactMode.STICKS
    state = on_contacts(chain, state, ContactModes(mode, slip), held)
    rows = contact_rows(chain.touching, state.object_frame, state.object_twist)
    u = rows.velocity(state.object_twist)
    direction = np.where((sizes > STOPPED_SPEED)[:, None], u[:, :2] / np.maximum(sizes, STOPPED_SPEED)[:, None], 0.0)
    direction /= np.maximum(np.hypot(*direction.T), 1e-300)[:, None]
    direction[sizes <= STOPPED_SPEED] = 0.0
    direction[rows.friction == 0.0] = 0.0
    b = rows.C @ accelerate(state) + rows.drift
    found = solve_contacts(P, rows.C[stays], b[stays], rows.friction[stays], slide=direction[stays])
    mode[:] = ContactMode.OPEN
    largest = float(np.abs(found.force).max(initial=0.0))
    for j, m, a, f in zip(stays.tolist(), found.mode, found.velocity, found.force, strict=True):
        mode[j] = ContactMode.OPEN if j in reached.lifted and f[2] <= VANISHED * largest else m
        if m == ContactMode.STICKS and j in reached.slipping:
            mode[j], slip[j] = ContactMode.SLIPS, reached.slipping[j]
            continue
        if mode[j] == ContactMode.OPEN:
            continue
        if direction[j].any():
            mode[j] = ContactMode.SLIPS
        if rows.friction[j] == 0.0:
            mode[j] = ContactMode.CLOSED
        if mode[j] == ContactMode.SLIPS:
            t = direction[j] if direction[j].any() else a[:2] / max(float(np.hypot(*a[:2])), 1e-300)
            slip[j] = t @ rows.axes[j, :2]
    return state, mode, slip, found


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
