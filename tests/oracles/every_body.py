"""Forward dynamics of arms on a trunk with nothing eliminated: the oracle.

Every body has six accelerations of its own, every joint an acceleration and the whole wrench across it, every grasp a
force along each of its rows. All are unknowns of one symmetric system:

    body     M alpha - w + (w of the joints further out) = weight, external wrenches, velocity terms
    joint    alpha = alpha of the body before, carried over, + axis qdd + velocity terms
    drive    axis . w + armature qdd = tau - damper - spring
    grasp    row . (acceleration of the object - that of the tip) = velocity terms

Of the library only the data of its models are read. Where rows of the grasps follow from others, forces are not unique;
as many rows are kept as are independent, and accelerations do not depend on which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import qr

from holdfast.model.trunk import TRUNK
from holdfast.spatial.pose import Pose
from tests.oracles.arithmetic import SparseSystem, arithmetic
from tests.oracles.arm_kinematics import MovingFrame, centripetal, child_frame, cross, cross_matrix
from tests.oracles.body_equations import body_equation, moved
from tests.oracles.grasp_rows import Side, grasp_rows
from tests.systems.as_chain import Problem

NULL = 1e-11  # of the largest eigenvalue: smaller ones belong to rows that follow from others
CLEARLY_NULL = 1e-13


class Crossed(NamedTuple):
    """A joint among the unknowns.

    Attributes:
        frame: of the link it moves.
        qdd: its acceleration.
        wrench: of the body before on the link, about the link's origin.
    """

    frame: MovingFrame
    qdd: slice
    wrench: slice


class Body(NamedTuple):
    """A body among the unknowns, or the base in the world that an anchor is on.

    Attributes:
        frame: pose and velocities, accelerations 0; of a base in the world its own.
        alpha: its accelerations; None of a base in the world.
        path: the joints below it, base outward.
        on_base: whether a floating base is below it, or it is the base.
    """

    frame: MovingFrame
    alpha: slice | None
    path: tuple[Crossed, ...] = ()
    on_base: bool = False


class Held(NamedTuple):
    """A grasp among the unknowns.

    Attributes:
        rows: (k, 6) of its wrench, world axes.
        forces: along its rows.
        point: (3,) that its wrench is about.
        link: the arm's last; what it stands on, of an anchor.
    """

    rows: np.ndarray
    forces: slice
    point: np.ndarray
    link: Body


@dataclass(frozen=True, eq=False)
class Truth:
    """What the oracle finds, in float64; the fields are those of `ForwardResult`, `felt` that of `EveryBody.felt`."""

    qdd: np.ndarray
    grasp_wrench: np.ndarray
    object_acceleration: np.ndarray
    base_wrench: np.ndarray
    trunk_base_wrench: np.ndarray
    base_acceleration: np.ndarray | None
    felt: np.ndarray


class EveryBody:
    """The system of a problem.

    Attributes:
        values: eigenvalues of the equation of the grasps' forces, scaled to a unit diagonal, ascending.
        rank: how many rows of the grasps are independent.
    """

    def __init__(self, problem: Problem, digits: int | None = None) -> None:
        """Write down every equation in float64 (`digits=None`) or in so many digits."""
        self.problem, self.numbers = problem, arithmetic(digits)
        with self.numbers.precision():
            self._write_down()
        self.values, strongest = self._judged()
        self.rank = int((self.values > NULL * self.values.max(initial=0.0)).sum())
        dependent = set(strongest[self.rank :])
        self.kept = [i for i in range(len(self.system.rows)) if i not in dependent]
        self.dependent = sorted(dependent)

    @property
    def unique(self) -> bool:
        """Whether forces are."""
        return not self.dependent

    @property
    def condition(self) -> float:
        """Of the rows that are kept, without units; infinite where it is not clear which follow from others."""
        if not len(self.values):
            return 1.0
        largest, rank = self.values[-1], self.rank
        clear = self.unique or abs(self.values[-rank - 1]) < CLEARLY_NULL * largest
        return float(largest / self.values[-rank]) if clear else np.inf

    @property
    def grip(self) -> float:
        """How firmly the rows hold the object: their least over their largest singular value; 0 if it can slip away."""
        rows = [h.rows @ self._carried(h.point - self.object.frame.origin) for h in self.held.values()]
        if sum(map(len, rows)) < 6:
            return 0.0
        values = np.linalg.svd(np.vstack(rows).astype(float), compute_uv=False)
        return float(values[-1] / values[0])

    def solved(self) -> tuple[Truth, float]:
        """Return the solution, and by how much the rows that are not kept are missed.

        Raises:
            ArithmeticError: the system is nearly singular.
        """
        with self.numbers.precision():
            x = self.system.solved(self.kept)
            missed = max((abs(float(left)) for left in self.system.residual(x, self.dependent)), default=0.0)
            return self._named(x), missed

    def felt(self, wrenches: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return what drives, floating base and object feel of the grasps: J^T f, and the sum of A^T f.

        Args:
            wrenches: of each arm that holds, on the object, about the contact.
        """
        place = {id(joint): k for k, joint in enumerate(self.joints)}
        torques, base, total = np.zeros(len(self.joints)), np.zeros(6), np.zeros(6)
        for name, f in wrenches.items():
            point, link = self.held[name].point, self.held[name].link
            total += _seen_from(self.object.frame, f, point)
            if link.on_base:
                base += _seen_from(self.base.frame, f, point)
            for joint in link.path:
                torques[place[id(joint)]] += _column(joint.frame).astype(float) @ _seen_from(joint.frame, f, point)
        return np.concatenate([torques, base, total])

    def _write_down(self) -> None:
        """Write down every equation; bodies of the trunk first."""
        chain, state, numbers = self.problem.chain, self.problem.state, self.numbers
        inputs = self.problem.inputs.shaped(chain)
        self.system = SparseSystem(numbers)
        self.joints: list[Crossed] = []
        self.bases: dict[str, np.ndarray] = {}
        self.base = None
        standing = self._trunk(inputs) if chain.trunk is not None else []
        count = sum(arm.joint_count for arm in chain.arms.values())
        pushes = np.zeros((count, 6)) if inputs.link_wrenches is None else inputs.link_wrenches
        before = len(self.joints)
        last = {}
        for i, (name, arm) in enumerate(chain.arms.items()):
            R, p = numbers.array(arm.base.R), numbers.array(arm.base.p)
            below = standing[chain.mounted_on[name]] if name in chain.mounted_on else None
            if below is None:
                base = self._driven(R, p, inputs.base_twists[i], inputs.base_accelerations[i])
            else:
                at = below.frame
                moving = (at.omega, at.point_velocity(p), at.omega_dot, at.point_acceleration(p))
                base = MovingFrame(at.R @ R, at.point(p), *moving)
            self.bases[name] = base.origin
            links = self._serial(arm, base, below, pushes[len(self.joints) - before :])
            on = (Body(base, None), arm.tip) if below is None else (below, arm.base @ arm.tip)
            last[name] = (links[-1], arm.tip) if links else on
        frame = self._free(state.object_pose, state.object_twist)
        self.object = self._body(chain.held_object, frame, inputs.object_wrench)
        self.held = {name: self._grasp(name, *last[name]) for name in chain.grasps}

    def _trunk(self, inputs) -> list[Body]:
        """Write down the trunk's equations and return its bodies."""
        trunk, state, numbers = self.problem.chain.trunk, self.problem.state, self.numbers
        pushes = np.zeros((len(trunk.bodies), 6)) if inputs.trunk_link_wrenches is None else inputs.trunk_link_wrenches
        if trunk.floating is None:
            R, p = numbers.array(trunk.base.R), numbers.array(trunk.base.p)
            base = self._driven(R, p, inputs.trunk_base_twist, inputs.trunk_base_acceleration)
            self.bases[TRUNK] = base.origin
            return self._serial(trunk, base, None, pushes)
        free = self._body(trunk.floating, self._free(state.base_pose, state.base_twist), pushes[0])
        self.base = free._replace(on_base=True)
        return [self.base, *self._serial(trunk, self.base.frame, self.base, pushes[1:])]

    def _serial(self, part, base: MovingFrame, below: Body | None, pushes: np.ndarray) -> list[Body]:
        """Write down the equations of joints and links that follow each other, and return the links.

        Args:
            part: an arm or a trunk.
            base: what the first joint stands on, with the accelerations that no unknown gives it.
            below: the body it is fixed on; None if it is prescribed.
            pushes: external wrenches on the links about their origins.
        """
        bodies, numbers, state = [], self.numbers, self.problem.state
        none = numbers.array(np.zeros(3))
        for joint, link, push in zip(part.joints, part.links, pushes[: len(part.joints)], strict=True):
            k = len(self.joints)
            q, qd, tau = (numbers.array(x[k])[()] for x in (state.q, state.qd, self.problem.tau))
            given = {"R0": joint.placement.R, "p0": joint.placement.p, "axis": joint.axis, "type": joint.kind}
            frame = child_frame(base, given, q, qd, numbers)
            body = self._body(link, replace(frame, omega_dot=none, v_dot=none), push)
            damping, stiffness, rest, armature = (
                numbers.array(x)[()] for x in (joint.damping, joint.stiffness, joint.rest, joint.armature)
            )
            drive = self.system.unknowns(np.array([tau - damping * qd - stiffness * (q - rest)]))
            wrench = self.system.unknowns(-np.concatenate([frame.omega_dot, frame.v_dot]))
            self.system.add(drive, drive, np.array([[armature]]))
            self.system.add_both(wrench, drive, _column(frame)[:, None])
            self.system.add_both(wrench, body.alpha, -numbers.array(np.eye(6)))
            if below is not None:
                self.system.add_both(wrench, below.alpha, self._carried(frame.origin - below.frame.origin))
            crossed = Crossed(body.frame, drive, wrench)
            self.joints.append(crossed)
            path, on_base = (below.path, below.on_base) if below is not None else ((), False)
            below = body._replace(path=(*path, crossed), on_base=on_base)
            base = below.frame
            bodies.append(below)
        return bodies

    def _grasp(self, name: str, link: Body, tip: Pose) -> Held:
        """Write down the rows of a grasp by a tip on a link, in whose axes it is given."""
        numbers = self.numbers
        grasp, held = self.problem.chain.grasps[name], self.object.frame
        point = link.frame.point(numbers.array(tip.p))
        speed = link.frame.point_velocity(numbers.array(tip.p))
        w, of_link = held.omega, link.frame.omega
        rows = grasp_rows(
            grasp,
            Side(held.R @ numbers.array(grasp.frame.R), w),
            Side(link.frame.R @ numbers.array(tip.R), of_link),
            numbers,
        )
        turning, sliding = w - of_link, held.v + cross(w, point - held.origin) - speed
        # where the object slides, another of its points is at the tip in the next instant
        passing = cross(w, speed - held.v) - centripetal(of_link, point - link.frame.origin)
        rhs = [row.n @ passing + row.m_dot @ turning + row.n_dot @ sliding for row in rows]
        K = np.array([np.concatenate([row.m, row.n]) for row in rows])
        carried = self._carried(point - link.frame.origin)
        if link.alpha is None:
            rhs = rhs - K @ carried @ np.concatenate([link.frame.omega_dot, link.frame.v_dot])
        forces = self.system.unknowns(np.array(rhs, dtype=object))
        self.system.add_both(forces, self.object.alpha, -(K @ self._carried(point - held.origin)))
        if link.alpha is not None:
            self.system.add_both(forces, link.alpha, K @ carried)
        return Held(K, forces, point, link)

    def _body(self, link, frame: MovingFrame, push: np.ndarray) -> Body:
        """Write down the equations of a body on which nothing but its weight and a wrench acts yet."""
        given = {"mass": link.mass, "com": link.com, "inertia": link.inertia, "wrench": push}
        equation = body_equation(given, frame, self.numbers.array(self.problem.chain.gravity), self.numbers)
        alpha = self.system.unknowns(-equation.bias)
        self.system.add(alpha, alpha, equation.M)
        return Body(frame, alpha)

    def _free(self, pose: np.ndarray, twist: np.ndarray) -> MovingFrame:
        """Return the frame of a body that nothing drives."""
        quaternion, none = self.numbers.array(pose[:4]), self.numbers.array(np.zeros(3))
        R, origin = _rotation(quaternion), self.numbers.array(pose[4:])
        return MovingFrame(R, origin, self.numbers.array(twist[:3]), self.numbers.array(twist[3:]), none, none)

    def _driven(self, R: np.ndarray, p: np.ndarray, twist: np.ndarray, acceleration: np.ndarray) -> MovingFrame:
        """Return the frame of a base that is driven."""
        given = (twist[:3], twist[3:], acceleration[:3], acceleration[3:])
        return MovingFrame(R, p, *(self.numbers.array(x) for x in given))

    def _carried(self, lever: np.ndarray) -> np.ndarray:
        """Return the map of a body's acceleration to that of a point at a lever, without velocity terms, (6, 6)."""
        matrix = self.numbers.array(np.eye(6))
        matrix[3:, :3] = -cross_matrix(lever)
        return matrix

    def _judged(self) -> tuple[np.ndarray, list[int]]:
        """Return the eigenvalues of the grasps' equation, ascending, and the grasps' unknowns, strongest first."""
        forces = [i for held in self.held.values() for i in range(held.forces.start, held.forces.stop)]
        if not forces:
            return np.zeros(0), []
        others = sorted(set(range(len(self.system.rows))) - set(forces))
        C = self.system.floats(forces, others).toarray()
        omega = C @ self.system.factors(others).solve(C.T)
        scale = 1.0 / np.sqrt(np.diag(omega))
        scaled = omega * np.outer(scale, scale)
        order = qr(scaled, mode="r", pivoting=True)[1]
        return np.linalg.eigvalsh((scaled + scaled.T) / 2), [forces[i] for i in order]

    def _named(self, x: np.ndarray) -> Truth:
        """Name the parts of a solution."""
        chain, numbers = self.problem.chain, self.numbers
        zero = numbers.array(np.zeros(6))
        f = {name: held.rows.T @ x[held.forces] for name, held in self.held.items()}

        def at_base(name: str) -> np.ndarray:
            if name in chain.arms and not chain.arms[name].joints:
                held = self.held.get(name)
                return zero if held is None else moved(*np.split(f[name], 2), held.point - self.bases[name])
            joint = self.joints[chain.joints[name].start]
            moment, force = np.split(x[joint.wrench], 2)
            return moved(moment, force, joint.frame.origin - self.bases[name])

        return Truth(
            np.array([float(x[joint.qdd][0]) for joint in self.joints]),
            _floats([f.get(name, zero) for name in chain.arms]),
            _floats(x[self.object.alpha]),
            _floats([at_base(name) for name in chain.arms]),
            _floats(at_base(TRUNK) if TRUNK in self.bases else zero),
            None if self.base is None else _floats(x[self.base.alpha]),
            self.felt({name: _floats(one) for name, one in f.items()}),
        )


def _seen_from(frame: MovingFrame, f: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return a wrench about a point as it is about a frame's origin, in float64."""
    return moved(f[:3], f[3:], (point - frame.origin).astype(float))


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a quaternion, scalar first, of any length."""
    s, v = quaternion[0], quaternion[1:]
    k, size = cross_matrix(v), quaternion @ quaternion
    return np.eye(3, dtype=int) + (2 / size) * (s * k + k @ k)


def _column(frame: MovingFrame) -> np.ndarray:
    """Return the motion of a joint's link by unit rate, about the link's origin, (6,)."""
    none = 0 * frame.axis
    return np.concatenate([frame.axis, none] if frame.revolute else [none, frame.axis])


def _floats(x: Sequence | np.ndarray) -> np.ndarray:
    return np.array(x, dtype=object).astype(float)
