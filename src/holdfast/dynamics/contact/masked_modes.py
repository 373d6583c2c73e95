"""Contacts in fixed modes with the modes as numbers, so that one trace serves all modes; see `fixed_modes`.

Open contacts have rows of zeros. Forces in the range of (A P D^T)^T are those of least norm, x = D P K y, K = A^T A:

    K P D^T D P K y = -A^T b

of size 6, corrected by the residuals of the rows themselves, which takes back what squaring costs. What takes decisions
is not answered, but noticed (`lawful`): rows that contradict each other, and loads of sliding contacts that are to be
shared in another way than by least norm. Where nothing slides, another share (`shared`) changes no motion.
"""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.fixed_modes import SLOWEST_SLIP, STOPPED_SPEED, STRAIGHT
from holdfast.dynamics.contact.load_share import CONES, LEAST_BORNE
from holdfast.dynamics.contact.rows import ContactRows
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.spatial.linalg import MaskedLDL, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array, maximum, minimum, select, sqrt, where
from holdfast.spatial.vector import largest

CORRECTIONS = 3  # by the residuals of the rows
ROWS_KEPT = 1e-11  # residual, relative to accelerations of 1 m/s^2 or larger ones, up to which rows are kept
FOREVER = 1e300  # s: no slip turns


class MaskedModes(NamedTuple):
    """What every contact does, 1 or 0 each.

    Attributes:
        closed, sticks, slips: (k,).
    """

    closed: Array
    sticks: Array
    slips: Array

    @classmethod
    def of(cls, mode: Array) -> MaskedModes:
        """Return the masks of numbers of `ContactMode` (k,)."""

        def being(m: Scalar, one: ContactMode) -> Scalar:
            return where(abs(m - float(one.value)) < 0.5, 1.0, 0.0)

        closed = array([1.0 - being(m, ContactMode.OPEN) for m in mode])
        sticks, slips = (array([being(m, one) for m in mode]) for one in (ContactMode.STICKS, ContactMode.SLIPS))
        return cls(closed, sticks, slips)


class ForcesInModes(NamedTuple):
    """The forces of contacts in fixed modes, with the fields of `Touch`.

    Attributes:
        force: (k, 3) contact axes [N].
        wrench: (6,) on the object.
        slip: (k, 3) directions of slip of now, world axes.
        speed: (k,) velocity along the direction of slip before; 0 unless slipping [m/s].
        stops_in: (k,) time in which a slip stops that does not turn; `FOREVER` for others [s].
        turning_time: the shortest time in which a slip may turn; `FOREVER` if none does [s].
        shared: 1 if `load_share` leaves the forces as they are, 0 if it has to be asked.
        lawful: 1 if the motion is that of `touch_with`, 0 if it has to be asked.
    """

    force: Array
    wrench: Array
    slip: Array
    speed: Array
    stops_in: Array
    turning_time: Scalar
    shared: Scalar
    lawful: Scalar


def forces_in_modes(
    rows: ContactRows, P: Array, twist: Array, acceleration: Array, modes: MaskedModes, slip: Array
) -> ForcesInModes:
    """Return the forces of contacts in given modes. O(k).

    Args:
        rows: the contacts.
        P: the object's mobility in the chain.
        twist: (6,) the object's twist.
        acceleration: (6,) its acceleration without contact forces.
        modes: the modes.
        slip: (k, 3) directions of slip at the step's start, world axes.
    """
    k, mu = len(rows.gap), rows.friction
    u = rows.velocity(twist)
    slips = [_slipping(*of) for of in zip(rows.axes, u[:, :2], slip, modes.slips, strict=True)]
    along = array([one[0] for one in slips])
    A, D, b = [], [], []
    for j in range(k):
        masks = (modes.sticks[j], modes.sticks[j], modes.closed[j])
        own = [mask * row for mask, row in zip(masks, rows.C[j], strict=True)]
        push = own[2] - (mu[j] * modes.slips[j]) * (along[j] @ rows.C[j, :2])
        A, D = [*A, *own], [*D, *own[:2], push]
        b += [one @ acceleration + mask * d for mask, one, d in zip(masks, own, rows.drift[j], strict=True)]
    A, D, b = array(A), array(D), array(b)
    x, left = imposed(P, A, D, b)
    wrench = D.T @ x
    moving = acceleration + P @ wrench
    x = x.reshape(k, 3)
    rub = [mu[j] * modes.slips[j] * x[j, 2] for j in range(k)]
    force = array([[*(x[j, :2] - rub[j] * along[j]), x[j, 2]] for j in range(k)])
    size = maximum(largest(b), 1.0)
    kept = where(left <= ROWS_KEPT * size, 1.0, 0.0)
    redundant = sum(modes.closed) + 2.0 * sum(modes.sticks) - _factors(D.T @ D).kept
    shared = maximum(where(redundant < 0.5, 1.0, 0.0), _within_cones(force, mu, modes))
    lawful = kept * maximum(shared, where(sum(modes.slips) < 0.5, 1.0, 0.0))
    turned = [
        _turning(rows.C[j, :2], P, u[j, :2], moving, rows.drift[j, :2], mu[j] * x[j, 2], slips[j][2], modes.slips[j])
        for j in range(k)
    ]
    speed, stops = (array([one[i] for one in turned]) for i in range(2))
    turning_time = reduce(minimum, [one[2] for one in turned], FOREVER)
    return ForcesInModes(force, wrench, array([one[1] for one in slips]), speed, stops, turning_time, shared, lawful)


