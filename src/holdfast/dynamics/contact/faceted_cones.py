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

import numpy as np

from holdfast.dynamics.contact.contact_law import ReducedContact
from holdfast.spatial.scalar import Array

FACETS = 8
NARROWED = (
    0.5,
    0.25,
    0.1,
    0.04,
    0.016,
    0.006,
    0.0025,
    0.001,
)  # rad, half the angle of the facets about the friction that was found
DISTURBED = (0.0, 1e-9, 1e-7, 1e-5)  # of the right-hand side, where a pivot is lost in rounding
MOST_PIVOTS = 2000
NO_PIVOT = 1e-11


def faceted_forces(contacts: Sequence[ReducedContact]) -> Iterator[list[Array]]:
    """Yield forces, axes [n, t1, t2], that obey the laws with facets, each time with narrower ones; floats only."""
    angles = [np.arange(FACETS) * (2.0 * np.pi / FACETS) for _ in contacts]
    for width in (*NARROWED, None):
        forces = _solved(contacts, [np.stack([np.cos(a), np.sin(a)], axis=1) for a in angles])
        if forces is None:
            return
        yield forces
        if width is not None:
            angles = [_about(x, old, width) for x, old in zip(forces, angles, strict=True)]


def _about(force: Array, old: Array, width: float) -> Array:
    """Return angles of facets about the direction of a friction force; the old ones where there is none."""
    if not force[1:].any():
        return old
    near = width * np.array([-1.0, -1.0 / 3.0, 1.0 / 3.0, 1.0])
    return np.arctan2(force[2], force[1]) + np.concatenate([near, np.pi * np.array([-0.5, 0.5, 1.0])])


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
