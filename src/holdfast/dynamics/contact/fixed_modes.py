"""Contacts in fixed modes: sticking ones impose three rows, slipping and frictionless ones their normal row.

    A alpha + drift = 0,   w = D^T x,   (A P D^T) x = -(A alpha_0 + drift)

A are the imposed rows, and the rows of D say what a unit of each unknown exerts: the row itself, or for a slipping
contact n - mu t with the direction t of the slip. P is the object's mobility in the chain, alpha_0 its acceleration
without contact forces. Redundant contacts share the load by the least norm of x, as equal compliances do, but in
another way if that leaves the cones and the other one does not.

The direction of friction is continued smoothly through a stop: just past it, -mu lambda_n t still points against the
slip before. Only then can the time of the stop be located as the zero of a smooth function.

Friction turns a slip into its own direction in the time |u_t| / (mu lambda_n |C_t P C_t^T|), which is next to nothing
where slip begins. There the direction follows from the law: acceleration and friction are opposite, a_t = s t and
lambda_t = -mu lambda_n t with s >= 0. These t are found by Newton's method, for all contacts that begin at once.

Where slip stops, that time tends to zero, too. A slip that no longer turns keeps its direction within a step past its
stop: a deviation would grow there, as |u_t| to the power of mu lambda_n |C_t P C_t^T| / |a_t|.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.contact.load_share import within_cones
from holdfast.dynamics.contact.rows import ContactRows
from holdfast.dynamics.contact.sliding_hands import (
    Hand,
    stacked_acceleration,
    stacked_mobility,
    stacked_response,
    stacked_twist,
    touching_rows,
)
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.dynamics.projection import Change, displaced_by, quickened
from holdfast.dynamics.result import ForwardResult
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import State

STOPPED_SPEED = 1e-6  # m/s: a slower slip has stopped
SLOWEST_SLIP = 1e-7  # m/s: a slower slip has no direction of its own
BEGINS_FOR = 5e-4  # s: the time in which friction turns a slip from which its direction is its own
MOST_TURNS, SAME_SLIP = 30, 1e-13
TURNABLE = 1e-2  # of the mobility across a slip: the least that other contacts leave where friction turns it
STRAIGHT = 1e-10  # m/s: less across the direction that friction keeps is no turn, but rounding
STAYS_STRAIGHT = 1e-8  # m/s: the same for a slip that has kept its direction already
STOPS_SOON = 8.0  # steps: a slip that stops within so many keeps its direction; `verify` looks at eighths
DEPENDENT_CONTACT_ROWS = 1e-11  # singular values below this part of the largest are those of dependent rows
SETTLED_GAP, ROUNDS = 1e-15, 3  # m


@dataclass(frozen=True, eq=False)
class ContactModes(Frozen):
    """What every contact does during a stretch of smooth motion.

    Attributes:
        mode: (k,) numbers of `ContactMode`.
        slip: (k, 3) unit vectors along the slip of slipping contacts, world axes; 0 for others. (k, 4) with soft
            fingers, whose fourth component is the spin times the torsion radius.
        hands: hands that slide, whose points follow the contacts with the world.
        begins: contacts whose slip has just begun, and takes its direction from the law.
        straight: slips that keep their direction, see `Touch.modes_within`.
    """

    mode: Array
    slip: Array
    hands: tuple[Hand, ...] = ()
    begins: frozenset[int] = frozenset()
    straight: frozenset[int] = frozenset()

    @property
    def closed(self) -> Array:
        """The indices of the contacts that are closed."""
        return np.flatnonzero(self.mode != ContactMode.OPEN)

    def imposed(self) -> tuple[Array, Array]:
        """Return contact (m,) and unit vector (m, 3 or 4) in contact axes of every imposed row."""
        axes, sticks = np.eye(self.slip.shape[1]), self.mode == ContactMode.STICKS
        rows = [(j, n) for j in self.closed.tolist() for n in (axes if sticks[j] else axes[2:3])]
        return np.array([j for j, _ in rows], dtype=int), np.array([n for _, n in rows]).reshape(-1, len(axes))


@dataclass(frozen=True, eq=False)
class Touch(Frozen):
    """The contacts at one instant, in fixed modes.

    Attributes:
        rows: gaps, rows and axes.
        force: (k, 3) forces of the world on the object, contact axes [N]; (k, 4) with soft fingers, moments divided by
            the torsion radius.
        velocity: (k, 3) u, contact axes [m/s]; (k, 4) likewise.
        modes: the modes, with the slip directions of this instant.
        slip_speed: (k,) velocity along the direction of slip at the step's start; infinite unless slipping [m/s].
        stops_in: (k,) time in which a slip stops that does not turn; infinite for others [s].
        turning_time: the shortest time in which a slip may turn into another direction, |u_t| over its acceleration,
            or over the one that friction gives if that is larger; infinite where no slip turns [s]. Of a slip that
            begins, twice the time until its direction is its own, if its speed grows with the square of time.
    """

    rows: ContactRows
    force: Array
    velocity: Array
    modes: ContactModes
    slip_speed: Array
    stops_in: Array
    turning_time: float = np.inf

    def modes_within(self, h: float) -> ContactModes:
        """Return the modes for a step of a length [s], in which slips that stop soon and do not turn are straight."""
        return replace(self.modes, straight=frozenset(np.flatnonzero(self.stops_in < STOPS_SOON * h).tolist()))


@dataclass(frozen=True, eq=False)
class RestResponses:
    """How a chain at rest gives way to pushes on its object and on the tips of sliding hands.

    Attributes:
        chain: the chain, without the grasps of hands that slide.
        held: rows of the grasps to impose, see `held_rows`.
        hands: hands that slide.
    """

    chain: ClosedChain
    held: Array | None = None
    hands: tuple[Hand, ...] = ()

    def rows(self, state: State) -> ContactRows:
        """Return the contacts' rows."""
        return touching_rows(self.chain, state, self.hands)

    def mobility(self, state: State, positions: bool = False) -> Array:
        """Return the mobility of object and tips; for `positions` with the rows of the grasps that those impose."""
        return stacked_mobility(self._motion(state, positions), self.hands)

    def change(self, state: State, push: Array, positions: bool = False) -> Change:
        """Return the change of the velocities by impulses on object and tips."""
        return stacked_response(self._motion(state, positions), state, self.hands, push).change

    def _motion(self, state: State, positions: bool) -> ChainMotion:
        return holding(chain_at_rest(self.chain, state), self.held, positions=positions)


