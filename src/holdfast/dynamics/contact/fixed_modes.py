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
from holdfast.dynamics.closed.sequential import rest_response
from holdfast.dynamics.contact.rows import ContactRows, contact_rows
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.dynamics.contact.touch import impulse_response
from holdfast.dynamics.projection import Change, displaced_by, quickened
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.world.touching import Touching
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
        slip: (k, 3) unit vectors along the slip of slipping contacts, world axes; 0 for others.
    """

    mode: Array
    slip: Array

    @property
    def closed(self) -> Array:
        """The indices of the contacts that are closed."""
        return np.flatnonzero(self.mode != ContactMode.OPEN)

    def imposed(self) -> tuple[Array, Array]:
        """Return contact and axis of every imposed row, (m,) each."""
        pairs = [(j, i) for j in self.closed for i in ((0, 1, 2) if self.mode[j] == ContactMode.STICKS else (2,))]
        found = np.array(pairs, dtype=int).reshape(-1, 2)
        return found[:, 0], found[:, 1]


@dataclass(frozen=True, eq=False)
class Touch(Frozen):
    """The contacts at one instant, in fixed modes.

    Attributes:
        rows: gaps, rows and axes.
        force: (k, 3) forces of the world on the object, contact axes [N].
        velocity: (k, 3) u, contact axes [m/s].
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
    """How a chain at rest gives way to a push on its object.

    Attributes:
        chain: the chain.
        held: rows of the grasps to impose, see `held_rows`.
    """

    chain: ClosedChain
    held: Array | None = None

    def rows(self, touching: Touching, state: State) -> ContactRows:
        """Return the contacts' rows."""
        return contact_rows(touching, state.object_frame, state.object_twist)

    def mobility(self, state: State, positions: bool = False) -> Array:
        """Return the object's mobility (6, 6); for `positions` with the rows of the grasps that those impose."""
        return rest_response(self._motion(state, positions)).mobility

    def change(self, state: State, push: Array, positions: bool = False) -> Change:
        """Return the change of the velocities by an impulse (6,) on the object."""
        return impulse_response(self._motion(state, positions), state, push)[0]

    def _motion(self, state: State, positions: bool) -> ChainMotion:
        return holding(chain_at_rest(self.chain, state), self.held, positions=positions)


def touch_at(
    chain: ClosedChain,
    state: State,
    acceleration: Array,
    held: Array | None,
    modes: ContactModes,
    responses: RestResponses | None = None,
) -> Touch:
    """Return the forces of contacts in given modes. O(n) + O(l) + O(k).

    Args:
        chain: the chain, with `touching`.
        state: positions and velocities.
        acceleration: (6,) of the object without contact forces.
        held: rows of the grasps to impose, see `held_rows`.
        modes: the modes, with slip directions at the step's start.
        responses: the chain's responses at rest; by default those of the reference.
    """
    assert chain.touching is not None
    at_rest = responses or RestResponses(chain, held)
    rows = at_rest.rows(chain.touching, state)
    u, force = rows.velocity(state.object_twist), np.zeros((len(rows.gap), 3))
    directions, slip, speed = _slip(rows, u, modes)
    of, axis = modes.imposed()
    if len(of):
        P = at_rest.mobility(state)
        A, gives = rows.C[of, axis], np.eye(3)[axis]
        slips = modes.mode[of] == ContactMode.SLIPS
        gives[slips, :2] = -rows.friction[of[slips], None] * directions[of[slips]]
        D = np.einsum("mia,mi->ma", rows.C[of], gives)
        b = A @ acceleration + rows.drift[of, axis]
        x = np.linalg.lstsq(A @ P @ D.T, -b, rcond=DEPENDENT)[0]
        np.add.at(force, of, x[:, None] * gives)
    return Touch(rows, force, u, replace(modes, slip=slip), speed)


def _slip(rows: ContactRows, u: Array, modes: ContactModes) -> tuple[Array, Array, Array]:
    """Return the directions of slip for friction (k, 2) in contact axes, those of now (k, 3), and the slip speeds (k,).

    The first turn with the slip, but do not reverse where it stops.
    """
    along, slip, speed = np.zeros((len(u), 2)), modes.slip.copy(), np.full(len(u), np.inf)
    for j in np.flatnonzero(modes.mode == ContactMode.SLIPS):
        before = rows.axes[j, :2] @ modes.slip[j]
        speed[j] = u[j, :2] @ before
        size = float(np.hypot(*u[j, :2]))
        d = u[j, :2] / size if size > SLOWEST_SLIP else before / np.hypot(*before)
        along[j] = d if d @ before >= 0.0 else -d
        if size > SLOWEST_SLIP and speed[j] > 0.0:
            slip[j] = d @ rows.axes[j, :2]
    return along, slip, speed


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
        chain: the chain, with `touching`.
        state: a state that satisfies the grasps.
        modes: the modes.
        held: rows of the grasps to impose, see `held_rows`.
        velocities: whether velocities are changed, too.
        responses: the chain's responses at rest; by default those of the reference.
    """
    touching, closed, at_rest = chain.touching, modes.closed, responses or RestResponses(chain, held)
    assert touching is not None
    if not len(closed):
        return state
    for _ in range(ROUNDS):
        rows = at_rest.rows(touching, state)
        if not np.abs(rows.gap[closed]).max() > SETTLED_GAP:
            break
        push = _removing(at_rest.mobility(state, True), rows.C[closed, 2], rows.gap[closed])
        state = displaced_by(state, at_rest.change(state, push, True))
    if not velocities:
        return state
    rows = at_rest.rows(touching, state)
    of, axis = modes.imposed()
    push = _removing(at_rest.mobility(state), rows.C[of, axis], rows.velocity(state.object_twist)[of, axis])
    return quickened(state, at_rest.change(state, push))


def _removing(mobility: Array, A: Array, gap: Array) -> Array:
    """Return the impulse A^T x on the object that changes A V by -gap, (6,)."""
    return A.T @ np.linalg.lstsq(A @ mobility @ A.T, -gap, rcond=DEPENDENT)[0]
