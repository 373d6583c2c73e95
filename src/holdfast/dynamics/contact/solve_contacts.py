"""The forces of all contacts of the object with the world, with a status; floats."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.contact.contact_forces import (
    RESOLVED,
    ContactProblem,
    cold_forces,
    contact_problem,
    found_forces,
)
from holdfast.dynamics.contact.contact_law import ReducedContact, normal_first, unknown
from holdfast.dynamics.contact.faceted_cones import faceted_forces
from holdfast.dynamics.contact.gauss_seidel import swept_forces
from holdfast.dynamics.contact.interior_path import CAUTIOUS, path_forces
from holdfast.dynamics.contact.other_motions import all_motions, forces_with
from holdfast.dynamics.contact.proximal_newton import polished
from holdfast.dynamics.contact.solved_contacts import ContactSolution, ContactStatus
from holdfast.dynamics.contact.uniqueness import (
    ActiveRows,
    LoadFreedoms,
    active_rows,
    added,
    largest_load,
    load_freedoms,
    of_equal_compliances,
    pressing_sets,
    proven_unique,
    squeezing_forces,
    unique_forces,
)
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.spatial.scalar import Array

SOFT = 1e-8  # compliance of all contacts, relative to their mobilities
THOROUGH = (1e-2, 1e-2, 1e-3, 1e-3, 1e-4, 1e-4)  # compliances of Newton's steps in the slower ways
PATIENT = (1e-1,) * 5 + (1e-2,) * 10 + (1e-3, 1e-3, 1e-4, 1e-4)
LONGEST_POLISH = (1e-2,) * 10 + (1e-3,) * 10 + (1e-4,) * 10 + (1e-5,) * 10
LOADS = (1.0, 0.5)  # of the largest change of loads that keeps the forces in their cones
SAME_MOTION = 1e-7  # motions that differ less, relative to the free velocities, are one


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
        mobility: (6, 6) P, the object's mobility in the chain, about C, world axes; (r, r) with other bodies, such as
            hands that slide.
        rows: (k, 3, r) C, [t1, t2, n] of the velocity of the object's contact point, n into the object. (k, 4, r) with
            a spin of each contact about its normal, times its torsion radius; 0 for one at a point.
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
        none, still = np.zeros(problem.rows.shape[:2]), np.zeros(problem.rows.shape[2])
        return ContactSolution(none, still, still, none, np.zeros(0, int), ContactStatus.OK, 0.0, proven=True)
    first = None if start is None else checks.numbers(start, problem.rows.shape[:2], "start", StateError)
    return settled(problem, surely(problem, first))


def surely(problem: ContactProblem, start: Array | None = None) -> list[Array]:
    """Return the forces that violate the laws least of all ways that are tried, in turn, until one resolves them."""
    best, least = [0.0 * c.free for c in problem.contacts], np.inf
    for _, forces, off in ways(problem, start):
        if off < least:
            best, least = forces, off
        if least <= RESOLVED:
            break
    return best


def ways(problem: ContactProblem, start: Array | None = None) -> Iterator[tuple[str, list[Array], float]]:
    """Yield forces and their violation of the laws: from given ones, the fast way, then ever slower and surer ways.

    The last one goes on from the best forces of all, in many more steps.
    """
    best, least = [0.0 * c.free for c in problem.contacts], np.inf
    for way, forces, off in _each_way(problem, start):
        if off < least:
            best, least = forces, off
        yield way, forces, off
    yield "longer", *polished(problem.contacts, best, LONGEST_POLISH)


def _each_way(problem: ContactProblem, start: Array | None) -> Iterator[tuple[str, list[Array], float]]:
    contacts = problem.contacts
    if start is not None:
        yield "warm", *polished(contacts, [normal_first(x) for x in start])
    yield "fast", *cold_forces(problem)
    yield "careful", *polished(contacts, path_forces(contacts, CAUTIOUS, problem.compliant), THOROUGH)
    soft = [c._replace(compliance=c.compliance + SOFT * c.gauge) for c in contacts]  # internal forces stay finite
    yield "soft", *polished(contacts, path_forces(soft, CAUTIOUS, True), PATIENT)
    for forces in faceted_forces(contacts) if problem.rows.shape[1] == 3 else ():
        yield "facets", *polished(contacts, forces, THOROUGH)
    yield "sweeps", *polished(contacts, swept_forces(contacts), LONGEST_POLISH)


def settled(problem: ContactProblem, forces: list[Array]) -> ContactSolution:
    """Return the solution with its status; see `uniqueness`."""
    contacts = problem.contacts
    sliding = any(c.slide.any() for c in contacts)
    sets = pressing_sets(contacts) if sliding else None
    found = found_forces(problem, forces)
    if sets and not found.residual <= RESOLVED:
        forces = sets[0]
        found = found_forces(problem, forces)
    if sets == [] or not found.residual <= RESOLVED:
        jammed = sets == [] or squeezing_forces(contacts) is not None
        return _solution(problem, forces, ContactStatus.JAMMED if jammed else ContactStatus.UNRESOLVED)
    proven = proven_unique(contacts) or (sets is not None and _count(problem, sets) == 1)
    active = active_rows(contacts, forces, np.array([normal_first(u) for u in found.velocity]), found.mode)
    freedoms = load_freedoms(active)
    if freedoms.null.shape[1]:
        forces = _smaller(contacts, active, freedoms, forces)
    if proven:
        return _solution(problem, forces, _of_loads(active), proven=True)
    others = sets or _other_solutions(problem, active, freedoms, forces)
    changes = np.array([problem.L @ unknown(contacts, one) for one in [forces, *others]])
    if _count(problem, [forces, *others]) > 1:
        span = np.array([changes.min(axis=0), changes.max(axis=0)])
        return _solution(problem, forces, ContactStatus.AMBIGUOUS, span=span)
    return _solution(problem, forces, _of_loads(active))


def _smaller(
    contacts: list[ReducedContact], active: ActiveRows, freedoms: LoadFreedoms, forces: list[Array]
) -> list[Array]:
    """Return the forces of equal compliances, or else small ones of the same motion, if these satisfy the laws."""
    rigid = all(c.compliance == 0.0 for c in contacts)
    small = forces_with(contacts, unknown(contacts, forces)) if rigid else None
    for chosen in (of_equal_compliances(active, freedoms, forces), small):
        if chosen is not None:
            lawful, off = polished(contacts, chosen)
            if off <= RESOLVED:
                return lawful
    return forces


def _of_loads(active: ActiveRows) -> ContactStatus:
    return ContactStatus.OK if unique_forces(active) else ContactStatus.INDETERMINATE_FORCES


def _other_solutions(
    problem: ContactProblem, active: ActiveRows, freedoms: LoadFreedoms, forces: list[Array]
) -> list[list[Array]]:
    """Return further forces that satisfy the laws: along the free loads, and of other modes."""
    contacts = problem.contacts
    starts = list(all_motions(contacts))
    for direction in freedoms.moving.T:
        for change in (direction, -direction):
            most = largest_load(active, contacts, forces, change)
            if np.isfinite(most):
                starts += [added(active, forces, part * most * change) for part in LOADS]
    return [found for found, off in (polished(contacts, one) for one in starts) if off <= RESOLVED]


def _count(problem: ContactProblem, solutions: list[list[Array]]) -> int:
    """Return how many motions the given forces cause."""
    rows = np.concatenate([c.by_z / np.sqrt(c.gauge) for c in problem.contacts])
    free = np.concatenate([c.free / np.sqrt(c.gauge) for c in problem.contacts])
    motions: list[Array] = []
    for one in solutions:
        u = rows @ unknown(problem.contacts, one)
        if all(np.abs(u - other).max() > SAME_MOTION * np.abs(free).max() for other in motions):
            motions.append(u)
    return len(motions)


def _solution(
    problem: ContactProblem, forces: list[Array], status: ContactStatus, span: Array | None = None, proven: bool = False
) -> ContactSolution:
    found = found_forces(problem, forces)
    return ContactSolution(
        found.force,
        found.wrench,
        found.change,
        found.velocity,
        found.mode,
        status,
        float(found.residual),
        span,
        proven,
    )


def _checked(
    mobility: ArrayLike,
    rows: ArrayLike,
    free: ArrayLike,
    friction: ArrayLike,
    compliance: ArrayLike | None,
    slide: ArrayLike | None,
) -> ContactProblem:
    C = np.asarray(rows, dtype=float)
    d, r = C.shape[1:] if C.ndim == 3 and C.shape[1] in (3, 4) and C.shape[2] >= 6 else (3, 6)
    P = checks.numbers(mobility, (r, r), "mobility", StateError)
    mu = np.asarray(friction, dtype=float)
    k = len(mu) if mu.ndim == 1 else 1
    mu = checks.numbers(mu, (k,), "friction", StateError)
    C = checks.numbers(rows, (k, d, r), "rows", StateError)
    b = checks.numbers(free, (k, d), "free", StateError)
    give = checks.numbers(np.zeros(k) if compliance is None else compliance, (k,), "compliance", StateError)
    t = checks.numbers(np.zeros((k, d - 1)) if slide is None else slide, (k, d - 1), "slide", StateError)
    if k == 0:
        return ContactProblem(np.zeros((r, r)), C, [])
    if mu.min() < 0.0 or give.min() < 0.0:
        what, worst = ("friction", mu.min()) if mu.min() < 0.0 else ("compliance", give.min())
        raise StateError(f"{what}: expected numbers >= 0, got {worst:g}; try 0 for a contact without it")
    return contact_problem(P, C, b, mu, give, t, compliance is not None)
