"""Contacts in fixed modes: sticking ones impose three rows, slipping and frictionless ones their normal row.

    A alpha + drift = 0,   w = D^T x,   (A P D^T) x = -(A alpha_0 + drift)

A are the imposed rows, and the rows of D say what a unit of each unknown exerts: the row itself, or for a slipping
contact n - mu t with the direction t of the slip. P is the object's mobility in the chain, alpha_0 its acceleration
without contact forces. Redundant contacts share the load by the least norm of x, as equal compliances do.

The direction of friction is continued smoothly through a stop: just past it, -mu lambda_n t still points against the
slip before. Only then can the time of the stop be located as the zero of a smooth function.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.closed.held_rows import holding
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

SLOWEST_SLIP = 1e-7  # m/s: a slower slip has no direction of its own
DEPENDENT = 1e-11  # singular values below this part of the largest are those of dependent rows
SETTLED_GAP = 1e-15  # m
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class ContactModes(Frozen):
    """What every contact does during a stretch of smooth motion.

    Attributes:
        mode: (k,) numbers of `ContactMode`.
        slip: (k, 3) unit vectors along the slip of slipping contacts, world axes; 0 for others. (k, 4) with soft
            fingers, whose fourth component is the spin times the torsion radius.
        hands: hands that slide, whose points follow the contacts with the world.
    """

    mode: Array
    slip: Array
    hands: tuple[Hand, ...] = ()

    @property
    def closed(self) -> Array:
        """The indices of the contacts that are closed."""
        return np.flatnonzero(self.mode != ContactMode.OPEN)

    def imposed(self) -> tuple[Array, Array]:
        """Return contact and axis of every imposed row, (m,) each."""
        every = range(self.slip.shape[1])
        pairs = [(j, i) for j in self.closed for i in (every if self.mode[j] == ContactMode.STICKS else (2,))]
        found = np.array(pairs, dtype=int).reshape(-1, 2)
        return found[:, 0], found[:, 1]


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
    """

    rows: ContactRows
    force: Array
    velocity: Array
    modes: ContactModes
    slip_speed: Array


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
    force = np.zeros(u.shape)
    directions, slip, speed = _slip(rows, u, modes)
    of, axis = modes.imposed()
    if len(of):
        P = at_rest.mobility(state)
        A, gives = rows.C[of, axis], np.eye(u.shape[1])[axis]
        slips = modes.mode[of] == ContactMode.SLIPS
        gives[np.ix_(slips, tangents(u))] = -rows.friction[of[slips], None] * directions[of[slips]]
        D = np.einsum("mia,mi->ma", rows.C[of], gives)
        b = A @ acceleration + rows.drift[of, axis]
        x = np.linalg.lstsq(A @ P @ D.T, -b, rcond=DEPENDENT)[0]
        np.add.at(force, of, x[:, None] * gives)
    return Touch(rows, force, u, replace(modes, slip=slip), speed)


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
        d = t[j] / size if size > SLOWEST_SLIP else before / np.linalg.norm(before)
        along[j] = d if d @ before >= 0.0 else -d
        if size > SLOWEST_SLIP and speed[j] > 0.0:
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
    of, axis = modes.imposed()
    u = rows.velocity(stacked_twist(chain, state, modes.hands))
    push = _removing(at_rest.mobility(state), rows.C[of, axis], u[of, axis])
    return quickened(state, at_rest.change(state, push))


def _removing(P: Array, A: Array, gap: Array) -> Array:
    """Return the impulse A^T x, on the object and on tips of the mobility P, that changes A V by -gap."""
    return A.T @ np.linalg.lstsq(A @ P @ A.T, -gap, rcond=DEPENDENT)[0]
