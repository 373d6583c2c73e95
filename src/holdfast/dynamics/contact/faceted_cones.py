"""Contact forces with faceted friction cones by Lemke's algorithm, which always ends: the last way of the reference.

With unit directions d_i that span the tangent plane positively, forces n c + sum_i d_i beta_i and slips gamma obey

    0 <= c _|_ u_n >= 0,    0 <= beta_i _|_ gamma + d_i . u_t >= 0,    0 <= gamma _|_ mu c - sum beta >= 0

a linear complementarity problem with a copositive matrix, whose solution exists for a world at rest. The facets are
then turned and narrowed about the directions of friction that were found, and the problem is solved again.

References: Stewart and Trinkle, "An implicit time-stepping scheme", 1996; Cottle, Pang and Stone, "The Linear
Complementarity Problem", 1992, section 4.4.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.contact_law import ReducedContact
from holdfast.spatial.scalar import Array

FACETS = 8
WIDEST_FAN = 0.5  # half the angle of fine directions [rad]
NARROWER, WIDER = 0.35, 1.5  # its changes
FAN_ROUNDS = 20
DISTURBED = (0.0, 1e-9, 1e-7, 1e-5)  # of the right-hand side, where a pivot is lost in rounding
MOST_PIVOTS = 2000
NO_PIVOT = 1e-11


class _Fan(NamedTuple):
    """Directions of friction of one contact: fine ones within `width` about `middle`, and coarse ones around.

    Attributes:
        middle: angle in the tangent plane [rad].
        width: half the angle of the fine ones [rad]; None for directions evenly all around.
    """

    middle: float = 0.0
    width: float | None = None

    @property
    def directions(self) -> Array:
        """Unit vectors (m, 2) that span the plane positively."""
        if self.width is None:
            angles = np.arange(FACETS) * (2.0 * np.pi / FACETS)
        else:
            fine = self.width * np.array([-1.0, -1.0 / 3.0, 1.0 / 3.0, 1.0])
            angles = self.middle + np.concatenate([fine, np.pi * np.array([-0.5, 0.5, 1.0])])
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def about(self, force: Array) -> _Fan:
        """Return a narrower fan about a friction force; a wider one where it left the fine directions."""
        if not force[1:].any():
            return self
        middle = float(np.arctan2(force[2], force[1]))
        if self.width is None:
            return _Fan(middle, WIDEST_FAN)
        off = abs((middle - self.middle + np.pi) % (2.0 * np.pi) - np.pi)
        return _Fan(middle, self.width * NARROWER if off < 0.99 * self.width else min(WIDEST_FAN, self.width * WIDER))


def faceted_forces(contacts: Sequence[ReducedContact]) -> Iterator[list[Array]]:
    """Yield forces, axes [n, t1, t2], that obey the laws with facets, each time with narrower ones; floats only."""
    fans = [_Fan() for _ in contacts]
    for _ in range(FAN_ROUNDS):
        forces = _solved(contacts, [fan.directions for fan in fans])
        if forces is None:
            return
        yield forces
        fans = [fan.about(x) for fan, x in zip(fans, forces, strict=True)]


def _solved(contacts: Sequence[ReducedContact], directions: Sequence[Array]) -> list[Array] | None:
    roots = np.sqrt([c.gauge for c in contacts])
    rubbing = [j for j, c in enumerate(contacts) if c.friction > 0.0]
    normal = np.array([c.by_z[0] / g for c, g in zip(contacts, roots, strict=True)])
    pressing = np.array([c.along[0] / g for c, g in zip(contacts, roots, strict=True)])
    facets = [directions[j] @ contacts[j].by_z[1:] / roots[j] for j in rubbing]
    owner = np.repeat(np.arange(len(rubbing)), [len(one) for one in facets])
    D = np.concatenate([np.zeros((0, normal.shape[1])), *facets])
    k, m, s = len(contacts), len(D), len(rubbing)
    E = (owner[:, None] == np.arange(s)).astype(float)
    mu = np.zeros((s, k))
    mu[np.arange(s), rubbing] = [contacts[j].friction for j in rubbing]
    velocities, forces = np.vstack([normal, D]), np.vstack([pressing, D])
    M = np.zeros((k + m + s, k + m + s))
    M[: k + m, : k + m] = velocities @ forces.T
    M[np.arange(k), np.arange(k)] += [c.compliance / c.gauge for c in contacts]
    M[k : k + m, k + m :], M[k + m :, :k], M[k + m :, k : k + m] = E, mu, -E.T
    of_normals = [c.free[0] / g for c, g in zip(contacts, roots, strict=True)]
    of_facets = [directions[j] @ contacts[j].free[1:] / roots[j] for j in rubbing]
    q = np.concatenate([of_normals, *of_facets, np.zeros(s)])
    unit = np.abs(q).max()
    if unit == 0.0:
        return [np.zeros(3) for _ in contacts]
    apart = np.linspace(1.0, 2.0, len(q))  # of rows that would be left at the same time
    tried = (lemke(M, q / unit + by * apart) for by in DISTURBED)
    x = next((one for one in tried if one is not None), None)
    if x is None:
        return None
    found = [np.array([x[j], 0.0, 0.0]) for j in range(k)]
    for i, j in enumerate(rubbing):
        found[j][1:] = x[k : k + m][owner == i] @ directions[j]
    return [unit / g * one for g, one in zip(roots, found, strict=True)]


def lemke(M: Array, q: Array) -> Array | None:
    """Return x >= 0 with M x + q >= 0 and x . (M x + q) = 0 by Lemke's algorithm; None if a ray ends it."""
    n = len(q)
    if q.min() >= 0.0:
        return np.zeros(n)
    # columns: w (n), x (n), the covering variable, right-hand side
    T = np.hstack([np.eye(n), -M, -np.ones((n, 1)), q[:, None]])
    basis = np.arange(n)
    row, enters = int(np.argmin(q)), 2 * n
    for _ in range(MOST_PIVOTS):
        leaves = int(basis[row])
        T[row] /= T[row, enters]
        others = np.arange(n) != row
        T[others] -= np.outer(T[others, enters], T[row])
        basis[row] = enters
        if leaves == 2 * n:
            x = np.zeros(2 * n + 1)
            x[basis] = T[:, -1]
            return np.maximum(x[n : 2 * n], 0.0)
        enters = leaves + n if leaves < n else leaves - n
        column = T[:, enters]
        open_rows = np.flatnonzero(column > NO_PIVOT)
        if not len(open_rows):
            return None
        ratios = np.maximum(T[open_rows, -1], 0.0) / column[open_rows]
        ties = open_rows[ratios <= ratios.min() + 1e-12 * max(1.0, float(ratios.min()))]
        covering = ties[basis[ties] == 2 * n]
        row = int(covering[0]) if len(covering) else int(ties[np.argmax(column[ties])])
    return None
