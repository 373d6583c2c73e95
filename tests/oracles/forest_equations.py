"""Forward dynamics of a forest with nothing eliminated, in many digits: the oracle.

Every body has six accelerations of its own, every joint its accelerations and the whole wrench across it, every closure
a force along each of its rows, and every coupling one. All are unknowns of one symmetric system, as in `every_body`. Of
the library only the data of its models are read. Of rows that follow from others those with the largest remainders are
kept; the wrenches are then the smallest with the same effect.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import qr

from holdfast.model.forest import BodyJoint, Forest
from tests.oracles.arithmetic import Arithmetic, SparseSystem, arithmetic
from tests.oracles.arm_kinematics import MovingFrame, centripetal, cross, cross_matrix, rotation_about
from tests.oracles.body_equations import body_equation
from tests.oracles.grasp_rows import AXES, Side, grasp_rows

NULL = 1e-9  # of the largest: smaller remainders belong to rows that follow from others


class Truth(NamedTuple):
    """What the oracle finds, in float64.

    The fields are those of `ForestResult`, the largest dropped remainder of a row over the least kept one, and by how
    much the accelerations miss dropped rows: not small means that no accelerations satisfy the closures.
    """

    qdd: np.ndarray
    acceleration: np.ndarray
    closure_wrench: np.ndarray
    coupling_force: np.ndarray
    rank: int
    gap: float
    missed: float


class ForestEquations:
    """The system of a forest in a state.

    Attributes:
        frames: per body, its motion without accelerations.
        alpha: per body, the unknowns of its acceleration.
        qdd: per body, the unknowns of its joint; None for a free body.
        K: per closure, (rows, 6) of its wrench.
    """

    def __init__(
        self, forest: Forest, q, qd, tau, wrenches, digits: int | None = None, numbers: Arithmetic | None = None
    ) -> None:
        """Write down every equation in float64 (`digits=None`), in so many digits, or in another arithmetic."""
        self.forest, self.numbers = forest, numbers or arithmetic(digits)
        with self.numbers.precision():
            self._write_down(*(self.numbers.array(x) for x in (q, qd, tau, wrenches)))

    def solved(self) -> Truth:
        """Return the solution.

        Raises:
            ArithmeticError: the system is nearly singular.
        """
        rank, dependent, gap = self.judged()
        kept = [i for i in range(len(self.system.rows)) if i not in dependent]
        with self.numbers.precision():
            x = self.system.solved(kept)
            left = self.system.residual(x, sorted(dependent))
            missed = max((abs(float(one)) for one in left), default=0.0)
            rates = [x[a] if part is None else x[part] for a, part in zip(self.alpha, self.qdd, strict=True)]
            force = np.concatenate([np.zeros(0), *(x[part] for part in (*self.closures, *self.couplings))])
        force = force.astype(float)
        if dependent:
            force = self._smallest(force, rank)
        ends = np.cumsum([0, *(len(K) for K in self.K)])
        found = [K.astype(float).T @ force[a:b] for K, a, b in zip(self.K, ends, ends[1:], strict=False)]
        return Truth(
            np.concatenate(rates).astype(float),
            np.array([x[a].astype(float) for a in self.alpha]),
            np.array(found).reshape(-1, 6),
            force[ends[-1] :],
            rank,
            gap,
            missed,
        )

    def _write_down(self, q, qd, tau, wrenches) -> None:
        numbers, forest = self.numbers, self.forest
        self.system, none, one = SparseSystem(numbers), numbers.array(np.zeros(3)), numbers.array(np.eye(3))
        world = MovingFrame(one, none, none, none, none, none)
        self.frames: list[MovingFrame] = []
        self.alpha: list[slice] = []
        self.qdd: list[slice | None] = []
        self.columns: list[np.ndarray] = []
        for k, body in enumerate(forest.bodies):
            at, joint = forest.velocities[k], body.joint
            parent = world if body.parent is None else self.frames[body.parent]
            pushed = wrenches[k] + tau[at] if joint.of_kind.floats else wrenches[k]
            frame, H = moved_frame(parent, joint, q[forest.positions[k]], qd[at], numbers)
            still = MovingFrame(frame.R, frame.origin, frame.omega, frame.v, none, none)
            given = {"mass": body.link.mass, "com": body.link.com, "inertia": body.link.inertia, "wrench": pushed}
            equation = body_equation(given, still, numbers.array(forest.gravity), numbers)
            alpha = self.system.unknowns(-equation.bias)
            self.system.add(alpha, alpha, equation.M)
            self.frames.append(still)
            self.alpha.append(alpha)
            self.columns.append(H)
            if joint.of_kind.floats:
                self.qdd.append(None)
                continue
            damping, armature = (numbers.array(x)[()] for x in (joint.damping, joint.armature))
            drive = self.system.unknowns(tau[at] - damping * qd[at])
            wrench = self.system.unknowns(-np.concatenate([frame.omega_dot, frame.v_dot]))
            self.system.add(drive, drive, armature * numbers.array(np.eye(H.shape[1])))
            self.system.add_both(wrench, drive, H)
            self.system.add_both(wrench, alpha, -numbers.array(np.eye(6)))
            if body.parent is not None:
                before = self.frames[body.parent]
                self.system.add_both(wrench, self.alpha[body.parent], self._carried(frame.origin - before.origin))
            self.qdd.append(drive)
        self.K: list[np.ndarray] = []
        self.ends: list[tuple[np.ndarray, np.ndarray]] = []
        self.points: list[np.ndarray] = []
        self.closures = [self._closure(closure, world) for closure in forest.closures]
        self.couplings = [self._coupling(coupling) for coupling in forest.couplings]

    def _closure(self, closure, world: MovingFrame) -> slice:
        """Write down the rows of a closure."""
        numbers, grasp = self.numbers, closure.grasp
        a, b = world if closure.a is None else self.frames[closure.a], self.frames[closure.b]
        local = numbers.array(closure.tip.p)
        point, speed = a.point(local), a.point_velocity(local)
        on_b, of_a = (
            Side(b.R @ numbers.array(grasp.frame.R), b.omega),
            Side(a.R @ numbers.array(closure.tip.R), a.omega),
        )
        rows = grasp_rows(grasp, on_b, of_a, numbers)
        K = np.array([np.concatenate([row.m, row.n]) for row in rows])
        keeps = keeps_its_point(grasp)
        lever = b.R @ numbers.array(grasp.frame.p) if keeps else point - b.origin
        free = without_components(
            np.concatenate([b.omega - a.omega, b.v + cross(b.omega, lever) - speed]), K
        )  # as the velocities are, if they satisfy the closure
        carried = cross(b.omega, lever) - (0 if keeps else free[3:])  # of the point, as it moves through b
        passing = cross(b.omega, carried) - centripetal(a.omega, point - a.origin)
        rhs = [row.n @ passing + row.m_dot @ free[:3] + row.n_dot @ free[3:] for row in rows]
        forces = self.system.unknowns(np.array(rhs, dtype=object))
        of_b, of_tip = -(K @ self._carried(lever)), K @ self._carried(point - a.origin)
        self.system.add_both(forces, self.alpha[closure.b], of_b)
        if closure.a is not None:
            self.system.add_both(forces, self.alpha[closure.a], of_tip)
        self.K.append(K)
        self.points.append(point)
        self.ends.append((of_tip, of_b))
        return forces

    def _coupling(self, coupling) -> slice:
        """Write down the row of a coupling."""
        row = self.system.unknowns(self.numbers.array(np.zeros(1)))
        for body, component, coefficient in coupling.terms:
            drive = self.qdd[body]
            assert drive is not None
            own = slice(drive.start + component, drive.start + component + 1)
            self.system.add_both(row, own, -self.numbers.array([[coefficient]]))
        return row

    def _carried(self, lever: np.ndarray) -> np.ndarray:
        one, X = self.numbers.array(np.eye(3)), cross_matrix(lever)
        return np.block([[one, 0 * X], [-X, one]])

    def rows(self) -> np.ndarray:
        """Return the rows of closures and couplings on joint rates, (rows, n_v), in float64."""
        forest, n = self.forest, self.forest.velocity_count
        J: list[np.ndarray] = []
        for k, (body, frame, H) in enumerate(zip(forest.bodies, self.frames, self.columns, strict=True)):
            own = np.zeros((6, n))
            if body.parent is not None:
                lever = (frame.origin - self.frames[body.parent].origin).astype(float)
                own = np.block([[np.eye(3), np.zeros((3, 3))], [-cross_matrix(lever), np.eye(3)]]) @ J[body.parent]
            own[:, forest.velocities[k]] = H.astype(float)
            J.append(own)
        found = [np.zeros((0, n))]
        for closure, (of_a, of_b) in zip(forest.closures, self.ends, strict=True):
            on_a = 0.0 if closure.a is None else of_a.astype(float) @ J[closure.a]
            found.append(of_b.astype(float) @ J[closure.b] + on_a)
        for coupling in forest.couplings:
            row = np.zeros((1, n))
            for body, component, coefficient in coupling.terms:
                row[0, forest.velocities[body].start + component] = -coefficient
            found.append(row)
        return np.concatenate(found)

    def judged(self) -> tuple[int, set[int], float]:
        """Return the rank, the unknowns of dependent rows, and the largest dropped remainder over the least kept."""
        G = self.rows()
        if not len(G):
            return 0, set(), 0.0
        R, order = qr(G.T, mode="r", pivoting=True)  # pyright: ignore[reportAssignmentType]
        sizes = np.zeros(len(G))
        sizes[: min(R.shape)] = np.abs(np.diag(R))
        rank = int((sizes > NULL * max(sizes[0], NULL)).sum())
        unknowns = [i for part in (*self.closures, *self.couplings) for i in range(part.start, part.stop)]
        gap = float(sizes[rank] / sizes[rank - 1]) if 0 < rank < len(G) else 0.0
        return rank, {unknowns[i] for i in order[rank:]}, gap

    def _smallest(self, force: np.ndarray, rank: int) -> np.ndarray:
        """Return the smallest forces with the same effect."""
        forest = self.forest
        points = np.array(self.points).reshape(-1, 3).astype(float)
        L = float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean())) if len(points) > 1 else 1.0
        W = np.diag([1.0 / L, 1.0 / L, 1.0 / L, 1.0, 1.0, 1.0])
        metric = np.zeros((len(force), len(force)))
        start = 0
        for K in self.K:
            own = W @ K.astype(float).T
            metric[start : start + len(K), start : start + len(K)] = own.T @ own
            start += len(K)
        for coupling in forest.couplings:
            turns = [forest.bodies[k].joint.of_kind.turning[component] for k, component, _ in coupling.terms]
            loads = [c / L if turn else c for (_, _, c), turn in zip(coupling.terms, turns, strict=True)]
            metric[start, start] = sum(c * c for c in loads)
            start += 1
        C = np.linalg.cholesky(metric)
        mu, E = C.T @ force, np.linalg.solve(C, self.rows())
        U = np.linalg.svd(E, full_matrices=True)[0]
        return np.linalg.solve(C.T, mu - U[:, rank:] @ (U[:, rank:].T @ mu))


def keeps_its_point(grasp) -> bool:
    """Return whether a closure acts at a point of body b, where it is also while the closure is slightly open."""
    return AXES.get(grasp.kind, ("", ""))[1] == "xyz"


def without_components(x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return a vector without its components along independent rows; they are zero where a closure is satisfied."""
    spanned: list[np.ndarray] = []
    for row in rows:
        for one in spanned:
            row = row - (row @ one) / (one @ one) * one
        spanned.append(row)
        x = x - (x @ row) / (row @ row) * row
    return x


