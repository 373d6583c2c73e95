"""Forces of the world on a chain's object by a fixed number of steps, of all candidates at once.

`touching_chain` solves the contacts that are closed, in as many ways as it takes. Here the open ones stay in the
problem, as contacts whose rows are zero and which separate: the length is fixed, and the text becomes machine code.

    w = sum C_j^T lambda_j,   u_j' = C_j (alpha_0 + P w) + drift_j,   with the laws of `contact_law`
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.contact_forces import RESOLVED, FoundForces, cold_forces, contact_problem, found_forces
from holdfast.dynamics.contact.proximal_newton import COMPLIANCES, polished
from holdfast.dynamics.contact.rows import ContactRows, contact_rows
from holdfast.dynamics.contact.solved_contacts import ContactStatus
from holdfast.dynamics.contact.touching_chain import CLOSED, LEAST_SLIP
from holdfast.model.world.touching import Touching
from holdfast.spatial.scalar import Array, Scalar, array, each, maximum, reciprocal, select, sqrt, where
from holdfast.spatial.vector import largest
from holdfast.state import State

WARM = (1e-2, 1e-3, 1e-4)  # compliances of Newton's steps from given forces, which are taken whole
SEPARATING = 1e-5  # acceleration of an open contact away from the surface, relative to the largest of the closed ones
STATUSES = [ContactStatus.OK, ContactStatus.UNRESOLVED]  # by number; whether a motion is unique is not decided here


class Pressing(NamedTuple):
    """The contacts of a chain's object with the world.

    Attributes:
        touch_force: (k, 3) on the object, world axes.
        touch_gap: (k,).
        touch_mode: (k,) numbers of `ContactMode`.
        touch_status: number in `STATUSES`.
        touch_residual: violation of the laws, relative to the accelerations.
        wrench: (6,) sum of the forces about C, world axes.
        approaches: 1 if a closed contact approaches, for which there are no forces; else 0.
    """

    touch_force: Array
    touch_gap: Array
    touch_mode: Array
    touch_status: Scalar
    touch_residual: Scalar
    wrench: Array
    approaches: Scalar


def pressing(touching: Touching, state: State, mobility: Array, alpha: Array, start: Array | None = None) -> Pressing:
    """Return the forces of the world on the object. O(k).

    Args:
        touching: the points and shapes.
        state: positions and velocities.
        mobility: (6, 6) P of the object in the chain.
        alpha: (6,) its acceleration without forces of the world.
        start: (k, 3) forces of a similar problem, world axes, from which a few of Newton's steps are taken; None: the
            whole path.
    """
    twist = state.object_twist
    rows = contact_rows(touching, state.object_frame, twist)
    least = LEAST_SLIP * maximum(1.0, largest(twist))
    u = rows.velocity(twist)
    near = [where(gap <= CLOSED, where(one[2] <= least, 1.0, 0.0), 0.0) for gap, one in zip(rows.gap, u, strict=True)]

    def sliding(closed: Scalar, v: Array) -> Array:
        speed = sqrt(v[:2] @ v[:2])
        moves = where(speed > least, closed, 0.0) > 0.0
        return where(moves, reciprocal(where(moves, speed, 1.0)), 0.0) * v[:2]

    slide = array(each(sliding, near, u))
    found = forces_of_near(mobility, rows, rows.C @ alpha + rows.drift, slide, near, start)
    failed = where(found.residual <= RESOLVED, 0.0, 1.0)
    slowest = [closed * where(one[2] < -least, 1.0, 0.0) for closed, one in zip(near, u, strict=True)]
    return Pressing(
        rows.in_world(found.force), rows.gap, found.mode, failed, found.residual, found.wrench, largest(slowest)
    )


def forces_of_near(
    mobility: Array,
    rows: ContactRows,
    free: Array,
    slide: Array,
    near: Sequence[Scalar],
    start: Array | None,
    compliances: tuple[float, ...] | None = None,
) -> FoundForces:
    """Return the forces of some contacts by a fixed number of steps; the others get none. O(k).

    Args:
        mobility: (6, 6) P of the object in the chain.
        rows: all contacts.
        free: (k, 3) their accelerations, or velocities, without forces.
        slide: (k, 2) unit directions in which contacts slide already, 0 for those at rest.
        near: 1 for each contact that takes part, else 0.
        start: (k, 3) forces of a similar problem, world axes, from which Newton's steps are taken; None: the whole
            path.
        compliances: those of Newton's steps from `start`, or at the path's end; None for the usual ones.
    """
    largest_near = largest(one * x for one, b in zip(near, free, strict=True) for x in b)
    size = where(largest_near > 0.0, largest_near, 1.0)

    def of_contact(one: Scalar, C: Array, b: Array) -> tuple[Array, Array]:
        away = array([0.0, 0.0, SEPARATING * size])
        return select(one > 0.0, C, 0.0 * C), select(one > 0.0, b, away)

    C, b = (array(x) for x in zip(*each(of_contact, near, rows.C, free), strict=True))
    problem = contact_problem(mobility, C, b, rows.friction, np.zeros(len(rows.gap)), slide, False)
    if start is None:
        forces, residual = cold_forces(problem, compliances or COMPLIANCES)
    else:
        forces, residual = polished(problem.contacts, _given(rows, start), compliances or WARM, (1.0,))
    return found_forces(problem, forces, residual)


def _given(rows: ContactRows, start: Array) -> list[Array]:
    """Return forces along contact axes [n, t1, t2]."""
    return [axes[[2, 0, 1]] @ one for axes, one in zip(rows.axes, start, strict=True)]
