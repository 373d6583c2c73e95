"""The affine set of all motions and forces that fit a chain's state: v = v0 + N x, tau = T v + t.

v holds the accelerations of a floating base, of all joints and of the objects, the transmitted components lambda of the
wrenches of grasps and loops, f_i = K_i^T lambda_i, the forces of couplings, and those of the world on the object.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.forces.touched_object import TouchedObject
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

SMALLEST_FORCE_SCALE = 1.0  # N: the scale of forces is not smaller
ACCELERATION_SCALE = 10.0  # rad/s^2 or m/s^2: the scale of accelerations
INDEPENDENT = 1e-10  # singular values of the scaled equations below this, relative to the largest, count as zero
UNREACHED = 1e-8  # largest accepted residual of the scaled equations, relative to their right sides


class GraspPlace(NamedTuple):
    """Where the wrench of a grasp or loop is among the unknowns.

    Attributes:
        key: its key in `chain.grasps` or `chain.loops`; the name of a loop in an arm is "arm/loop".
        contact: its kinematics.
        part: the place of lambda in v.
        row: its row in the wrenches of a result.
        known: (6,) wrench that a bushing exerts, world axes; None for a constraint.
    """

    key: Any
    contact: Contact
    part: slice
    row: int
    known: Array | None = None

    @property
    def name(self) -> str:
        """Its name in limits, such as "left", "left/pad1" or "left_sole"."""
        return self.key if isinstance(self.key, str) else "/".join(map(str, self.key))


class AccelerationMap(NamedTuple):
    """The affine set v = v0 + N x of all motions and wrenches, and the drives' torques tau = T v + t.

    Attributes:
        chain: the chain.
        grasps: the grasps, and then the loops.
        v0: (m,) one solution, the smallest in the units of the unknowns.
        N: (m, k) basis of the others.
        T: (n, m) torques per unknown.
        t: (n,) torques at v = 0.
        length: L, the rms distance of the contacts from their centroid [m].
        force: F0, the size of the force that the objects need, at least 1 N.
        unfelt: number of independent forces that no joint feels.
        wrench_rows: number of wrenches in a result.
        wanted: the unknowns on which tasks have rows.
        touched: the contacts of the object with the world, whose forces are the last unknowns; None without.
    """

    chain: ClosedChain
    grasps: tuple[GraspPlace, ...]
    v0: Array
    N: Array
    T: Array
    t: Array
    length: float
    force: float
    unfelt: int
    wrench_rows: int
    wanted: slice
    touched: TouchedObject | None = None

    @property
    def base(self) -> slice:
        """Place of a floating base's acceleration in v, empty without one."""
        return slice(0, 6 if self.chain.floats else 0)

    @property
    def qdd(self) -> slice:
        """Place of the joints' accelerations."""
        first = self.base.stop
        return slice(first, first + self.chain.joint_count)

    @property
    def alpha(self) -> slice:
        """Place of the objects' true accelerations."""
        return slice(self.qdd.stop, self.qdd.stop + 6 * len(self.chain.free_objects))

    @property
    def coupled(self) -> slice:
        """Place of the forces of couplings."""
        stop = self.touch.start
        return slice(stop - len(self.chain.all_couplings), stop)

    @property
    def touch(self) -> slice:
        """Place of the forces of the world on the object."""
        return slice(len(self.v0) - (0 if self.touched is None else self.touched.size), len(self.v0))

    def grasp_wrenches(self, v: Array) -> Array:
        """Return the wrenches of grasps and loops about their contacts, world axes, (wrench_rows, 6).

        They are those of arms on objects, or of a loop's body a on its body b; that of a bushing is what it exerts.
        """
        f = np.zeros((self.wrench_rows, 6))
        for one in self.grasps:
            f[one.row] = one.contact.K.T @ v[one.part] if one.known is None else one.known
        return f


class AccelerationTask(NamedTuple):
    """What is asked: rows (r, w) on the unknowns `AccelerationMap.wanted`, and their values (r,)."""

    rows: Array
    values: Array

    @property
    def smallest(self) -> Array:
        """The smallest accelerations that have these values, (w,)."""
        return np.linalg.pinv(self.rows) @ self.values if len(self.rows) else np.zeros(self.rows.shape[1])

    def weighed(self, weight: Any) -> AccelerationTask:
        """Return it multiplied by a weight, or by one for each row (r,)."""
        weights = np.broadcast_to(weight, self.values.shape)
        return AccelerationTask(weights[:, None] * self.rows, weights * self.values)


def towards_task(found: AccelerationMap, asked: AccelerationTask) -> AccelerationMap:
    """Return the same set of motions in coordinates in which a task weighs about as much as everything else.

    With B = S N = U s V^T and d, what v0 misses of a task with its weights, v0 moves on by N V s / (1 + s^2) U^T d, and
    N becomes N V / sqrt(1 + s^2). Otherwise a large weight would hide all other costs in rounding.
    """
    U, s, Vt = np.linalg.svd(asked.rows @ found.N[found.wanted])
    missing = asked.values - asked.rows @ found.v0[found.wanted]
    gains = np.zeros(len(Vt))
    gains[: len(s)] = s
    y = np.zeros(len(Vt))
    y[: len(s)] = s / (1.0 + s * s) * (U.T @ missing)[: len(s)]
    return found._replace(v0=found.v0 + found.N @ (Vt.T @ y), N=found.N @ (Vt.T / np.sqrt(1.0 + gains**2)))


def solutions(E: Array, e: Array, scales: Array) -> tuple[Array, Array] | None:
    """Return one solution v of E v / scales = e and a basis of the others; None if there is none.

    Args:
        E: (rows, m) matrix for v / scales, with rows of about one size.
        e: (rows,) right side.
        scales: (m,) size of each unknown.
    """
    checks.finite(np.append(E.sum(axis=1), e), "equations of motion")
    sizes = np.linalg.norm(E, axis=1)
    sizes[sizes <= INDEPENDENT * sizes.max(initial=0.0)] = 1.0  # rounding alone, as across a planar linkage
    E, right = E / sizes[:, None], e / sizes
    U, s, Vt = np.linalg.svd(E)
    rank = int((s > INDEPENDENT * s.max(initial=0.0)).sum())
    y = Vt[:rank].T @ ((U[:, :rank].T @ right) / s[:rank])
    y = y + Vt[:rank].T @ ((U[:, :rank].T @ (right - E @ y)) / s[:rank])
    left = np.abs(E @ y - right)
    if not left.max(initial=0.0) <= UNREACHED * max(1.0, float(np.abs(right).max(initial=0.0))):
        return None
    return scales * y, scales[:, None] * Vt[rank:].T


def lost_directions(E: Array, task: slice, columns: slice, scales: Array) -> tuple[list[Array], Array]:
    """Return what no solution changes of a task: unit combinations of the accelerations, (w,) each, and of its rows.

    Args:
        E: (rows, m) matrix for v / scales.
        task: the rows of the task.
        columns: the unknowns on which it has rows.
        scales: (m,) size of each unknown.
    """
    others = np.delete(E, np.r_[task], axis=0)
    _, s, Vt = np.linalg.svd(others)
    free = Vt[int((s > INDEPENDENT * s.max(initial=0.0)).sum()) :]
    U, s, _ = np.linalg.svd(E[task] @ free.T)
    lost = U[:, int((s > UNREACHED * np.abs(E[task]).max(initial=0.0)).sum()) :]
    rows = lost.T @ (E[task, columns] / scales[columns])
    return [d / np.linalg.norm(d) for d in rows if d.any()], lost
