"""How the forces of the world on the object change while all contacts keep their modes.

With the imposed rows A, what a unit of each unknown exerts, D, and the unknowns x of `fixed_modes`, the wrench is
w = D^T x, and the object's acceleration alpha = alpha_0 + P w keeps A alpha + drift = 0. With derivatives at fixed x
and alpha marked by |:

    S dx = -(A (d alpha_0 + P dw|) + d(A alpha + drift)|),   S = A P D^T,   dw = dw| + D^T dx

A, D and drift depend on the pose and the twist of the object, alpha_0 on everything else, too. Where contacts share a
load in several ways, dx is the smallest, and dw is unique along motions that keep the contacts closed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.fixed_modes import DEPENDENT_CONTACT_ROWS
from holdfast.dynamics.contact.rows import ContactRows, contact_rows
from holdfast.dynamics.contact.solved_contacts import ContactMode, ContactStatus
from holdfast.dynamics.contact.touching_chain import closed_contacts
from holdfast.dynamics.result import ForwardResult
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.differentiation import linearised
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array, concatenate, sqrt
from holdfast.spatial.vector import skew
from holdfast.state import State

STRICT = 1e-6  # margins, relative to the largest force, that are too small for a derivative; also m and m/s
OF_CONTACTS = ("object_pose", "object_twist")  # the arguments on which contacts depend


class ContactRates(NamedTuple):
    """The linearised equations of the contacts in their modes, m imposed rows.

    Attributes:
        wrench: (6,) of the world on the object about C.
        A: (m, 6) imposed rows.
        D: (m, 6) wrench per unknown.
        gives: (3k, m) forces of all candidates, world axes, per unknown.
        by: derivatives at fixed x and alpha of A alpha + drift (m, 6), the wrench (6, 6) and the forces (3k, 6), by
            argument.
    """

    wrench: Array
    A: Array
    D: Array
    gives: Array
    by: Mapping[str, tuple[Array, Array, Array]]

    def compliance(self, P: Array) -> Array:
        """Return S^+, (m, m), for the object's mobility P."""
        return np.linalg.pinv(self.A @ P @ self.D.T, rcond=DEPENDENT_CONTACT_ROWS)

    def changes(self, name: str, P: Array, alpha: Array) -> tuple[Array, Array]:
        """Return the changes of the wrench (6, c) and of all forces (3k, c) by an argument.

        Args:
            name: of the argument.
            P: (6, 6) the object's mobility.
            alpha: (6, c) change of its acceleration by the argument, without that of the contact forces.
        """
        c = alpha.shape[1]
        still = (np.zeros((len(self.A), c)), np.zeros((6, c)), np.zeros((len(self.gives), c)))
        rows, wrench, forces = self.by.get(name, still)
        dx = -self.compliance(P) @ (self.A @ (alpha + P @ wrench) + rows)
        return wrench + self.D.T @ dx, forces + self.gives @ dx


