"""The equations of a closed chain at given accelerations and forces, as what is missing in each: the oracle's own.

Bodies move as plain kinematics says, accelerations included; each costs a wrench; what joints, floating base, grasps
and object lack of it is what is missing. Of the library only the data of its models are read. With unknowns z

    base       wrench on the floating base                                   (6,) if there is one
    joints     axis . wrench + armature qdd + damping qd + stiffness (q - rest) - tau        (n,)
    grasps     tip acceleration + g + H^T W_dot - that of the object's point               (6 g,)
    object     M alpha + b - external wrench - sum of A^T f                                  (6,)
    freedoms   H f                                                                  (as many as W)

all of them linear in z = (base acceleration, qdd, f, alpha, W_dot), in this order; accelerations true, weights forces.
Off the constraint contact point, axes and A are the object's, twist, J and acceleration the tip's, as in the library.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.trunk import TRUNK
from holdfast.spatial import scalar
from tests.oracles.arithmetic import Arithmetic
from tests.oracles.arm_kinematics import MovingFrame, centripetal, child_frame, cross
from tests.oracles.body_equations import moved

Given = Mapping[str, Any]

# contact axes about (0, 1, 2) and along (3, 4, 5) which the object is free, each on the object, the tip or the world
FREE = {
    "rigid": ((), ""),
    "hinge": ((0,), "o"),
    "softfinger": ((0, 1), "oo"),
    "ball": ((0, 1, 2), "www"),
    "universal": ((0, 1), "to"),
    "slider": ((3,), "o"),
    "cylinder": ((0, 3), "oo"),
    "screw": ((0,), "o"),
    "planar": ((2, 3, 4), "ooo"),
}


@dataclass(frozen=True)
class Unknowns:
    """Where the unknowns are in z, and the equations in what is missing."""

    base: slice
    qdd: slice
    f: slice
    alpha: slice
    rates: slice

    @property
    def size(self) -> int:
        """How many there are."""
        return self.rates.stop


def unknowns(chain: ClosedChain) -> Unknowns:
    """Return where a chain's unknowns are."""
    sizes = (6 if chain.floats else 0, chain.joint_count, 6 * len(chain.grasps), 6, chain.contact_freedom_count)
    ends = np.cumsum(sizes).tolist()
    return Unknowns(*(slice(end - size, end) for end, size in zip(ends, sizes, strict=True)))


@dataclass(frozen=True)
class Missing:
    """What is missing in every equation, and what the bases exert.

    Attributes:
        equations: in the order of `Unknowns`.
        base_wrench: (arms, 6) of base or trunk on each arm, about the arm's base origin.
        trunk_base_wrench: (6,) of the base on the trunk; what a floating base lacks.
    """

    equations: np.ndarray
    base_wrench: np.ndarray
    trunk_base_wrench: np.ndarray


@dataclass
class Strand:
    """Joints and links that follow each other, with what is fixed on them.

    Attributes:
        base: what the first joint stands on.
        frames: of the links.
        wrenches: of each link, d'Alembert's, about its origin; what is mounted on it is added.
        rows: of its joints among all joints.
        on_base: wrench of an anchor's grasp about its base's origin.
    """

    base: MovingFrame
    frames: list[MovingFrame]
    wrenches: list[np.ndarray]
    rows: range
    on_base: np.ndarray | None = None


def missing(chain: ClosedChain, given: Given, z: np.ndarray, numbers: Arithmetic) -> Missing:
    """Return what is missing in every equation.

    Args:
        chain: kinds, axes, places, tips and springs of joints are read.
        given: the rest, by name; see `tests.oracles.directions`.
        z: the unknowns.
        numbers: arithmetic; sine and cosine are the scalars' own.
    """
    return _Equations(chain, given, z, numbers).missing()


def relative_twists(chain: ClosedChain, given: Given, numbers: Arithmetic) -> np.ndarray:
    """Return what the object moves against the tips at every contact, (6 g,): all of it free where grasps hold."""
    equations = _Equations(chain, given, numbers.array(np.zeros(unknowns(chain).size)), numbers)
    strands = equations.strands()
    return np.concatenate([equations.tip(name, strands[name])[1] for name in chain.grasps])


