"""The forces of all contacts of the object with the world, with a status; floats."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.contact.contact_forces import (
    RESOLVED,
    ContactProblem,
    cold_forces,
    contact_problem,
    found_forces,
)
from holdfast.dynamics.contact.gauss_seidel import swept_forces
from holdfast.dynamics.contact.interior_path import CAUTIOUS
from holdfast.dynamics.contact.proximal_newton import polished
from holdfast.dynamics.contact.solved_contacts import ContactSolution, ContactStatus
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.spatial.scalar import Array


@np.errstate(all="ignore")  # a step that overflows is not taken
def solve_contacts(
    mobility: ArrayLike,
    rows: ArrayLike,
    free: ArrayLike,
    friction: ArrayLike,
    *,
    compliance: ArrayLike | None = None,
    slide: ArrayLike | None = None,
    start: ArrayLike | None = None,
) -> ContactSolution:
    """Return the forces that satisfy Signorini's and Coulomb's laws, and the motion with them.

    Args:
        mobility: (6, 6) P, the object's mobility in the chain, about C, world axes.
        rows: (k, 3, 6) C, [t1, t2, n] of the velocity of the object's contact point, n into the object.
        free: (k, 3) b, relative velocity (with impulses) or acceleration (with forces) without contact forces.
        friction: (k,) mu >= 0.
        compliance: (k,) velocity, or acceleration, that a unit of force gives way; 0 by default: rigid.
        slide: (k, 2) for accelerations: unit directions [t1, t2] in which contacts slide already, 0 for those at rest.
        start: (k, 3) forces of a similar problem in contact axes, which are tried first.

    Returns:
        A `ContactSolution`. Cost O(k), a fixed number of steps; more only if these do not resolve the problem.

    Raises:
        StateError: a shape is wrong, or a number is not finite.
    """
    problem = _checked(mobility, rows, free, friction, compliance, slide)
    if not problem.contacts:
        none = np.zeros((0, 3))
        return ContactSolution(
            none, np.zeros(6), np.zeros(6), none, np.zeros(0, int), ContactStatus.OK, 0.0, proven=True
        )
    first = None if start is None else checks.numbers(start, (len(problem.contacts), 3), "start", StateError)
    return settled(problem, surely(problem, first))


def surely(problem: ContactProblem, start: Array | None = None) -> list[Array]:
    """Return the forces that violate the laws least: by the last ones, the fast way, the careful way, then sweeps."""
    contacts, tries = problem.contacts, []
    if start is not None:
        tries.append(lambda: polished(contacts, [np.roll(x, 1) for x in start]))
    tries.append(lambda: cold_forces(problem))
    tries.append(lambda: cold_forces(problem, CAUTIOUS))
    tries.append(lambda: polished(contacts, swept_forces(contacts)))
    best, least = [np.zeros(3) for _ in contacts], np.inf
    for attempt in tries:
        forces, off = attempt()
        if off < least:
            best, least = forces, off
        if least <= RESOLVED:
            break
    return best


def settled(problem: ContactProblem, forces: list[Array]) -> ContactSolution:
    """Return the solution with its status."""
    found = found_forces(problem, forces)
    status = ContactStatus.OK if found.residual <= RESOLVED else ContactStatus.UNRESOLVED
    return ContactSolution(**found._asdict() | {"residual": float(found.residual)}, status=status)


def _checked(
    mobility: ArrayLike,
    rows: ArrayLike,
    free: ArrayLike,
    friction: ArrayLike,
    compliance: ArrayLike | None,
    slide: ArrayLike | None,
) -> ContactProblem:
    P = checks.numbers(mobility, (6, 6), "mobility", StateError)
    mu = np.asarray(friction, dtype=float)
    k = len(mu) if mu.ndim == 1 else 1
    mu = checks.numbers(mu, (k,), "friction", StateError)
    C = checks.numbers(rows, (k, 3, 6), "rows", StateError)
    b = checks.numbers(free, (k, 3), "free", StateError)
    give = checks.numbers(np.zeros(k) if compliance is None else compliance, (k,), "compliance", StateError)
    t = checks.numbers(np.zeros((k, 2)) if slide is None else slide, (k, 2), "slide", StateError)
    if k == 0:
        return ContactProblem(np.zeros((6, 6)), C, [])
    if mu.min() < 0.0 or give.min() < 0.0:
        what, worst = ("friction", mu.min()) if mu.min() < 0.0 else ("compliance", give.min())
        raise StateError(f"{what}: expected numbers >= 0, got {worst:g}; try 0 for a contact without it")
    return contact_problem(P, C, b, mu, give, t, compliance is not None)