def contact_rates(chain: ClosedChain, state: State, result: ForwardResult, by_forces: bool) -> ContactRates | None:
    """Return the linearised equations of closed contacts; None if there are none. O(k).

    Args:
        chain: a chain with `touching`.
        state: positions and velocities.
        result: its forward dynamics there.
        by_forces: whether derivatives of the forces are wanted, and not only of the motion.

    Raises:
        StateError: a contact is about to change its mode, so that there is no derivative, or forces are not unique.
    """
    touching = chain.touching
    assert touching is not None
    rows, closed, _ = closed_contacts(touching, state)
    modes, force = result.touch_mode, result.touch_force
    assert modes is not None
    assert force is not None
    local = np.einsum("kij,kj->ki", rows.axes, force)
    require_strict(chain, state, result, rows, closed, local, by_forces)
    of = [(j, i) for j in np.flatnonzero(closed) for i in ((0, 1, 2) if modes[j] == ContactMode.STICKS else (2,))]
    if not of:
        return None
    x = np.array([local[j, i] for j, i in of])
    slips = {j for j, _ in of if modes[j] == ContactMode.SLIPS and rows.friction[j] > 0.0}
    alpha, frame = result.object_acceleration, state.object_frame

    def parts(R: Array, p: Array, twist: Array) -> tuple[ContactRows, list[Array]]:
        at = contact_rows(touching, Pose.unchecked(R, p), twist)
        gives = []
        for j, i in of:
            give = np.eye(3)[i]
            if j in slips:
                u = (at.C[j] @ twist - at.carried[j])[:2]
                give = concatenate([-rows.friction[j] / sqrt(u @ u) * u, [1.0]])
            gives.append(give)
        return at, gives

    def equations(R: Array, p: Array, twist: Array) -> tuple[Array, Array, Array]:
        at, gives = parts(R, p, twist)
        kept = array([at.C[j, i] @ alpha + at.drift[j, i] for j, i in of])
        wrench, forces = np.zeros(6), [np.zeros(3) for _ in modes]
        for (j, _), give, own in zip(of, gives, x.tolist(), strict=True):
            wrench = wrench + own * (at.C[j].T @ give)
            forces[j] = forces[j] + own * (at.axes[j].T @ give)
        return kept, wrench, concatenate(forces)

    linear = linearised(equations, frame.R, frame.p, state.object_twist)
    none = np.zeros((3, 3)), np.zeros(3), np.zeros(6)
    units = np.eye(3)
    turns = [linear.rates(skew(e) @ frame.R, none[1], none[2]) for e in units]
    shifts = [linear.rates(none[0], e, none[2]) for e in units]
    twists = [linear.rates(none[0], none[1], e) for e in np.eye(6)]
    by = {}
    for name, rates in zip(OF_CONTACTS, ([*turns, *shifts], twists), strict=True):
        kept, wrench, forces = (np.array([rate[i] for rate in rates]).T for i in range(3))
        by[name] = kept, wrench, forces
    at, gives = parts(frame.R, frame.p, state.object_twist)
    of_world = np.zeros((len(modes), 3, len(of)))
    for column, ((j, _), give) in enumerate(zip(of, gives, strict=True)):
        of_world[j, :, column] = rows.axes[j].T @ give
    A = np.array([at.C[j, i] for j, i in of])
    D = np.array([at.C[j].T @ give for (j, _), give in zip(of, gives, strict=True)])
    return ContactRates(rows.wrench(local), A, D, of_world.reshape(-1, len(of)), by)


def require_strict(
    chain: ClosedChain,
    state: State,
    result: ForwardResult,
    rows: ContactRows,
    closed: Array,
    force: Array,
    by_forces: bool,
) -> None:
    """Refuse contacts that are about to change their modes, motions that are not unique, and forces likewise.

    Args:
        chain: the chain.
        state: its state.
        result: forward dynamics there.
        rows: all candidates.
        closed: (k,) which of them are closed and do not leave.
        force: (k, 3) forces, contact axes.
        by_forces: whether derivatives of the forces are wanted.

    Raises:
        StateError: naming the contact.
    """
    assert chain.touching is not None
    assert result.touch_mode is not None
    if result.touch_status is ContactStatus.AMBIGUOUS:
        raise StateError("derivatives: expected a unique motion, but the laws of contact allow several at this state")
    if by_forces and result.touch_status is ContactStatus.INDETERMINATE_FORCES:
        raise StateError(
            "derivatives: touch_force: expected unique forces, but contacts share the load in several ways; try fewer"
            " contacts, or the other results, whose derivatives do not depend on the shares"
        )
    u = rows.velocity(state.object_twist)
    least = STRICT * float(np.abs(force).max(initial=0.0))
    for j, name in enumerate(chain.touching.names):
        mode, f, mu, slip = result.touch_mode[j], force[j], rows.friction[j], float(np.hypot(u[j, 0], u[j, 1]))
        if not closed[j]:
            grazes = rows.gap[j] < STRICT and u[j, 2] < STRICT
            why = f"is open by {rows.gap[j]:.1e} m and neither closed nor leaving" if grazes else ""
        elif mode == ContactMode.OPEN or f[2] <= least:
            why = "lifts off at this instant"
        elif mode == ContactMode.STICKS and mu * f[2] - np.hypot(f[0], f[1]) <= least:
            why = "is about to slip: its friction is at the limit"
        elif mode == ContactMode.SLIPS and mu > 0.0 and slip < STRICT:
            why = "begins to slip, or stops, at this instant"
        else:
            why = ""
        if why:
            raise StateError(
                f"derivatives: expected contacts with strict margins, which keep their modes nearby; contact '{name}'"
                f" {why}. Try another state, or one-sided differences"
            )
