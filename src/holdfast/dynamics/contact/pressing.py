"""Forces of the world on a chain's object by a fixed number of steps, of all candidates at once.

`touching_chain` solves the contacts that are closed, in as many ways as it takes. Here the open ones stay in the
problem, as contacts whose rows are zero and which separate: the length is fixed, and the text becomes machine code.

    w = sum C_j^T lambda_j,   u_j' = C_j (alpha_0 + P w) + drift_j,   with the laws of `contact_law`
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.contact_forces import RESOLVED, cold_forces, contact_problem, found_forces
from holdfast.dynamics.contact.proximal_newton import polished
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
    least, k = LEAST_SLIP * maximum(1.0, largest(twist)), len(touching.candidates)
    u = rows.velocity(twist)
    near = [where(gap <= CLOSED, where(one[2] <= least, 1.0, 0.0), 0.0) for gap, one in zip(rows.gap, u, strict=True)]
    free = rows.C @ alpha + rows.drift
    size = largest(closed * x for closed, b in zip(near, free, strict=True) for x in b)

    def of_contact(closed: Scalar, C: Array, b: Array, v: Array) -> tuple[Array, Array, Array]:
        speed = sqrt(v[:2] @ v[:2])
        moves = where(speed > least, closed, 0.0) > 0.0
        slide = where(moves, reciprocal(where(moves, speed, 1.0)), 0.0) * v[:2]
        away = array([0.0, 0.0, SEPARATING * size])
        return select(closed > 0.0, C, 0.0 * C), select(closed > 0.0, b, away), slide

    parts = each(of_contact, near, rows.C, free, u)
    C, b, slide = (array(x) for x in zip(*parts, strict=True))
    problem = contact_problem(mobility, C, b, rows.friction, np.zeros(k), slide, False)
    if start is None:
        forces, residual = cold_forces(problem)
    else:
        forces, residual = polished(problem.contacts, _given(rows, start), WARM, (1.0,))
    found = found_forces(problem, forces, residual)
    failed = where(found.residual <= RESOLVED, 0.0, 1.0)
    slowest = [closed * where(one[2] < -least, 1.0, 0.0) for closed, one in zip(near, u, strict=True)]
    return Pressing(
        rows.in_world(found.force), rows.gap, found.mode, failed, found.residual, found.wrench, largest(slowest)
    )


def _given(rows: ContactRows, start: Array) -> list[Array]:
    """Return forces along contact axes [n, t1, t2]."""
    return [axes[[2, 0, 1]] @ one for axes, one in zip(rows.axes, start, strict=True)]
