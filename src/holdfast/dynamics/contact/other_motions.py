"""All motions that the laws of contact allow, of few contacts, by trying which of them stick and which slip; floats.

Sticking contacts S leave z = z_S + Z y, where Z is a basis of the null space of their rows. Slipping ones T press with
x_j along n_j - mu_j t_j, so that y = Z^T sum x_j N_j, and their normal velocities of zero are |T| equations for x:

    B_n Z Z^T N(t)^T x = -(b_n + B_n z_S)

If one direction t = (cos a, sin a) is unknown, it enters one column. By Cramer's rule det(a) u_t is linear in t, and
det(a) t x u_t = 0 is a trigonometric polynomial of degree 2: its zeros are among the roots of a quartic. Two unknown
directions are zeros of two such polynomials, hence of their resultant. For three, Newton's method goes on from two,
with a grid of the third. A motion counts if forces exist in the cones of the contacts that stand still, and on the rays
of those that slip, see `within_cones`, and if they satisfy the laws.

Not looked for: four or more directions at once, two if more than three contacts rub, and slips whose normals depend on
each other. Cost O(k^4) for up to `MOST_SEARCHED` contacts, each of a fraction of a millisecond.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, combinations, product
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.contact_law import ReducedContact, tangents_first, violation
from holdfast.dynamics.contact.load_share import within_cones
from holdfast.dynamics.contact.proximal_newton import lawful_force
from holdfast.spatial.scalar import Array

MOST_SEARCHED = 6  # contacts
MOST_STICKING = 3  # contacts whose rows fix a motion
FEW = 3  # contacts that rub, of which all directions are tried together
THIRDS = 12  # directions of a third slip that are tried
NEWTON_STEPS = 6
NO_COEFFICIENT = 1e-14  # of a coefficient, relative to the largest
ON_CIRCLE = 1e-2  # distance of a root from the unit circle that is rounding, with room for double roots
LONGEST_TURN = 0.3  # rad, of a Newton step
INDEPENDENT_ROWS = 1e-9  # singular values below this, relative to the largest, count as zero
NO_SPEED = 1e-8  # velocity, relative to the free ones, that is rounding
NEARLY = 1e-6  # violation of the laws from which Newton's method goes on


_At = Callable[[Array], tuple[Array, Array]]


class _Contacts(NamedTuple):
    """Contacts in arrays; components [n, t1, t2]."""

    by_z: Array
    along: Array
    free: Array
    friction: Array
    given: Array

    @property
    def size(self) -> float:
        return float(np.abs(self.free).max())


class _Standing(NamedTuple):
    """What sticking contacts leave: z = z_S + Z y."""

    z: Array
    Z: Array


def all_motions(contacts: list[ReducedContact]) -> Iterator[list[Array]]:
    """Yield forces, axes [n, t1, t2], of every motion that is found, some of them several times.

    Args:
        contacts: the contacts; nothing is found if there are too many, or one has a compliance.
    """
    if len(contacts) > MOST_SEARCHED or any(c.compliance > 0.0 for c in contacts):
        return
    of = _in_arrays(contacts)
    rubbing, given = np.flatnonzero(~of.given).tolist(), np.flatnonzero(of.given).tolist()
    most = 0 if of.free.shape[1] > 3 else FEW if len(rubbing) <= FEW else 1  # patches turn in three directions
    seen: list[Array] = []
    for S in _subsets(rubbing, MOST_STICKING):
        standing = _standing(of, S)
        if standing is None:
            continue
        free = standing.Z.shape[1]
        rest = [j for j in rubbing if j not in S]
        for K, X in product(_subsets(given, free), _subsets(rest, min(most, free))):
            if len(K) + len(X) > free:
                continue
            for z in _slipping(of, standing, [*K, *X], len(X)):
                if np.isfinite(z).all() and all(np.abs(of.by_z @ (z - one)).max() > NO_SPEED * of.size for one in seen):
                    seen.append(z)
                    forces = _forces_with(of, z)
                    if forces is not None and violation(contacts, forces) < NEARLY:
                        yield forces


def forces_with(contacts: list[ReducedContact], z: Array) -> list[Array] | None:
    """Return forces with which a motion satisfies the laws, small ones if they are not unique; None if there are none.

    Args:
        contacts: the contacts, axes [n, t1, t2], rigid ones.
        z: the motion.
    """
    return _forces_with(_in_arrays(contacts), z)


def _in_arrays(contacts: list[ReducedContact]) -> _Contacts:
    friction = np.array([float(c.friction) for c in contacts])
    by_z, along, free = (np.array([getattr(c, name) for c in contacts]) for name in ("by_z", "along", "free"))
    return _Contacts(by_z, along, free, friction, friction == 0.0)


def _subsets(of: list[int], most: int) -> list[list[int]]:
    return [list(one) for one in chain(*(combinations(of, n) for n in range(min(len(of), most) + 1)))]


def _standing(of: _Contacts, S: list[int]) -> _Standing | None:
    """Return the motions in which some contacts stick; None if there are none."""
    r = of.by_z.shape[2]
    if not S:
        return _Standing(np.zeros(r), np.eye(r))
    rows, b = of.by_z[S].reshape(-1, r), of.free[S].ravel()
    U, s, Vt = np.linalg.svd(rows)
    rank = int((s > INDEPENDENT_ROWS * s[0]).sum())
    z = -Vt[:rank].T @ ((U[:, :rank].T @ b) / s[:rank])
    return None if np.abs(rows @ z + b).max() > NO_SPEED * of.size else _Standing(z, Vt[rank:].T)


def _slipping(of: _Contacts, standing: _Standing, T: list[int], unknown: int) -> list[Array]:
    """Return the motions in which contacts T slip, the last ones in unknown directions, and no other one presses."""
    if not T:
        return [standing.z]
    last = T[len(T) - unknown :]

    def at(angles: Array) -> tuple[Array, Array]:
        """Return motions (m, r), and det t x u_t, (m, unknown), which have no poles."""
        t = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        N = np.tile(of.along[T, 0], (len(angles), 1, 1))
        N[:, len(T) - unknown :] -= of.friction[last, None] * np.einsum("mjc,jcr->mjr", t, of.along[last, 1:])
        push = N @ standing.Z
        A = (of.by_z[T, 0] @ standing.Z) @ push.transpose(0, 2, 1)
        det = np.linalg.det(A)
        least = INDEPENDENT_ROWS * np.abs(A).max(axis=(1, 2)) + 1e-300
        A = A + np.where(det == 0.0, least, 0.0)[:, None, None] * np.eye(len(T))
        x = np.linalg.solve(A, -(of.free[T, 0] + of.by_z[T, 0] @ standing.z)[None, :, None])[..., 0]
        z = standing.z + np.einsum("mj,mjs->ms", x, push) @ standing.Z.T
        u = of.free[last, 1:] + np.einsum("jcr,mr->mjc", of.by_z[last, 1:], z)
        return z, det[:, None] * (t[..., 0] * u[..., 1] - t[..., 1] * u[..., 0])

    try:
        if not unknown:
            return list(at(np.zeros((1, 0)))[0])
        angles = SLIP_DIRECTIONS[unknown](at)
        return list(at(angles)[0]) if len(angles) else []
    except np.linalg.LinAlgError:
        return []


def _one_direction(at: _At) -> Array:
    """Return all angles (m, 1) at which a slip has its direction: zeros of a polynomial of degree 2 in cos and sin."""
    angles = np.arange(8)[:, None] * (2.0 * np.pi / 8)
    c = np.fft.fft(at(angles)[1][:, 0])
    return _angles([c[2], c[1], c[0], c[-1], c[-2]])[:, None]


def _two_directions(at: _At) -> Array:
    """Return all angles (m, 2) at which two slips have their directions.

    With w = exp(i a_2), the first equation is quadratic in w and of degree 2 in cos a_1 and sin a_1, the second
    quartic in w and of degree 1. Their resultant is of degree 10; it is found from its values at 32 angles.
    """
    first, second = np.arange(32) * (2.0 * np.pi / 32), np.arange(8) * (2.0 * np.pi / 8)
    values = at(np.array(list(product(first, second))))[1].reshape(32, 8, -1)
    c = np.fft.fft(values, axis=1) / 8.0
    quadratic, quartic = c[:, [1, 0, -1], 0], c[:, [2, 1, 0, -1, -2], 1]
    sylvester = np.zeros((32, 6, 6), complex)
    for row in range(4):
        sylvester[:, row, row : row + 3] = quadratic
    for row in range(2):
        sylvester[:, 4 + row, row : row + 5] = quartic
    scale = np.abs(sylvester).max(axis=(0, 2), keepdims=True).reshape(1, 6, 1)
    resultant = np.fft.fft(np.linalg.det(sylvester / np.where(scale > 0.0, scale, 1.0)))
    found = []
    for one in _angles(resultant[[*range(10, -1, -1), *range(-1, -11, -1)]]):
        there = np.stack([np.full(8, one), second], axis=1)
        c = np.fft.fft(at(there)[1][:, 0])
        found += [[one, other] for other in _angles([c[1], c[0], c[-1]])]
    return _refined(at, np.array(found).reshape(-1, 2))


def _three_directions(at: _At) -> Array:
    """Return angles (m, 3): from those at which the first two slips have their directions, for a grid of the third."""
    starts = []
    for third in np.arange(THIRDS) * (2.0 * np.pi / THIRDS):

        def with_it(angles: Array, third: float = third) -> tuple[Array, Array]:
            z, off = at(np.concatenate([angles, np.full((len(angles), 1), third)], axis=1))
            return z, off[:, :2]

        starts += [[*pair, third] for pair in _two_directions(with_it)]
    return _refined(at, np.array(starts).reshape(-1, 3))


def _angles(coefficients: Sequence[complex] | Array) -> Array:
    """Return the angles of those roots of a polynomial, highest power first, that lie on the unit circle."""
    c = np.asarray(coefficients)
    if not np.isfinite(c).all() or np.abs(c).max() == 0.0:
        return np.zeros(0)
    roots = np.roots(np.where(np.abs(c) > NO_COEFFICIENT * np.abs(c).max(), c, 0.0))
    return np.angle(roots[np.abs(np.abs(roots) - 1.0) < ON_CIRCLE])


def _refined(at: _At, angles: Array) -> Array:
    """Return angles (m, n) after some of Newton's steps."""
    n, d = angles.shape[1], 1e-7
    for _ in range(NEWTON_STEPS if len(angles) else 0):
        off = at(angles)[1]
        J = np.stack([(at(angles + d * e)[1] - off) / d for e in np.eye(n)], axis=-1)
        step = np.linalg.solve(J + 1e-300 * np.eye(n), off[..., None])[..., 0]
        size = np.linalg.norm(step, axis=1, keepdims=True)
        angles = angles - step * np.minimum(1.0, LONGEST_TURN / np.maximum(size, LONGEST_TURN))
        angles = angles[np.isfinite(angles).all(axis=1)]
    return angles