def gap_closing(rows: ContactRows, P: Array, modes: MaskedModes) -> Array:
    """Return the impulse (6,) on the object that moves it onto the closed contacts; see `fixed_modes.on_contacts`."""
    A = (modes.closed * rows.C[:, 2].T).T
    return A.T @ imposed(P, A, A, modes.closed * rows.gap)[0]


def slip_removing(rows: ContactRows, P: Array, twist: Array, modes: MaskedModes) -> tuple[Array, Scalar]:
    """Return the impulse (6,) on the object that removes velocities at contacts in fixed modes, and what is left."""
    masks = array([[s, s, c] for s, c in zip(modes.sticks, modes.closed, strict=True)])
    A, of_world = (masks[..., None] * rows.C).reshape(-1, 6), (masks * rows.carried).reshape(-1)
    x, left = imposed(P, A, A, A @ twist - of_world)
    return A.T @ x, left


def imposed(P: Array, A: Array, D: Array, b: Array) -> tuple[Array, Scalar]:
    """Return x of least norm with A P D^T x = -b, and the largest residual."""
    F = D @ (P @ (A.T @ A))
    factors, x, left = _factors(F.T @ F), np.zeros(len(b)), b
    for _ in range(CORRECTIONS):
        x = x - F @ ldl_solve(factors, A.T @ left)
        left = b + A @ (P @ (D.T @ x))
    return x, largest(left)


def _factors(S: Array) -> MaskedLDL:
    return ldl(S, array([S[i, i] for i in range(len(S))]))


def _slipping(axes: Array, t: Array, slip: Array, slips: Scalar) -> tuple[Array, Array, Scalar]:
    """Return the direction of friction in contact axes, that of the slip of now in world axes, and the slip speed."""
    before = axes[:2] @ slip
    speed, size, length = t @ before, sqrt(t @ t), sqrt(before @ before)
    own = slips * where(size > SLOWEST_SLIP, 1.0, 0.0)
    unit = select(own > 0.5, t / where(own > 0.5, size, 1.0), before / where(length > 0.0, length, 1.0))
    along = select(unit @ before >= 0.0, unit, -unit)
    now = select(own * where(speed > 0.0, 1.0, 0.0) > 0.5, unit @ axes[:2], slip)
    return along, now, slips * speed


def _within_cones(force: Array, mu: Array, modes: MaskedModes) -> Scalar:
    """Return 1 if forces of least norm lie so far within the cones that `load_share` leaves them as they are."""
    count = sum(modes.closed)
    mean = sum(abs(one[2]) for one in force) / where(count > 0.5, count, 1.0)
    apex, found = LEAST_BORNE * (1.0 - CONES[0]) * mean, 1.0
    for j, one in enumerate(force):
        room = one[2] - apex
        outside = where(room >= 0.0, 0.0, modes.closed[j])
        if mu[j] > 0.0:
            wide = sqrt(one[:2] @ one[:2]) <= CONES[0] * mu[j] * room
            outside = maximum(outside, where(wide, 0.0, modes.sticks[j]))
        found = minimum(found, 1.0 - outside)
    return found


def _turning(
    C: Array, P: Array, t: Array, moving: Array, drift: Array, grip: Scalar, speed: Scalar, slips: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Return `Touch.slip_speed`, `Touch.stops_in` and `Touch.turning_time` of a contact; see `fixed_modes`.

    Args:
        C: (2, 6) tangential rows.
        P: the object's mobility.
        t: (2,) slip.
        moving: (6,) the object's acceleration.
        drift: (2,) of the rows.
        grip: mu lambda_n [N].
        speed: along the slip before.
        slips: 1 if the contact slips, else 0.
    """
    (p, q), (_, r) = C @ P @ C.T
    given = grip * (0.5 * (p + r) + sqrt(0.25 * (p - r) * (p - r) + q * q))
    a, square = C @ moving + drift, t @ t
    size, towards = sqrt(square), t @ a
    across = a - (towards / where(square > 0.0, square, 1.0)) * t
    moves = slips * where(minimum(size, given) > 0.0, 1.0, 0.0)
    turns = where(size * sqrt(across @ across) <= STRAIGHT * given, 0.0, moves)
    brakes = (moves - turns) * where(towards < 0.0, 1.0, 0.0) > 0.5
    stops = where(brakes, square / where(brakes, -towards, 1.0), FOREVER)
    follows = turns * where(size > STOPPED_SPEED, 1.0, 0.0) > 0.5
    time = where(follows, size / where(follows, maximum(given, sqrt(a @ a)), 1.0), FOREVER)
    ends = turns * where(size > STOPPED_SPEED, 0.0, 1.0) * where(towards < 0.0, 1.0, 0.0)
    return where(ends > 0.5, minimum(speed, size - STOPPED_SPEED), speed), stops, time