class ImposedContacts(NamedTuple):
    """The forces that keep the imposed rows.

    Attributes:
        force: (k, 3 or 4) forces, contact axes.
        moving: acceleration of object and tips with them.
        A: imposed rows.
        D: what a unit of each unknown exerts.
    """

    force: Array
    moving: Array
    A: Array
    D: Array


def touch_at(chain: ClosedChain, state: State, free: ForwardResult, modes: ContactModes) -> Touch:
    """Return the forces of contacts in given modes. O(n) + O(l) + O(k).

    Args:
        chain: the chain, without the grasps of hands that slide.
        state: positions and velocities.
        free: forward dynamics without contact forces.
        modes: the modes, with slip directions at the step's start.
    """
    acceleration = stacked_acceleration(chain, state, modes.hands, free)
    return touch_with(RestResponses(chain, free.held, modes.hands), state, acceleration, modes)


def touch_with(at_rest: RestResponses, state: State, acceleration: Array, modes: ContactModes) -> Touch:
    """Return the forces of contacts in given modes from accelerations of object and tips without them."""
    rows = at_rest.rows(state)
    u = rows.velocity(stacked_twist(at_rest.chain, state, modes.hands))
    directions, slip, speed = _slip(rows, u, modes)
    force, turning, stops, begins = np.zeros(u.shape), np.inf, np.full(len(u), np.inf), modes.begins
    if len(modes.closed):
        P = at_rest.mobility(state)
        found = _along_law(rows, P, acceleration, modes, directions)
        if found is None:  # slips have their own directions
            return touch_with(at_rest, state, acceleration, replace(modes, begins=frozenset()))
        directions, (force, moving, *_) = found
        for j in begins:
            slip[j] = slip_in_world(rows.axes[j], directions[j])
        speed, stops, turning, begins = _turning(rows, P, moving, u, force, modes, speed)
    return Touch(rows, force, u, replace(modes, slip=slip, begins=begins, straight=frozenset()), speed, stops, turning)


def _along_law(
    rows: ContactRows, P: Array, acceleration: Array, modes: ContactModes, directions: Array
) -> tuple[Array, ImposedContacts] | None:
    """Return directions of slips, of those that begin by the law, and what `_imposing` returns; None if not found."""
    for _ in range(MOST_TURNS):
        found = _imposing(rows, P, acceleration, modes, directions)
        turned = _turned(rows, P, modes, directions, found) if modes.begins else directions
        if np.abs(turned - directions).max(initial=0.0) < SAME_SLIP:
            return directions, found
        directions = turned
    return None