def moved_frame(
    parent: MovingFrame, joint: BodyJoint, q: np.ndarray, qd: np.ndarray, numbers: Arithmetic
) -> tuple[MovingFrame, np.ndarray]:
    """Return the frame of a body behind a joint, accelerations at qdd = 0, and its motion per joint rate, (6, m).

    Written out by kind: a turn about an axis, shifts along directions, a turn about a point, or both.
    """
    kind, zero = joint.kind, numbers.array(np.zeros(3))
    axes = parent.R @ numbers.array(joint.placement.R)
    axis = numbers.array(joint.axis)
    turns: list[np.ndarray] = []
    shifts: list[np.ndarray] = []
    offset, R, unit = parent.R @ numbers.array(joint.placement.p), axes, list(numbers.array(np.eye(3)))
    columns: list[tuple[np.ndarray, np.ndarray]] = []
    if kind in ("spherical", "free"):
        R = axes @ _rotation(q[:4])
        columns = [(axes @ u, zero) for u in unit]
        if kind == "free":
            offset = offset + axes @ q[4:]
            columns += [(zero, axes @ u) for u in unit]
    else:
        if kind != "prismatic":
            R = axes @ rotation_about(axis, q[0], numbers)
            pitch = numbers.array(joint.pitch or 0.0)[()]
            columns.append((axes @ axis, pitch * (axes @ axis)))
            offset = offset + pitch * q[0] * (axes @ axis)
        shifts = [axis] if kind in ("prismatic", "cylindrical") else []
        if kind == "planar":
            across = numbers.array(joint.across)
            shifts = [across, cross(axis, across)]
        for direction, x in zip(shifts, q[len(q) - len(shifts) :] if shifts else [], strict=True):
            columns.append((zero, axes @ direction))
            offset = offset + x * (axes @ direction)
    turns = [a for a, _ in columns]
    relative = sum((rate * a for rate, a in zip(qd, turns, strict=True)), start=zero)
    sliding = sum((rate * b for rate, (_, b) in zip(qd, columns, strict=True)), start=zero)
    w = parent.omega
    frame = MovingFrame(
        R,
        parent.origin + offset,
        w + relative,
        parent.v + cross(w, offset) + sliding,
        parent.omega_dot + cross(w, relative),
        parent.v_dot + cross(parent.omega_dot, offset) + centripetal(w, offset) + 2 * cross(w, sliding),
    )
    return frame, np.array([np.concatenate(column) for column in columns]).T


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a quaternion, scalar first, of any length."""
    s, v = quaternion[0], quaternion[1:]
    k, size = cross_matrix(v), quaternion @ quaternion
    return np.eye(3, dtype=int) + (2 / size) * (s * k + k @ k)
