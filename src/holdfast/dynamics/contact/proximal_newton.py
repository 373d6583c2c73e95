"""Contact forces to the last digit: Newton's method on contacts of a small compliance whose effect is taken back.

    z = sum along^T x(z),   x_n = max(0, v_n),   x_t = v_t, shortened to mu x_n
    v = (eps held - u) / (eps + compliance)

One Newton step for every eps, after which `held` is the new x (the proximal point method): at its end x = held, and a
rigid contact obeys its law without any compliance. Open contacts get exactly no force, and slipping ones lie exactly
on their cone. The matrix 1 + sum along^T x'(v) B / (eps + compliance) is r x r.

Reference: Carpentier, Montaut and Le Lidec, "From compliant to rigid contact simulation", RSS 2024.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.contact.contact_law import ReducedContact, motion_with, unknown, violation
from holdfast.spatial.linalg import lu, lu_solve
from holdfast.spatial.scalar import (
    Array,
    Scalar,
    array,
    concatenate,
    each,
    maximum,
    reciprocal,
    scan,
    select,
    sqrt,
    where,
)
from holdfast.spatial.vector import outer

COMPLIANCES = (1e-2, 1e-3, 1e-3, 1e-4)  # relative to each contact's mobility
LENGTHS = (1.0, 0.5, 0.2, 0.05)  # of the steps that are tried


class HeldForces(NamedTuple):
    """Forces, z with them, and the velocities of all contacts."""

    held: list[Array]
    z: Array
    u: list[Array]


def polished(
    contacts: list[ReducedContact],
    held: list[Array],
    compliances: tuple[float, ...] = COMPLIANCES,
    lengths: tuple[float, ...] = LENGTHS,
) -> tuple[list[Array], Scalar]:
    """Return the forces that violate the laws least, of all iterates from given ones, and their violation.

    Args:
        contacts: the contacts.
        held: the forces to begin with.
        compliances: of every Newton step, relative to each contact's mobility.
        lengths: of the steps that are tried. Random problems do as well with whole ones; boxes that tumble do not.
    """

    def refined(carry: tuple[HeldForces, list[Array], Scalar], relative: float) -> tuple[Any, None]:
        at, best, least = carry
        at = _newton_step(contacts, at, relative, lengths)
        held = at.held
        now = violation(contacts, held, at.u)
        better = now < least
        return (at, _better(held, best, better), where(better, now, least)), None

    first = HeldForces(held, *motion_with(contacts, held))
    (_, best, least), _ = scan(refined, (first, held, violation(contacts, held, first.u)), compliances)
    return best, least


def _newton_step(
    contacts: list[ReducedContact], at: HeldForces, relative: float, lengths: tuple[float, ...]
) -> HeldForces:
    """Return the forces after one Newton step at a compliance, as long as leaves least of the equation."""
    stiffness = each(lambda c: reciprocal(c.gauge * relative + c.compliance), contacts)

    def pressing(c: ReducedContact, x: Array, stiff: Scalar, u: Array) -> Array:
        return stiff * ((c.gauge * relative) * x - u)

    v = each(pressing, contacts, at.held, stiffness, at.u)
    found = each(lambda c, one: lawful(one, c.friction), contacts, v)
    parts = each(lambda c, one, stiff: c.along.T @ ((stiff * one[1]) @ c.by_z), contacts, found, stiffness)
    factors = lu(np.eye(len(at.z)) + sum(parts))
    step = lu_solve(factors, unknown(contacts, [x for x, _ in found]) - at.z)
    slower = each(lambda c, stiff: stiff * (c.by_z @ step), contacts, stiffness)

    def tried(length: float) -> tuple[list[Array], Array, Scalar]:
        forces = each(lambda c, one, less: lawful_force(one - length * less, c.friction), contacts, v, slower)
        z = unknown(contacts, forces)
        left = at.z + length * step - z
        return forces, z, left @ left

    best, z, least = tried(lengths[0])
    for length in lengths[1:]:
        forces, there, off = tried(length)
        nearer = off < least
        best, z, least = _better(forces, best, nearer), select(nearer, there, z), where(nearer, off, least)
    return HeldForces(best, z, each(lambda c: c.velocity(z), contacts))


def _better(new: list[Array], old: list[Array], chosen: Scalar) -> list[Array]:
    """Return the new forces if they are chosen, else the old ones."""
    return each(lambda a, b: select(chosen, a, b), new, old)


def lawful_force(v: Array, mu: Scalar) -> Array:
    """Return v with its normal part at least 0, and its tangential part at most mu times that."""
    n = maximum(v[0], 0.0)
    size = sqrt(v[1:] @ v[1:])
    ratio = where(size > mu * n, mu * n * reciprocal(where(size > 0.0, size, 1.0)), 1.0)
    return concatenate([[n], ratio * v[1:]])


def lawful(v: Array, mu: Scalar) -> tuple[Array, Array]:
    """Return `lawful_force` and its derivative, a square matrix."""
    n, pressed = maximum(v[0], 0.0), where(v[0] > 0.0, 1.0, 0.0)
    size = sqrt(v[1:] @ v[1:])
    slips = size > mu * n
    inverse = reciprocal(where(size > 0.0, size, 1.0))
    ratio = where(slips, mu * n * inverse, 1.0)
    along = where(slips, inverse, 0.0) * v[1:]
    turning = ratio * pressed * (np.eye(len(along)) - outer(along, along))
    by_normal, across = (mu * pressed) * along, range(len(along))
    D = array(
        [
            [pressed, *(0.0 for _ in across)],
            *([by_normal[i], *(turning[i, j] for j in across)] for i in across),
        ]
    )
    return concatenate([[n], ratio * v[1:]]), D