SLIP_DIRECTIONS: dict[int, Callable[[_At], Array]] = {1: _one_direction, 2: _two_directions, 3: _three_directions}


def _forces_with(of: _Contacts, z: Array) -> list[Array] | None:
    u, least = of.free + of.by_z @ z, NO_SPEED * of.size
    if u[:, 0].min() < -least:
        return None
    speed = np.linalg.norm(u[:, 1:], axis=1)
    owner, rows, units, sticks = [], [], [], ~of.given & (speed <= least)
    for j in np.flatnonzero(u[:, 0] <= least).tolist():
        own = np.eye(u.shape[1])
        if sticks[j]:
            own = tangents_first(own)
        else:
            own = own[:1].copy()
            own[0, 1:] = 0.0 if of.given[j] else -of.friction[j] * u[j, 1:] / speed[j]
        owner += [j] * len(own)
        units += list(own)
        rows += list(own @ of.along[j])
    if not rows:
        return [np.zeros(u.shape[1]) for _ in u] if np.abs(z).max(initial=0.0) == 0.0 else None
    D = np.array(rows)
    x = np.linalg.lstsq(D.T, z, rcond=INDEPENDENT_ROWS)[0]
    if np.abs(of.by_z @ (x @ D - z)).max() > least:
        return None
    x = within_cones(np.array(owner), D, of.friction, sticks, x)
    forces = np.zeros(u.shape)
    np.add.at(forces, owner, x[:, None] * np.array(units))
    return [lawful_force(x, mu) for x, mu in zip(forces, of.friction, strict=True)]