def _turned(rows: ContactRows, P: Array, modes: ContactModes, directions: Array, found: ImposedContacts) -> Array:
    """Return the directions of slips after a step of Newton's method, in which those that begin turn by delta.

    With the rows E across them and the mobility Q = P - P D^T (A P D^T)^+ A P while the imposed rows are kept, friction
    changes by -mu lambda_n delta and the acceleration across by E Q E^T of that, so that it is along the slip again if
    (diag(a_along) + E Q E^T mu lambda_n) delta = a_across.

    Args:
        rows: the contacts.
        P: mobility of object and tips.
        modes: the modes.
        directions: (k, 2 or 3) of the slips, contact axes.
        found: forces and acceleration with these directions.
    """
    force, moving, A, D = found
    Q = P - P @ D.T @ np.linalg.lstsq(A @ P @ D.T, A @ P, rcond=DEPENDENT_CONTACT_ROWS)[0]
    along, begins, turned = tangents(force), sorted(modes.begins), directions.copy()
    across = [_across(directions[j]) for j in begins]
    a = [rows.C[j, along] @ moving + rows.drift[j, along] for j in begins]
    E = np.concatenate([B @ rows.C[j, along] for B, j in zip(across, begins, strict=True)])
    count = [len(B) for B in across]
    forwards = np.repeat([max(directions[j] @ one, 0.0) for j, one in zip(begins, a, strict=True)], count)
    given = np.repeat([rows.friction[j] * max(force[j, 2], 0.0) for j in begins], count)
    aside = np.concatenate([B @ one for B, one in zip(across, a, strict=True)])
    delta = np.linalg.lstsq(np.diag(forwards) + E @ Q @ E.T * given, aside, rcond=DEPENDENT_CONTACT_ROWS)[0]
    for j, B, part in zip(begins, across, np.split(delta, np.cumsum(count)[:-1]), strict=True):
        turned[j] = directions[j] + part @ B
        turned[j] /= np.linalg.norm(turned[j])
    return turned


def _across(direction: Array) -> Array:
    """Return an orthonormal basis of what is across a direction of slip, (1 or 2, 2 or 3)."""
    return np.linalg.svd(direction[None])[2][1:]


def _imposing(
    rows: ContactRows, P: Array, acceleration: Array, modes: ContactModes, directions: Array
) -> ImposedContacts:
    """Return the forces that keep the imposed rows, with the acceleration of object and tips."""
    of, units = modes.imposed()
    force, gives = np.zeros(modes.slip.shape), units.copy()
    slips = modes.mode[of] == ContactMode.SLIPS
    gives[np.ix_(slips, tangents(gives))] = -rows.friction[of[slips], None] * directions[of[slips]]
    A, D = (np.einsum("mia,mi->ma", rows.C[of], x) for x in (units, gives))
    b = A @ acceleration + (rows.drift[of] * units).sum(axis=1)
    x = np.linalg.lstsq(A @ P @ D.T, -b, rcond=DEPENDENT_CONTACT_ROWS)[0]
    x = within_cones(of, D, rows.friction, modes.mode == ContactMode.STICKS, x)
    np.add.at(force, of, x[:, None] * gives)
    return ImposedContacts(force, acceleration + P @ (x @ D), A, D)


def _turning(
    rows: ContactRows, P: Array, acceleration: Array, u: Array, force: Array, modes: ContactModes, speed: Array
) -> tuple[Array, Array, float, frozenset[int]]:
    """Return `Touch.slip_speed`, `stops_in`, `turning_time`, and the contacts that still begin to slip.

    A slip that turns need not pass zero where it stops: it has stopped below `STOPPED_SPEED`.

    Args:
        rows: the contacts.
        P: mobility of object and tips.
        acceleration: of object and tips, with the forces.
        u: (k, 3 or 4) velocities.
        force: (k, 3 or 4) forces.
        modes: the modes.
        speed: (k,) along the slip before.
    """
    along, shortest, begins = tangents(u), np.inf, set(modes.begins)
    speed, stops = speed.copy(), np.full(len(u), np.inf)
    for j in np.flatnonzero(modes.mode == ContactMode.SLIPS).tolist():
        C, t = rows.C[j, along], u[j, along]
        size = float(np.linalg.norm(t))
        given = float(rows.friction[j] * force[j, 2] * np.linalg.norm(C @ P @ C.T, 2))
        begins -= {j} if size > BEGINS_FOR * given else set()
        a = C @ acceleration + rows.drift[j, along]
        if j in begins and min(size, float(np.linalg.norm(a))) > 0.0:
            since = 2.0 * size / float(np.linalg.norm(a))
            shortest = min(shortest, 2.0 * since * (np.sqrt(2.0 * BEGINS_FOR * given / size) - 1.0))
        if j in begins or not min(size, given) > 0.0:
            continue
        across = a - t * float(t @ a) / size**2
        if size * np.linalg.norm(across) <= (STAYS_STRAIGHT if j in modes.straight else STRAIGHT) * given:
            stops[j] = size**2 / -float(t @ a) if t @ a < 0.0 else np.inf
            continue
        if size > STOPPED_SPEED:
            shortest = min(shortest, size / max(given, float(np.linalg.norm(a))))
        elif t @ a < 0.0 and j not in modes.straight:
            speed[j] = min(speed[j], size - STOPPED_SPEED)
    return speed, stops, shortest, frozenset(begins)


