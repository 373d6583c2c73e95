"""The forces of the world on a chain's object as unknowns of the affine map of forces, in the modes of an acceleration.

A contact acts on the object alone. What it can exert depends on what it does under the asked acceleration, with
a = C alpha + drift at the contact point, contact axes [t1, t2, n]:

    opens    a_n > 0                   no force
    sticks   u_t = 0, a = 0            any force of the cone |lambda_t| <= mu lambda_n
    slips    u_t != 0, a_n = 0         (n - mu t) lambda_n, t along u_t
             u_t = 0, a_n = 0          the same, t along a_t: it begins to slip

Where some of the object's acceleration is free, contacts stay as they are: those at rest stick, those that slide go on
to slide, and their rows C alpha + drift = 0 are equations. (The choice of modes among others is not convex.)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.contact.rows import ContactRows
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.dynamics.contact.touching_chain import closed_contacts
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import State

NOT_MOVING = 1e-9  # rad/s^2, m/s^2, or relative to larger accelerations: a smaller one of a contact is rounding
NO_EFFECT = 1e-9  # singular values below this, relative to the largest, count as zero


class TouchPlace(NamedTuple):
    """Where the force of a closed contact is among the unknowns.

    Attributes:
        name: "point/shape".
        row: its number among the candidates.
        mode: what it does.
        part: its place among the unknown forces of the world.
        gives: (m, 3) force on the object per unknown, contact axes [t1, t2, n].
        friction: mu.
    """

    name: str
    row: int
    mode: ContactMode
    part: slice
    gives: Array
    friction: float

    @property
    def normal(self) -> Array:
        """The normal force per unknown, (m,)."""
        return self.gives[:, 2]


class TouchedObject(NamedTuple):
    """The contacts of the object with the world, in their modes.

    Attributes:
        rows: all candidates.
        mode: (k,) numbers of `ContactMode`.
        places: the closed contacts that can exert a force.
        kept: whether modes are those of the state, because some of the acceleration is free.
    """

    rows: ContactRows
    mode: Array
    places: tuple[TouchPlace, ...]
    kept: bool

    @property
    def size(self) -> int:
        """Number of unknown forces."""
        return self.places[-1].part.stop if self.places else 0

    @property
    def to_object(self) -> Array:
        """The wrench about C, world axes, per unknown, (6, size)."""
        return np.hstack([np.zeros((6, 0)), *(self.rows.C[one.row].T @ one.gives.T for one in self.places)])

    @property
    def kept_rows(self) -> tuple[Array, Array]:
        """The rows (r, 6) and right sides (r,) by which an acceleration keeps the modes; none if all of it is asked.

        Sticking contacts keep three components of their acceleration at zero, sliding ones that along the normal.
        """
        along = [
            (one.row, slice(0, 3) if one.mode is ContactMode.STICKS else slice(2, 3))
            for one in self.places
            if self.kept
        ]
        rows = [self.rows.C[j, axes] for j, axes in along]
        return np.vstack([np.zeros((0, 6)), *rows]), np.concatenate(
            [np.zeros(0), *(-self.rows.drift[j, axes] for j, axes in along)]
        )

    def forces(self, x: Array) -> Array:
        """Return the forces of all candidates on the object, (k, 3) contact axes, of the unknowns x."""
        found = np.zeros((len(self.mode), 3))
        for one in self.places:
            found[one.row] = x[one.part] @ one.gives
        return found

    def margins(self, forces: Array) -> Array:
        """Return by how much forces (k, 3) in contact axes keep the modes, (k,) [N]; infinite for open contacts.

        mu lambda_n - |lambda_t| where a contact sticks, and lambda_n where it slides, or is frictionless.
        """
        found = np.full(len(self.mode), np.inf)
        for one in self.places:
            f = forces[one.row]
            sticks = one.mode is ContactMode.STICKS
            found[one.row] = one.friction * f[2] - np.hypot(f[0], f[1]) if sticks else f[2]
        return found


def touched_object(
    motion: ChainMotion, state: State, alpha: Array | None, more: Array | None = None
) -> TouchedObject | None:
    """Return the contacts in the modes of an acceleration; None for a chain without `touching`. O(k).

    Args:
        motion: the chain's motion.
        state: positions and velocities.
        alpha: (6,) the object's true acceleration, world axes; None if some of it is free.
        more: (6,) with it the acceleration is alpha + sigma more, and the modes are those of every sigma > 0.

    Raises:
        StateError: a closed contact approaches, or the acceleration presses the object into the world.
        MethodNotApplicable: the modes depend on sigma.
    """
    touching = motion.chain.touching
    if touching is None:
        return None
    rows, closed, slide = closed_contacts(touching, state)
    mode, places, at = np.zeros(len(closed), int), [], 0
    drift = rows.drift if more is None or alpha is None else rows.C @ alpha + rows.drift
    moved = alpha if more is None else more
    for j in np.flatnonzero(closed):
        name, mu = touching.names[j], float(rows.friction[j])
        slides, a = bool(slide[j].any()), np.zeros(3)
        if moved is not None:
            by_alpha = rows.C[j] @ moved
            a = by_alpha + drift[j]
            least = NOT_MOVING * max(1.0, float(np.abs(by_alpha).max()), float(np.abs(drift[j]).max()))
            seen = slice(2, 3) if slides or mu == 0.0 else slice(0, 3)
            if more is not None and np.abs(drift[j, seen]).max() > least and np.abs(by_alpha[seen]).max() > least:
                raise MethodNotApplicable(
                    f"lift_margin: contact '{name}' has an acceleration of its own, so that what it does depends on the"
                    " share; expected a state at rest, or an acceleration without effect there. Try distribute"
                )
            if a[2] < -least:
                raise StateError(
                    f"acceleration: expected one that does not press the object into the world: contact '{name}' is"
                    f" closed, and would approach with {-a[2]:.3g} m/s^2. Try task=, which leaves directions free: the"
                    " contact then keeps them"
                )
            if a[2] > least:
                continue
            if mu > 0.0 and not slides and np.hypot(a[0], a[1]) > least:
                slide[j] = a[:2] / np.hypot(a[0], a[1])
        kind = ContactMode.CLOSED if mu == 0.0 else ContactMode.SLIPS if slide[j].any() else ContactMode.STICKS
        gives = np.eye(3) if kind is ContactMode.STICKS else np.append(-mu * slide[j], 1.0)[None]
        mode[j] = kind
        places.append(TouchPlace(name, int(j), kind, slice(at, at + len(gives)), gives, mu))
        at += len(gives)
    return TouchedObject(rows, mode, tuple(places), alpha is None)


def contact_names(chain: ClosedChain) -> tuple[str, ...]:
    """Return the names of contacts with the world, and of the shapes, each of which stands for all of its contacts."""
    names = () if chain.touching is None else chain.touching.names
    return (*names, *dict.fromkeys(name.partition("/")[2] for name in names))


def pressing_contacts(chain: ClosedChain, name: str, what: str) -> list[int]:
    """Return the numbers of the contacts that a name stands for: one contact, or all of a shape.

    Raises:
        ModelError: nothing has this name.
    """
    names = () if chain.touching is None else chain.touching.names
    found = [j for j, one in enumerate(names) if name in (one, one.partition("/")[2])]
    if not found:
        known = contact_names(chain)
        raise ModelError(f"{what}: no contact {checks.short(name)}.{checks.did_you_mean(str(name), known)}")
    return found


def normal_force_rows(
    chain: ClosedChain, touched: TouchedObject | None, asked: Mapping[str, Any] | None
) -> tuple[Array, Array]:
    """Return the rows (r, size) on the unknown forces, and values (r,), by which normal forces are as asked.

    Raises:
        ModelError, StateError: nothing has such a name, a number is wrong, or the contact is open.
    """
    if asked is None:
        return np.zeros((0, 0 if touched is None else touched.size)), np.zeros(0)
    if touched is None:
        raise ModelError("normal_force: expected a chain with touching, got one without")
    checks.instance(asked, Mapping, "normal_force")
    rows, values = np.zeros((len(asked), touched.size)), np.zeros(len(asked))
    for row, (i, (name, value)) in zip(rows, enumerate(asked.items()), strict=True):
        values[i] = checks.number(value, f"normal_force: '{name}'", at_least=0.0)
        contacts = pressing_contacts(chain, name, "normal_force")
        row[:] = normal_row(touched, contacts)
        if not row.any():
            raise StateError(
                f"normal_force: expected a contact that is closed and stays so, but '{name}' is open; its gap is"
                f" {min(touched.rows.gap[j] for j in contacts):.3g} m. Try a"
                " state in which it touches, and an acceleration that does not lift it"
            )
    return rows, values


def normal_row(touched: TouchedObject, contacts: list[int]) -> Array:
    """Return the row (size,) of the sum of the normal forces of some contacts."""
    row = np.zeros(touched.size)
    for one in touched.places:
        if one.row in contacts:
            row[one.part] = one.normal
    return row


def undetermined(touched: TouchedObject, felt: Array) -> tuple[Array, int]:
    """Return rows that make the forces of the world smallest that no torque decides, and the number of other such ones.

    Where grasps carry a change of contact forces without any joint's torque, forward dynamics returns the smallest
    contact forces, and so do these rows (r, size). Where contacts share one wrench in several ways, the cost chooses.

    Args:
        touched: the contacts.
        felt: (rows, grasps + size) effect of grasp wrenches and contact forces on joints and object, in one unit.
    """
    size, count = touched.size, felt.shape[1] - touched.size
    free = _null(felt)[count:]
    shared = _null(touched.to_object) if size else np.zeros((0, 0))
    U, s, _ = np.linalg.svd(free - shared @ (shared.T @ free), full_matrices=False)
    return U[:, s > NO_EFFECT].T, shared.shape[1]


def _null(A: Array) -> Array:
    """Return an orthonormal basis of the null space of a matrix, as columns."""
    _, s, Vt = np.linalg.svd(A)
    return Vt[int((s > NO_EFFECT * s.max(initial=1e-300)).sum()) :].T
