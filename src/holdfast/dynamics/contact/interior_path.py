"""Contact forces by an interior point in the object's freedoms, a fixed number of steps.

With D = diag(1, mu, mu), x = D^-1 lambda and y = D u + mu |u_t| n, both in the cone s_0 >= |s_1|, Coulomb's law is
x o y = 0, o the cone's product (De Saxce). Nothing is divided by mu. The path x o y = kappa [1, 0, 0] is followed to a
small kappa with Newton's matrix of the whole equations

    y = D u + s n,   s = sqrt(|mu u_t|^2 + smooth^2),   u = b + B z + compliance lambda,   z = sum along^T lambda

including the derivative of s, E = 1 + n (mu u_t / s)^T. In Nesterov and Todd's scaling, W y = W^-1 x, H = W^2:

    (1 + sum along^T D H E D B) dz = right-hand side,      r x r

`smooth` is a part of kappa, but of a large kappa no more than of 0.3: forces that grew made kappa, with it y, and with
y the forces grow without end. Begun at x = y = [1, 0, 0], closer to the cone's boundary, more paths end too soon.

Without friction the matrix is positive definite. With friction a path may turn back, where the matrix is singular and
steps become ever shorter. After a short step E is taken with a part of its coupling, which leads past some of these.

References: Mehrotra, "On the implementation of a primal-dual interior point method", 1992; Nesterov and Todd,
"Self-scaled barriers and interior-point methods for convex programming", 1997.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.contact_law import TINY, ReducedContact
from holdfast.spatial.linalg import lu, lu_solve
from holdfast.spatial.scalar import (
    Array,
    Scalar,
    array,
    concatenate,
    each,
    maximum,
    minimum,
    reciprocal,
    scan,
    select,
    sqrt,
    where,
)
from holdfast.spatial.second_order_cone import ConeScaling, cone_scaling, step_rate
from holdfast.spatial.vector import largest, outer

LARGEST_DIRECTION = 1e100  # step of z that is taken
LEAST_PRODUCT = 1e-10  # kappa at which the path ends
STARTING_NORMAL = 2.0  # x_n and y_n at its start
LARGEST_SMOOTHED = 0.3  # kappa to which the rounding of |u_t| grows
SHORT_STEP = 0.3  # length of a step after which the coupling in E is reduced
REDUCED = 0.8  # part of it that is left


class PathPace(NamedTuple):
    """How the path is followed.

    Attributes:
        steps: their number.
        smooth: part of kappa by which |u_t| is rounded at 0.
        least: part of kappa that a step aims at, at least.
        fraction: of the way to the boundary.
    """

    steps: int
    smooth: float
    least: float
    fraction: float


FAST = PathPace(15, 0.03, 0.1, 0.9)
CAUTIOUS = PathPace(80, 0.05, 0.6, 0.7)


class ConePoint(NamedTuple):
    """A point near the path: z, D u by z alone, x and y of every contact inside of the cone, and the last step."""

    z: Array
    u: list[Array]
    x: list[Array]
    y: list[Array]
    length: Scalar


class ScaledContact(NamedTuple):
    """A contact in units of its own mobility and of the largest free velocity.

    Attributes:
        by_z: (3, r) D B.
        along: (3, r) rows of z by x, D along.
        free: (3,) D b.
        softness: (3,) D^2 compliance.
    """

    by_z: Array
    along: Array
    free: Array
    softness: Array


class Linearised(NamedTuple):
    """A contact's equations at a point, dx + H dy = -x - H wanted and dy = gap + E (B dz + softness dx).

    Attributes:
        scaling: of Nesterov and Todd.
        square: (3, 3) W^2.
        coupling: (2,) mu u_t / s, or a part of it, the row of E below its normal.
        gap: (3,) D u + s n - y.
        soft: factors of 1 + H E softness.
        part: (r, r) along^T (1 + H E softness)^-1 H E B.
    """

    scaling: ConeScaling
    square: Array
    coupling: Array
    gap: Array
    soft: tuple[Array, Array] | None
    part: Array


def path_forces(contacts: list[ReducedContact], pace: PathPace = FAST, compliant: bool = False) -> list[Array]:
    """Return the forces of all contacts at the end of the path.

    Args:
        contacts: the contacts.
        pace: how the path is followed.
        compliant: whether any contact has a compliance.
    """
    roots = each(lambda c: sqrt(c.gauge), contacts)
    stretches = each(lambda c: array([1.0, *[c.friction] * (len(c.free) - 1)]), contacts)
    unit = TINY + largest(
        entry * reciprocal(g) for c, D, g in zip(contacts, stretches, roots, strict=True) for entry in D * c.free
    )

    def scaled(c: ReducedContact, D: Array, root: Scalar) -> ScaledContact:
        per = D * reciprocal(root)
        return ScaledContact(
            (per * c.by_z.T).T, (per * c.along.T).T, per * c.free * reciprocal(unit), per * per * c.compliance
        )

    own = each(scaled, contacts, stretches, roots)
    inside = [STARTING_NORMAL * np.eye(len(contacts[0].free))[0]] * len(contacts)
    start = ConePoint(0.0 * contacts[0].by_z[0], [c.free for c in own], inside, inside, 1.0)
    last, _ = scan(lambda at, _: (_advanced(own, pace, at, compliant), None), start, [None] * pace.steps)
    return each(lambda D, root, x: (unit * reciprocal(root)) * (D * x), stretches, roots, last.x)


def _advanced(contacts: list[ScaledContact], pace: PathPace, at: ConePoint, compliant: bool) -> ConePoint:
    """Return the next point: Mehrotra's predictor and corrector with one matrix."""
    kappa = sum(x @ y for x, y in zip(at.x, at.y, strict=True)) * (1.0 / len(contacts))
    smooth = pace.smooth * minimum(kappa, LARGEST_SMOOTHED)
    part = where(at.length < SHORT_STEP, REDUCED, 1.0)
    of = each(lambda c, u, x, y: _linearised(c, u, x, y, smooth, part, compliant), contacts, at.u, at.x, at.y)
    factors = lu(np.eye(len(at.z)) + sum(one.part for one in of))

    def direction(wanted: list[Array]) -> tuple[Array, list[Array], list[Array], list[Array]]:
        """Return dz, du = B dz, dx and dy with dx + H dy = -x - H wanted."""
        alone = each(lambda one, x, more: _force_change(one, x, one.gap + more), of, at.x, wanted)
        dz = lu_solve(factors, sum((x + dx) @ c.along for c, x, dx in zip(contacts, at.x, alone, strict=True)) - at.z)
        ends = each(lambda c, one, x, more: _step(c, one, x, more, dz), contacts, of, at.x, wanted)
        return dz, [du for du, *_ in ends], [dx for _, dx, _ in ends], [dy for *_, dy in ends]

    def longest(dx: list[Array], dy: list[Array], share: float) -> Scalar:
        """Return the step, at most 1, that goes a share of the way to the boundary."""
        rates = each(_rates, of, at.x, at.y, dx, dy)
        worst = 0.0
        for rate in rates:
            worst = maximum(worst, rate)
        return minimum(1.0, share * reciprocal(maximum(worst, 0.5 * share)))

    _, _, dx, dy = direction([np.zeros(len(at.x[0]))] * len(contacts))
    less = 1.0 - longest(dx, dy, 1.0)
    target = maximum(maximum(less * less * less, pace.least) * kappa, LEAST_PRODUCT)
    dz, du, dx, dy = direction(each(lambda one, a, b: one.scaling.corrected(a, b, target), of, dx, dy))
    length = longest(dx, dy, pace.fraction)
    moves = where(largest(dz) < LARGEST_DIRECTION, length, 0.0) > 0.0  # what is not finite is not taken

    def moved(old: Array, change: Array) -> Array:
        return select(moves, old + length * change, old)

    return ConePoint(moved(at.z, dz), each(moved, at.u, du), each(moved, at.x, dx), each(moved, at.y, dy), length)