def _slip(rows: ContactRows, u: Array, modes: ContactModes) -> tuple[Array, Array, Array]:
    """Return the directions of slip for friction in contact axes, those of now in world axes, and the slip speeds (k,).

    The first turn with the slip, but do not reverse where it stops.
    """
    t = u[:, tangents(u)]
    along, slip, speed = np.zeros(t.shape), modes.slip.copy(), np.full(len(u), np.inf)
    for j in np.flatnonzero(modes.mode == ContactMode.SLIPS):
        before = slip_in_axes(rows.axes[j], modes.slip[j])
        speed[j] = t[j] @ before
        size = float(np.linalg.norm(t[j]))
        own = size > SLOWEST_SLIP and j not in modes.begins | modes.straight
        d = t[j] / size if own else before / np.linalg.norm(before)
        along[j] = d if d @ before >= 0.0 else -d
        if own and speed[j] > 0.0:
            slip[j] = slip_in_world(rows.axes[j], d)
    return along, slip, speed


def tangents(u: Array) -> list[int]:
    """Return the indices of the tangential components of vectors [t1, t2, n] or [t1, t2, n, spin], (k, 3 or 4)."""
    return [i for i in range(u.shape[1]) if i != 2]


def slip_in_axes(axes: Array, slip: Array) -> Array:
    """Return a slip in world axes, perhaps with a spin, as [t1, t2] or [t1, t2, spin]."""
    return np.concatenate([axes[:2] @ slip[:3], slip[3:]])


def slip_in_world(axes: Array, t: Array) -> Array:
    """Return the inverse of `slip_in_axes`."""
    return np.concatenate([t[:2] @ axes[:2], t[2:]])


def on_contacts(
    chain: ClosedChain,
    state: State,
    modes: ContactModes,
    held: Array | None = None,
    *,
    velocities: bool = True,
    responses: RestResponses | None = None,
) -> State:
    """Return a state that satisfies the grasps, moved by the least displacement that closes the closed contacts.

    Distances are those of the kinetic metric of the whole chain: the object is pushed by impulses that the grasps
    share. Then velocities are changed in the same way, so that closed contacts neither approach nor leave, and sticking
    ones do not slip.

    Args:
        chain: the chain, without the grasps of hands that slide.
        state: a state that satisfies the grasps.
        modes: the modes.
        held: rows of the grasps to impose, see `held_rows`.
        velocities: whether velocities are changed, too.
        responses: the chain's responses at rest; by default those of the reference.
    """
    closed, at_rest = modes.closed, responses or RestResponses(chain, held, modes.hands)
    if not len(closed):
        return state
    for _ in range(ROUNDS):
        rows = at_rest.rows(state)
        if not np.abs(rows.gap[closed]).max() > SETTLED_GAP:
            break
        push = _removing(at_rest.mobility(state, True), rows.C[closed, 2], rows.gap[closed])
        state = displaced_by(state, at_rest.change(state, push, True))
    if not velocities:
        return state
    rows = at_rest.rows(state)
    u = rows.velocity(stacked_twist(chain, state, modes.hands))
    of, units = modes.imposed()
    P, A, gap = at_rest.mobility(state), np.einsum("mia,mi->ma", rows.C[of], units), (u[of] * units).sum(axis=1)
    if modes.begins:
        E, aside = _turnable(rows, u, modes, A, P)
        A, gap = np.concatenate([A, E]), np.append(gap, aside)
    return quickened(state, at_rest.change(state, _removing(P, A, gap)))


def _turnable(rows: ContactRows, u: Array, modes: ContactModes, A: Array, P: Array) -> tuple[Array, Array]:
    """Return the rows across slips that begin, and the velocities along them, if friction can turn them.

    Where other rows leave one direction, it cannot: a row that is nearly across it would end the slip.
    """
    along, directions = tangents(u), _slip(rows, u, modes)[0]
    across = [(j, B) for j in sorted(modes.begins) for B in _across(directions[j])]
    E, aside = (np.array([B @ x[j, along] for j, B in across]) for x in (rows.C, u))
    Q = P - P @ A.T @ np.linalg.lstsq(A @ P @ A.T, A @ P, rcond=DEPENDENT_CONTACT_ROWS)[0]
    kept = []
    for k, one in enumerate(E):
        if (left := one @ Q @ one) > TURNABLE * (one @ P @ one):
            kept.append(k)
            Q = Q - np.outer(Q @ one, Q @ one) / left
    return E[kept], aside[kept]


def _removing(P: Array, A: Array, gap: Array) -> Array:
    """Return the impulse A^T x, on the object and on tips of the mobility P, that changes A V by -gap."""
    return A.T @ np.linalg.lstsq(A @ P @ A.T, -gap, rcond=DEPENDENT_CONTACT_ROWS)[0]
