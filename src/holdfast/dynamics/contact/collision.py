"""Impulses of a collision, with restitution, by Poisson's law; energy is never gained.

Compression: the contact laws at the velocities, d = P C^T Lambda, y = V- + d. Expansion: every impulse grows by its
coefficient e times one factor g <= 1, V+ = y + g D, D = sum e_j P C_j^T Lambda_j. In the kinetic metric

    |V+|^2 - |V-|^2 = 2 y.d - |d|^2 + 2 g y.D + g^2 |D|^2,    y.d = Lambda . u(y) <= 0

which is not positive at g = 0, so that the largest g <= 1 without a gain exists; it is 1 where all e are equal.
Contacts that approach after the expansion collide again; the last round has e = 0.

References: Glocker, "Set-Valued Force Laws", 2001, ch. 8; Kane, "A dynamics puzzle", 1984 (Newton's law gains energy).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.contact.solve_contacts import solve_contacts
from holdfast.dynamics.contact.solved_contacts import ContactStatus
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

MOST_COLLISIONS = 8
APPROACH = 1e-12  # of the largest velocity before: a slower approach is rounding


@dataclass(frozen=True, eq=False)
class Collision(Frozen):
    """The result of a collision of the object.

    Attributes:
        impulse: (k, 3) of the world on the object, contact axes [t1, t2, n].
        wrench: (6,) their sum about C, world axes.
        change: (6,) of the object's twist.
        velocity: (k, 3) u just after.
        mode: (k,) of the compression, numbers of `ContactMode`; OPEN for contacts that never had an impulse.
        status: the worst of all rounds.
        residual: the largest of all rounds.
        rounds: their number; 0 if nothing approaches.
        energy_change: change of the chain's kinetic energy less the work of a moving world, <= 0.
    """

    impulse: Array
    wrench: Array
    change: Array
    velocity: Array
    mode: Array
    status: ContactStatus
    residual: float
    rounds: int
    energy_change: float


_ORDER = list(ContactStatus)


def impact(
    mobility: ArrayLike,
    rows: ArrayLike,
    velocity: ArrayLike,
    friction: ArrayLike,
    restitution: ArrayLike,
    size: float = 0.0,
) -> Collision:
    """Return the impulses of contacts that approach, and the velocities after them.

    Args:
        mobility: (6, 6) P of the object in the chain, about C, world axes.
        rows: (k, 3, 6) C, [t1, t2, n] of the velocity of the object's contact point, n into the object.
        velocity: (k, 3) relative velocities just before.
        friction: (k,) mu >= 0.
        restitution: (k,) e in [0, 1].
        size: a larger velocity of which these are differences, whose rounding is no approach.

    Raises:
        StateError: a shape is wrong, a number is not finite, or e is not in [0, 1].
    """
    e = np.asarray(restitution, dtype=float)
    k = len(e) if e.ndim == 1 else 1
    C = np.asarray(rows, dtype=float)
    d, r = C.shape[1:] if C.ndim == 3 else (3, 6)
    e, P = checks.numbers(e, (k,), "restitution", StateError), checks.numbers(mobility, (r, r), "mobility", StateError)
    C, before = (
        checks.numbers(rows, (k, d, r), "rows", StateError),
        checks.numbers(velocity, (k, d), "velocity", StateError),
    )
    if k and not (e.min() >= 0.0 and e.max() <= 1.0):
        raise StateError(f"restitution: expected numbers from 0 to 1, got {e[np.argmax(np.abs(e - 0.5))]:g}")
    now, total, mode, gained = before, np.zeros((k, d)), np.zeros(k, int), 0.0
    status, residual, rounds = ContactStatus.OK, 0.0, 0
    limit = APPROACH * np.abs(before).max(initial=size)
    while rounds < MOST_COLLISIONS and now[:, 2].min(initial=0.0) < -limit:
        rounds += 1
        found = solve_contacts(P, C, now, friction)
        status = max(status, found.status, key=_ORDER.index)
        residual = max(residual, found.residual)
        factor, gain = _expansion(P, C, found.force, found.velocity, e if rounds < MOST_COLLISIONS else 0.0 * e)
        mode = np.where(mode == 0, found.mode, mode)
        total = total + factor[:, None] * found.force
        gained += gain
        now = before + C @ (P @ np.einsum("kia,ki->a", C, total))
    wrench = np.einsum("kia,ki->a", C, total)
    return Collision(total, wrench, P @ wrench, now, mode, status, residual, rounds, gained)


def _expansion(P: Array, C: Array, impulse: Array, u: Array, e: Array) -> tuple[Array, float]:
    """Return the factors 1 + g e of the impulses of a compression, and the change of the kinetic energy."""
    grown = e[:, None] * impulse
    d, D = (np.einsum("kia,ki->a", C, x) for x in (impulse, grown))
    square, along = float(D @ P @ D), float((grown * u).sum())
    constant = min(2.0 * float((impulse * u).sum()) - float(d @ P @ d), 0.0)
    g = 1.0
    if square + 2.0 * along + constant > 0.0:
        g = min(1.0, max(0.0, (np.sqrt(max(along * along - square * constant, 0.0)) - along) / square))
    return 1.0 + g * e, 0.5 * (g * g * square + 2.0 * g * along + constant)
