"""The dense equations of a forest, as a second opinion on the elimination: O(n^3).

[ M   G^T ] [ qdd     ]   [ torque - h ]
[ G   0   ] [ -lambda ] = [ r          ]
"""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_rows import ForestRows, forest_rows, reach, turning
from holdfast.dynamics.tree.outward import ForestSolution
from holdfast.errors import MethodNotApplicable
from holdfast.spatial.linalg import gauss_solve
from holdfast.spatial.scalar import Array

NULL_ROW = 1e-9  # remainders of rows that are smaller, relative to the largest row, depend on rows before


def forest_kkt(motion: ForestMotion) -> ForestSolution:
    """Return the accelerations and forces of a forest by Gaussian elimination of the dense equations.

    Of dependent rows of G, those with the largest remainders are imposed, and the others have no force.

    Raises:
        MethodNotApplicable: the matrix is singular.
    """
    rows, n = forest_rows(motion), motion.forest.velocity_count
    M, load = mass_and_load(motion, rows)
    kept = independent_rows_of(motion, rows)
    G = rows.G[kept]
    matrix = np.block([[M, G.T], [G, np.zeros((len(kept), len(kept)))]])
    rhs = np.concatenate([load, rows.r[kept]])
    x, nullity = gauss_solve(matrix, rhs)
    if nullity:
        raise MethodNotApplicable(
            f"needs the mass matrix regular on the motions that are left, but the nullity is {nullity} of {len(x)}"
        )
    x = x + gauss_solve(matrix, rhs - matrix @ x)[0]  # what rounding left of the rows, as in `solved`
    force = np.zeros(len(rows.G))
    force[kept] = -x[n:]
    return ForestSolution(
        [x[part] for part in motion.forest.velocities],
        [J @ x[:n] for J in rows.jacobians],
        [c.K.T @ force[part] for c, part in zip(motion.closures, rows.closures, strict=True)],
        [float(force[at]) for at in rows.couplings],
        len(kept),
        1.0,
        [],
    )


def mass_and_load(motion: ForestMotion, rows: ForestRows) -> tuple[Array, Array]:
    """Return M (n_v, n_v) and torque - h (n_v,), for rates of free bodies at their mass centres. O(bodies n_v^2)."""
    M, load = np.diag(np.concatenate([body.armature for body in motion.bodies])), np.zeros(len(rows.G.T))
    for body, J, part in zip(motion.bodies, rows.jacobians, motion.forest.velocities, strict=True):
        M = M + J.T @ body.inertia.dense() @ J
        load = load - J.T @ (body.load - body.wrench)
        load[part] += body.torque
    return M, load


def independent_rows_of(motion: ForestMotion, rows: ForestRows) -> Array:
    """Return the indices of as many rows of G as are independent, in order.

    Lengths are in units of the longest reach. QR with pivoting takes the row with the largest remainder next.
    """
    from scipy.linalg import qr

    if not rows.G.size:
        return np.zeros(0, dtype=int)
    length = float(reach(motion))
    columns = np.where(turning(motion), 1.0, length)
    moments = [length if angular else 1.0 for c in motion.closures for angular in np.abs(c.K[:, :3]).max(axis=1) > 0.0]
    G = rows.G * columns * np.array([*moments, *[1.0] * len(rows.couplings)])[:, None]
    R, order = qr(G.T, mode="r", pivoting=True)  # pyright: ignore[reportAssignmentType]
    sizes = np.abs(np.diag(R))
    return np.sort(order[: int((sizes > NULL_ROW * max(float(sizes[0]), length * NULL_ROW)).sum())])