def _linearised(
    c: ScaledContact, u: Array, x: Array, y: Array, smooth: Scalar, part: Scalar, compliant: bool
) -> Linearised:
    if compliant:
        u = u + c.softness * x
    s = sqrt(u[1:] @ u[1:] + smooth * smooth)
    coupling = (part * reciprocal(s)) * u[1:]
    W = cone_scaling(x, y)
    H = W.square
    HE = array([H[0], *(H[1:] + outer(coupling, H[0]))]).T  # H is symmetric
    T, soft = HE @ c.by_z, None
    if compliant:
        soft = lu(np.eye(len(x)) + HE * c.softness)
        T = lu_solve(soft, T)
    gap = concatenate([[u[0] + s - y[0]], u[1:] - y[1:]])
    return Linearised(W, H, coupling, gap, soft, c.along.T @ T)


def _force_change(one: Linearised, x: Array, dy: Array) -> Array:
    """Return dx with a dy that lacks the effect of dx itself."""
    dx = -x - one.square @ dy
    return dx if one.soft is None else lu_solve(one.soft, dx)


def _step(c: ScaledContact, one: Linearised, x: Array, wanted: Array, dz: Array) -> tuple[Array, Array, Array]:
    """Return du, dx and dy."""
    du = c.by_z @ dz
    dy = one.gap + _coupled(one, du)
    dx = _force_change(one, x, dy + wanted)
    return du, dx, dy if one.soft is None else dy + _coupled(one, c.softness * dx)


def _coupled(one: Linearised, du: Array) -> Array:
    """Return E du."""
    return concatenate([[du[0] + one.coupling @ du[1:]], du[1:]])


def _rates(one: Linearised, x: Array, y: Array, dx: Array, dy: Array) -> Scalar:
    return maximum(step_rate(x, one.scaling.of_s, dx), step_rate(y, one.scaling.of_z, dy))
