"""Contact forces by a fixed number of steps: the path of an interior point, then Newton's method.

This is the text that machine code runs; `solve_contacts` adds what takes decisions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.contact_law import (
    ReducedContact,
    reduced_contacts,
    size_of,
    tangents_first,
    unknown,
    violation,
)
from holdfast.dynamics.contact.interior_path import FAST, path_forces
from holdfast.dynamics.contact.proximal_newton import COMPLIANCES, polished
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.spatial.scalar import Array, Scalar, array, each, sqrt, where
from holdfast.spatial.vector import largest

RESOLVED = 1e-9  # violation of the laws, relative to the free velocities, that is accepted
STILL = 1e-9  # slip, relative to the free velocities, that is rounding
FULL = 1.0 - 1e-9  # part of mu lambda_n from which a contact may slip


class ContactProblem(NamedTuple):
    """The contacts of the object, reduced to its freedoms.

    Attributes:
        L: (6, 6) P = L L^T.
        rows: (k, 3, 6) C.
        contacts: the contacts in z.
        compliant: whether any contact has a compliance.
    """

    L: Array
    rows: Array
    contacts: list[ReducedContact]
    compliant: bool = False


class FoundForces(NamedTuple):
    """Forces found for a problem, with the fields of `ContactSolution`."""

    force: Array
    wrench: Array
    change: Array
    velocity: Array
    mode: Array
    residual: Scalar


def contact_problem(
    mobility: Array, rows: Array, free: Array, friction: Array, compliance: Array, slide: Array, compliant: bool
) -> ContactProblem:
    """Return the reduced problem; see `reduced_contacts`."""
    L, contacts = reduced_contacts(mobility, rows, free, friction, compliance, slide)
    return ContactProblem(L, rows, contacts, compliant)


def cold_forces(problem: ContactProblem, compliances: tuple[float, ...] = COMPLIANCES) -> tuple[list[Array], Scalar]:
    """Return the forces in axes [n, t1, t2] without a start, and how far they are from the laws. O(k)."""
    return polished(problem.contacts, path_forces(problem.contacts, FAST, problem.compliant), compliances)


def found_forces(problem: ContactProblem, forces: list[Array], residual: Scalar = None) -> FoundForces:
    """Return the motion with forces in axes [n, t1, t2].

    Args:
        problem: the problem.
        forces: (3,) of every contact; of a contact that slides already, the normal force.
        residual: their violation of the laws, if it is known.
    """
    z, contacts = unknown(problem.contacts, forces), problem.contacts
    size = largest(size_of(c) for c in contacts)

    def of_contact(c: ReducedContact, x: Array) -> tuple[Array, Array, Scalar]:
        u, whole = c.velocity(z), c.whole_force(x)
        slides_already = (c.slide @ c.slide) > 0.0
        full = sqrt(x[1:] @ x[1:]) > (FULL * c.friction) * x[0]
        moves = sqrt(u[1:] @ u[1:]) > STILL * size
        held = where(full, where(moves, int(ContactMode.SLIPS), int(ContactMode.STICKS)), int(ContactMode.STICKS))
        closed = where(c.friction > 0.0, held, where(slides_already, int(ContactMode.SLIPS), int(ContactMode.CLOSED)))
        return tangents_first(whole), tangents_first(u), where(x[0] > 0.0, closed, int(ContactMode.OPEN))

    parts = each(of_contact, contacts, forces)
    none = np.zeros(problem.rows[0].shape[1])
    wrench = sum((force @ C for (force, *_), C in zip(parts, problem.rows, strict=True)), none)
    return FoundForces(
        array([force for force, *_ in parts]),
        wrench,
        problem.L @ z,
        array([u for _, u, _ in parts]),
        array([mode for *_, mode in parts]),
        violation(contacts, forces) if residual is None else residual,
    )