class _Equations:
    """One evaluation."""

    def __init__(self, chain: ClosedChain, given: Given, z: np.ndarray, numbers: Arithmetic) -> None:
        self.chain, self.given, self.at = chain, given, (at := unknowns(chain))
        self.numbers = replace(numbers, sin=scalar.sin, cos=scalar.cos)
        self.z, self.qdd = z, z[at.qdd]
        self.held = MovingFrame(
            given["object_R"], given["object_p"], *np.split(given["object_twist"], 2), *np.split(z[at.alpha], 2)
        )

    def missing(self) -> Missing:
        """Return what is missing."""
        chain, given, at, strands = self.chain, self.given, self.at, self.strands()
        object_left = -given["object_wrench"] + self._body(
            self.held, given["object_mass"], given["object_com"], given["object_inertia"]
        )
        wrenches = np.reshape(self.z[at.f], (-1, 6))
        rates, left, free = self.z[at.rates], [], []
        for i, (name, grasp) in enumerate(chain.grasps.items()):
            strand, f = strands[name], wrenches[i]
            tip, gap, point = self.tip(name, strand)
            HT, g = self._freedoms(grasp, i, tip, gap)
            own = rates[chain.contact_freedoms[name]] if HT.shape[1] else np.zeros(0)
            lever = point - self.held.origin
            left.append(
                np.concatenate([tip.omega_dot, tip.v_dot]) + g + HT @ own - self._acceleration(self.held, lever)
            )
            free.append(f @ HT)
            object_left = object_left - moved(f[:3], f[3:], lever)
            last = strand.frames[-1] if strand.frames else strand.base
            own = moved(f[:3], f[3:], tip.origin - last.origin)
            if strand.frames:
                strand.wrenches[-1] = strand.wrenches[-1] + own
            else:  # an anchor
                strand.on_base = own
        joints: dict[int, Any] = {}
        felt = {name: self._inward(strand, joints) for name, strand in strands.items()}
        of_base = self._trunk_inward(felt, strands, joints)
        torques = [joints[k] + self._drive(k) for k in range(chain.joint_count)]
        equations = [of_base if chain.floats else np.zeros(0), np.array(torques), *left, object_left, *free]
        return Missing(np.concatenate(equations), np.array([felt[name] for name in chain.arms]), of_base)

    def strands(self) -> dict[str, Strand]:
        """Return the arms in motion, after the trunk."""
        chain, given = self.chain, self.given
        bodies, found = self._standing(), {}
        first = chain.joint_count - len(given["link_mass"])  # joints before those of the arms
        for i, (name, arm) in enumerate(chain.arms.items()):
            base = self._arm_base(i, bodies[chain.mounted_on[name]] if name in chain.mounted_on else None)
            links = [
                (given["link_mass"][k], given["link_com"][k], given["link_inertia"][k], given["link_wrench"][k])
                for k in range(chain.joints[name].start - first, chain.joints[name].stop - first)
            ]
            found[name] = self._strand(arm, base, links, chain.joints[name])
        return found

    def _standing(self) -> list[MovingFrame]:
        """Return the frames of the trunk's bodies, a floating base first, and remember their wrenches."""
        chain, given = self.chain, self.given
        if chain.trunk is None:
            return []
        trunk, numbers = chain.trunk, self.numbers
        if trunk.floating is None:
            moving = np.concatenate([given["trunk_base_twist"], given["trunk_base_acceleration"]])
            base = MovingFrame(numbers.array(trunk.base.R), numbers.array(trunk.base.p), *np.split(moving, 4))
        else:
            moving = np.concatenate([given["floating_twist"], self.z[self.at.base]])
            base = MovingFrame(given["floating_R"], given["floating_p"], *np.split(moving, 4))
        of_bodies = ("trunk_link_mass", "trunk_link_com", "trunk_link_inertia", "trunk_link_wrench")
        bodies = list(zip(*(given[name] for name in of_bodies), strict=True))
        self.of_floating = None
        if trunk.floating is not None:
            *constants, push = bodies[0]
            self.of_floating = self._body(base, *constants) - push
        links = bodies[len(bodies) - len(trunk.links) :]
        self.trunk = self._strand(trunk, base, links, chain.joints[TRUNK])
        return [*([base] if trunk.floating is not None else []), *self.trunk.frames]

    def _arm_base(self, i: int, below: MovingFrame | None) -> MovingFrame:
        """Return the frame that an arm stands on."""
        R, p = self.given["base_R"][i], self.given["base_p"][i]
        if below is None:
            moving = np.concatenate([self.given["base_twist"][i], self.given["base_acceleration"][i]])
            return MovingFrame(R, p, *np.split(moving, 4))
        at_point = below.point(p), below.omega, below.point_velocity(p), below.omega_dot, below.point_acceleration(p)
        return MovingFrame(below.R @ R, *at_point)

    def _strand(self, part, base: MovingFrame, links: list, rows: slice) -> Strand:
        """Return joints and links that follow each other, in motion."""
        frames, wrenches, before = [], [], base
        for k, joint, (mass, com, inertia, push) in zip(range(rows.start, rows.stop), part.joints, links, strict=True):
            given = {"R0": joint.placement.R, "p0": joint.placement.p, "axis": joint.axis, "type": joint.kind}
            frame = child_frame(before, given, self.given["q"][k], self.given["qd"][k], self.numbers)
            more = frame.axis * self.qdd[k]
            if frame.revolute:
                frame = replace(frame, omega_dot=frame.omega_dot + more)
            else:
                frame = replace(frame, v_dot=frame.v_dot + more)
            frames.append(frame)
            wrenches.append(self._body(frame, mass, com, inertia) - push)
            before = frame
        return Strand(base, frames, wrenches, range(rows.start, rows.stop))

    def _body(self, frame: MovingFrame, mass, com, inertia) -> np.ndarray:
        """Return the wrench that moves a body as it moves, its weight taken off, about its frame's origin."""
        mass = np.asarray(mass)[()]
        force = (frame.point_acceleration(com) - self.given["gravity"]) * mass
        w, w_dot = frame.R.T @ frame.omega, frame.R.T @ frame.omega_dot
        moment = frame.R @ (inertia @ w_dot + cross(w, inertia @ w))
        return moved(moment, force, frame.R @ com)

    def tip(self, name: str, strand: Strand) -> tuple[MovingFrame, np.ndarray, np.ndarray]:
        """Return an arm's tip, the object's velocity against it there, and the contact point."""
        tip, last = self.chain.arms[name].tip, (strand.frames or [strand.base])[-1]
        R, p = self.numbers.array(tip.R), self.numbers.array(tip.p)
        moving = last.omega, last.point_velocity(p), last.omega_dot, last.point_acceleration(p)
        found = MovingFrame(last.R @ R, last.point(p), *moving)
        i = list(self.chain.grasps).index(name)
        point = self.held.point(self.given["grasp_p"][i])
        if self.slides(self.chain.grasps[name]):
            point = found.origin
        turning = self.held.omega - found.omega
        sliding = self.held.v + cross(self.held.omega, point - self.held.origin) - found.v
        return found, np.concatenate([turning, sliding]), point

    @staticmethod
    def slides(grasp) -> bool:
        """Return whether the object's point at the tip moves."""
        return grasp.kind in ("slider", "cylinder", "screw", "planar", "subspace")

    def _freedoms(self, grasp, i: int, tip: MovingFrame, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return H^T (6, n_g) in world axes and g (6,)."""
        numbers, none = self.numbers, self.numbers.array(np.zeros(3))
        if grasp.kind == "rigid":
            return np.zeros((6, 0)), np.concatenate([none, none])
        axes, carried = self.held.R @ self.given["grasp_R"][i], FREE.get(grasp.kind, ((), ""))[1]
        if grasp.kind == "subspace":
            axes, local = tip.R, np.array(grasp.motion)
            carried = "t" * local.shape[1]
        else:
            local = np.eye(6)[:, list(FREE[grasp.kind][0])]
        if grasp.kind == "screw":
            local = local + grasp.pitch * np.eye(6)[:, [3]]
        if grasp.kind == "universal":
            x, y = tip.R[:, 0], axes[:, 1]
            z = cross(x, y)
            z = z / scalar.sqrt(z @ z)
            axes = np.array([cross(y, z), y, z]).T
        if grasp.kind == "ball":
            axes = numbers.array(np.eye(3))
        local = numbers.array(local)
        HT = np.concatenate([axes @ local[:3], axes @ local[3:]])
        in_axes = np.concatenate([gap[:3] @ axes, gap[3:] @ axes])
        W = numbers.array(np.linalg.pinv(local.astype(float))) @ in_axes
        turning, sliding = none, none
        for k, body in enumerate(carried):
            u, s = HT[:3, k] * W[k], HT[3:, k] * W[k]
            w = {"o": self.held.omega, "t": tip.omega, "w": none}[body]
            turning = turning + cross(w, u)
            if self.slides(grasp):
                sliding = sliding + cross(w, s) + cross(self.held.omega, s)
        return HT, np.concatenate([turning, sliding])

    @staticmethod
    def _acceleration(frame: MovingFrame, lever: np.ndarray) -> np.ndarray:
        """Return the acceleration of a body at a lever from its origin, (6,)."""
        linear = frame.v_dot + cross(frame.omega_dot, lever) + centripetal(frame.omega, lever)
        return np.concatenate([frame.omega_dot, linear])

    def _inward(self, strand: Strand, joints: dict[int, Any]) -> np.ndarray:
        """Note what joints feel of the links beyond them, and return the wrench of the base, about its origin."""
        total, where = None, None
        for k, frame, wrench in reversed(list(zip(strand.rows, strand.frames, strand.wrenches, strict=True))):
            total = wrench if total is None else wrench + moved(total[:3], total[3:], where - frame.origin)
            where = frame.origin
            joints[k] = frame.axis @ (total[:3] if frame.revolute else total[3:])
        if total is None:
            return self.numbers.array(np.zeros(6)) if strand.on_base is None else strand.on_base
        return moved(total[:3], total[3:], where - strand.base.origin)

    def _trunk_inward(self, felt: Mapping[str, np.ndarray], strands: Mapping[str, Strand], joints) -> np.ndarray:
        """Note what the trunk's joints feel, and return the wrench of its base about the base's origin."""
        chain = self.chain
        if chain.trunk is None:
            return self.numbers.array(np.zeros(6))
        first, total = (0 if chain.trunk.floating is None else 1), self.of_floating
        for name, k in chain.mounted_on.items():
            base, f = strands[name].base, felt[name]
            if k < first:
                total = total + moved(f[:3], f[3:], base.origin - self.trunk.base.origin)
            else:
                body = self.trunk.frames[k - first]
                own = moved(f[:3], f[3:], base.origin - body.origin)
                self.trunk.wrenches[k - first] = self.trunk.wrenches[k - first] + own
        of_joints = self._inward(self.trunk, joints)
        return of_joints if total is None else total + of_joints

    def _drive(self, k: int):
        """Return what a drive lacks beside what its joint feels."""
        joint, given, numbers = self._joint(k), self.given, self.numbers
        stiffness, rest = (numbers.array(x)[()] for x in (joint.stiffness, joint.rest))
        losses = given["damping"][k] * given["qd"][k] + stiffness * (given["q"][k] - rest)
        return given["armature"][k] * self.qdd[k] + losses - given["tau"][k]

    def _joint(self, k: int):
        """Return a joint by its place among all."""
        for name, rows in self.chain.joints.items():
            if rows.start <= k < rows.stop:
                part = self.chain.trunk if name == TRUNK else self.chain.arms[name]
                return part.joints[k - rows.start]
        raise IndexError(k)
