"""Whether a solution of a contact problem is the only one, and whether a problem has one; floats.

At a solution let the coordinates a of the active forces be all three of every sticking contact, and the normal one of
every slipping or frictionless contact. To first order, a change of forces and motion that keeps all modes obeys

    K dz = N^T a,    R dz = 0,    K = 1 + sum h B_t^T (1 - t t^T) B_t,    h = mu lambda_n / |u_t|

where N are the rows along which active forces act (slipping: n - mu t), and R those of the velocities that they keep at
zero. K contains the turning of the friction of slipping contacts. Hence

* forces are unique if N has independent rows;
* the motion does not depend on how the load is shared if R K^-1 is regular on the range of N^T. (Where all contacts
  stick, R = N, and it always is.) Otherwise there is a null vector a with dz = K^-1 N^T a != 0: AMBIGUOUS.

**Jammed.** Velocities that no contact forbids exist if u_n = b_n + B_n z >= 0 has a solution z. By Farkas' lemma there
is none if and only if forces p >= 0 exist with B_n^T p = 0 and b_n . p < 0, which a non-negative least-squares problem
finds: such forces squeeze the chain where it cannot give way. For contacts that slide already, whose force acts along
n - mu t, all 2^k sets of pressing contacts of the linear complementarity problem are tried.

**Proof of uniqueness.** Two solutions satisfy |dz|^2 <= |dlambda_n . d(mu |u_t|)|, and |dlambda_n| <= |dz| / sqrt(s), s
the least eigenvalue of G_nn - G_nt G_tt^-1 G_tn, G = B B^T with the rows along which forces can act, if these are
independent. Therefore |diag(mu) B_t| < sqrt(s) proves that there is only one.

References: Lawson and Hanson, "Solving Least Squares Problems", 1974, ch. 23; Cottle, Pang and Stone, "The Linear
Complementarity Problem", 1992; docs/theory/contact_with_the_world.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.contact_law import ReducedContact
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.spatial.scalar import Array

NO_SINGULAR_VALUE = 1e-9  # singular values below this, relative to the largest, count as zero
SQUEEZED = 1e-9  # of the velocities: a residual of Farkas' forces that is rounding
MOST_ENUMERATED = 8  # contacts that slide already


class ActiveRows(NamedTuple):
    """The rows of the active contacts at a solution, a of them.

    Attributes:
        N: (a, r) along which forces act.
        R: (a, r) of the velocities that they keep at zero.
        K: (r, r) 1 and the turning of friction.
        places: contact and component [n, t1, t2] of every coordinate.
        directions: (a, 3) force of the contact per coordinate.
    """

    N: Array
    R: Array
    K: Array
    places: list[tuple[int, int]]
    directions: Array


def active_rows(contacts: Sequence[ReducedContact], forces: Sequence[Array], u: Array, modes: Array) -> ActiveRows:
    """Return the active rows.

    Args:
        contacts: the contacts.
        forces: (3,) of every contact, axes [n, t1, t2].
        u: (k, 3) velocities, axes [n, t1, t2].
        modes: (k,) numbers of `ContactMode`.
    """
    r = contacts[0].by_z.shape[1]
    N, R, places, directions, K = [np.zeros((0, r))], [np.zeros((0, r))], [], [], np.eye(r)
    for j, (c, x) in enumerate(zip(contacts, forces, strict=True)):
        mode = ContactMode(int(modes[j]))
        if mode is ContactMode.OPEN:
            continue
        units = np.eye(len(x))[: len(x) if mode is ContactMode.STICKS else 1].copy()
        if mode is ContactMode.SLIPS and c.friction > 0.0:
            size = float(np.linalg.norm(u[j, 1:]))
            t = u[j, 1:] / size
            units[0, 1:] = -c.friction * t
            across = c.by_z[1:] - np.outer(t, t @ c.by_z[1:])
            K = K + (float(c.friction) * x[0] / size) * across.T @ across
        N.append(units @ c.along)
        R.append(c.by_z[: len(units)])
        places += [(j, i) for i in range(len(units))]
        directions += list(units)
    return ActiveRows(np.concatenate(N), np.concatenate(R), K, places, np.array(directions).reshape(-1, len(forces[0])))


def unique_forces(active: ActiveRows) -> bool:
    """Return whether the active forces are independent."""
    return _rank(active.N) == len(active.N)


class LoadFreedoms(NamedTuple):
    """The forces that keep all modes, to first order.

    Attributes:
        null: (a, m) orthonormal coordinates a of these forces.
        left: (a, m) orthonormal y with y^T R K^-1 N^T = 0.
        moving: (a, l) those among them that change the motion, l <= m.
    """

    null: Array
    left: Array
    moving: Array


def load_freedoms(active: ActiveRows) -> LoadFreedoms:
    """Return the freedoms of the active forces."""
    U, s, Vt = np.linalg.svd(active.R @ np.linalg.solve(active.K, active.N.T))
    rank = int((s > NO_SINGULAR_VALUE * s.max(initial=0.0)).sum())
    null = Vt[rank:].T
    _, moved, W = np.linalg.svd(active.N.T @ null)
    size = np.linalg.norm(active.N, axis=1).max(initial=0.0)
    return LoadFreedoms(null, U[:, rank:], null @ W[: int((moved > NO_SINGULAR_VALUE * size).sum())].T)


def of_equal_compliances(active: ActiveRows, freedoms: LoadFreedoms, forces: Sequence[Array]) -> list[Array]:
    """Return the forces in the active rows that equal compliances at all contacts would choose, tending to zero.

    With a compliance eps, R dz = -eps a has a solution only if y^T a = 0 for all y in `left`; the null vectors are
    added that make it so. Where the motion does not depend on them, these are the forces of least norm.
    """
    a = np.array([forces[j][i] for j, i in active.places])
    c = np.linalg.lstsq(freedoms.left.T @ freedoms.null, -freedoms.left.T @ a, rcond=NO_SINGULAR_VALUE)[0]
    return added(active, forces, freedoms.null @ c)


def added(active: ActiveRows, forces: Sequence[Array], change: Array) -> list[Array]:
    """Return forces with a change (a,) of the coordinates of the active ones."""
    found = [x.copy() for x in forces]
    for (j, _), value, direction in zip(active.places, change, active.directions, strict=True):
        found[j] = found[j] + value * direction
    return found


def largest_load(
    active: ActiveRows, contacts: Sequence[ReducedContact], forces: Sequence[Array], change: Array
) -> float:
    """Return the largest multiple of a change of the active forces that keeps all of them in their cones."""
    still, d = [0.0 * x for x in forces], 1e-300
    most = np.inf
    for c, x, step in zip(contacts, forces, added(active, still, change), strict=True):
        if step[0] < 0.0:
            most = min(most, -x[0] / step[0])
        a = step[1:] @ step[1:] - (c.friction * step[0]) ** 2  # |x_t|^2 = (mu x_n)^2
        h = x[1:] @ step[1:] - c.friction**2 * x[0] * step[0]
        room = max((c.friction * x[0]) ** 2 - x[1:] @ x[1:], 0.0)
        if c.friction > 0.0 and room > 1e-12 * (c.friction * x[0]) ** 2:
            root = np.sqrt(max(h * h + a * room, 0.0)) + h
            if root > d:
                most = min(most, room / root)
    return float(most)


def proven_unique(contacts: Sequence[ReducedContact]) -> bool:
    """Return whether the motion is proven to be the only one that satisfies the laws."""
    if any(c.slide.any() for c in contacts):
        A = np.array([c.by_z[0] for c in contacts]) @ np.array([c.along[0] for c in contacts]).T
        rest = any(c.friction > 0.0 for c in contacts)
        least = float(np.linalg.eigvalsh(A + A.T)[0])
        return not rest and least > NO_SINGULAR_VALUE * float(np.abs(A).max())
    rubbing = [c for c in contacts if c.friction > 0.0]
    if not rubbing:
        return True
    mu = np.repeat([float(c.friction) for c in rubbing], len(rubbing[0].free) - 1)
    n, t = np.array([c.by_z[0] for c in contacts]), np.concatenate([c.by_z[1:] for c in rubbing])
    if len(n) + len(t) > n.shape[1] or _rank(np.concatenate([n, t])) < len(n) + len(t):
        return False
    S = n @ n.T - (n @ t.T) @ np.linalg.solve(t @ t.T, t @ n.T)
    return float(np.linalg.norm(mu[:, None] * t, 2)) ** 2 < float(np.linalg.eigvalsh(S)[0])


def squeezing_forces(contacts: Sequence[ReducedContact]) -> Array | None:
    """Return normal forces p >= 0 with B_n^T p = 0 and b_n . p = -1, which prove that nothing moves so; None if none.

    Contacts with a compliance give way, and are left out.
    """
    from scipy.optimize import nnls  # imported here because it takes half a second

    rigid = [c for c in contacts if c.compliance == 0.0]
    if not rigid:
        return None
    n = np.array([c.by_z[0] / np.sqrt(c.gauge) for c in rigid])
    b = np.array([c.free[0] / np.sqrt(c.gauge) for c in rigid])
    size = np.abs(b).max()
    if size == 0.0:
        return None
    rows = np.vstack([n.T, b / size])
    p, off = nnls(rows, np.concatenate([np.zeros(n.shape[1]), [-1.0]]))
    return p if off < np.sqrt(SQUEEZED) and np.abs(n.T @ p).max() <= SQUEEZED * max(p.max(), 1e-300) else None


def pressing_sets(contacts: Sequence[ReducedContact]) -> list[list[Array]] | None:
    """Return all forces of contacts that slide already, or without friction, with one each set; None if too many.

    The linear complementarity problem 0 <= b_n + N P (N - mu T)^T lambda_n, lambda_n >= 0.
    """
    if len(contacts) > MOST_ENUMERATED or any(c.friction > 0.0 or c.compliance > 0.0 for c in contacts):
        return None
    A = np.array([c.by_z[0] for c in contacts]) @ np.array([c.along[0] for c in contacts]).T
    b = np.array([c.free[0] for c in contacts])
    size, found = np.abs(b).max(), []
    for pressing in product((False, True), repeat=len(contacts)):
        S = np.flatnonzero(pressing)
        x = np.zeros(len(contacts))
        if len(S):
            block = A[np.ix_(S, S)]
            if np.linalg.cond(block) > 1.0 / NO_SINGULAR_VALUE:
                continue
            x[S] = np.linalg.solve(block, -b[S])
        if x.min() >= 0.0 and (b + A @ x).min() >= -1e-12 * size:
            found.append([one * np.eye(len(contacts[0].free))[0] for one in x])
    return found


def _rank(A: Array) -> int:
    return _range(A).shape[1]


def _range(A: Array) -> Array:
    """Return an orthonormal basis of the range of a matrix, as columns."""
    if not A.size:
        return np.zeros((len(A), 0))
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    return U[:, : int((s > NO_SINGULAR_VALUE * s.max(initial=0.0)).sum())]
