"""A trunk and its arms out of a URDF against Pinocchio's reading of the whole tree: frames, masses, dynamics.

A tray is held rigidly in all hands, where Pinocchio says that they are. The solution is the one at which
the tree, under the torques and the hands' wrenches, accelerates as `aba` and `rnea` say; the hands accelerate as one
rigid body; and the wrenches on that body give it this acceleration (Newton and Euler).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

import holdfast as hf
from holdfast.dynamics.trunk.trunk_motion import trunk_at_rest
from holdfast.robots.arms_on_trunk import ArmsOnTrunk
from holdfast.spatial import rotation
from tests.robots.pinocchio_urdf import Models, frame, held, put
from tests.systems.problems import relative_gap

GRAVITY = np.array([0.0, 0.0, -9.81])
TRAY = hf.HeldObject.box(4.0, 0.3, 0.5, 0.1)


class Gaps(NamedTuple):
    """Relative gaps.

    Attributes:
        frames: of the trunk's bodies and the tips [m, 1].
        mass: of all that moves.
        acceleration: of the joints and of a floating base, against `aba`.
        torque: of the drives that `rnea` asks for these accelerations; none at a floating base.
        hands: of the hands' accelerations and the tray's.
        tray: of the wrenches on the tray and what its acceleration asks for.
    """

    frames: float
    mass: float
    acceleration: float
    torque: float
    hands: float
    tray: float


class Tree:
    """Pinocchio's model of a robot whose other joints are held, at one state."""

    def __init__(self, xml: str, found: ArmsOnTrunk, seed: int = 1) -> None:
        random = np.random.default_rng(seed)
        self.floats = found.trunk.floating is not None
        self.joints = [*found.trunk.joints, *(joint for arm in found.arms.values() for joint in arm.joints)]
        models = Models(xml)
        self.model = held(models.free if self.floats else models.fixed, self.joints, found.locked)
        self.data = self.model.createData()
        self.at = pin.neutral(self.model)
        self.q = random.uniform(-1, 1, len(self.joints))
        for joint, position in zip(self.joints, self.q, strict=True):
            put(self.model, self.at, joint.name, position)
        self.order = [self.model.joints[self.model.getJointId(joint.name)].idx_v for joint in self.joints]
        self.base = hf.Pose.identity()
        if self.floats:
            self.base = hf.Pose(rotation.exp(random.normal(size=3)), random.normal(size=3))
            self.at[:7] = pin.SE3ToXYZQUAT(pin.SE3(self.base.R, self.base.p))
        pin.framesForwardKinematics(self.model, self.data, self.at)

    def pose(self, link: str) -> hf.Pose:
        """Return the pose of a link."""
        placed = self.data.oMf[frame(self.model, link)]
        return hf.Pose(placed.rotation, placed.translation)

    def rates(self, qd: np.ndarray, base_twist: np.ndarray | None) -> np.ndarray:
        """Return the model's velocity; a free flyer's is [linear; angular] in its own axes."""
        v = np.zeros(self.model.nv)
        v[self.order] = qd
        if base_twist is not None:
            v[:6] = np.r_[self.base.R.T @ base_twist[3:], self.base.R.T @ base_twist[:3]]
        return v

    def drive(self, tau: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Return the model's generalised forces: torques less what dampers take; none at a free flyer."""
        drive = np.zeros(self.model.nv)
        drive[self.order] = tau - np.array([joint.damping for joint in self.joints]) * qd
        return drive

    def rates_of_rates(self, v: np.ndarray, qdd: np.ndarray, base_acceleration: np.ndarray | None) -> np.ndarray:
        """Return the model's acceleration; a free flyer's turns with it."""
        a = self.rates(qdd, base_acceleration)
        if base_acceleration is not None:
            a[:3] -= np.cross(v[3:6], v[:3])
        return a


def gaps(xml: str, found: ArmsOnTrunk, tips: dict[str, str], tray: hf.HeldObject = TRAY, kind: str = "rigid") -> Gaps:
    """Return the gaps of a robot with a tray in its hands, at a random state; all grasps rigid, or all balls."""
    random, tree = np.random.default_rng(0), Tree(xml, found)
    chain, state = holding(tree, found, tips, tray, kind, random)
    tau = random.normal(size=len(tree.q))
    result = hf.forward_dynamics(chain, state, tau)
    return Gaps(
        _frames(tree, chain, state, tips), _mass(tree, found), *_dynamics(tree, chain, state, tau, result, tips)
    )


def holding(
    tree: Tree, found: ArmsOnTrunk, tips: dict[str, str], tray: hf.HeldObject, kind: str, random: np.random.Generator
) -> tuple[hf.ClosedChain, hf.State]:
    """Return the robot with a tray in its hands where Pinocchio says that they are, in motion; all grasps of a kind."""
    tray_at = hf.Pose(
        rotation.exp(random.normal(size=3)), np.mean([tree.pose(link).p for link in tips.values()], axis=0)
    )
    grasps = {name: hf.Grasp(kind, tray_at.inverse() @ tree.pose(link)) for name, link in tips.items()}
    chain = hf.ClosedChain(found.arms, tray, grasps, GRAVITY, found.trunk, found.mounts)
    base = {"base_pose": tree.base, "base_twist": random.normal(size=6)} if tree.floats else {}
    moving = hf.State(tree.q, random.normal(size=len(tree.q)), tray_at, random.normal(size=6), **base)
    return chain, hf.dynamics.project_velocity(chain, moving)


def _frames(tree: Tree, chain: hf.ClosedChain, state: hf.State, tips: dict[str, str]) -> float:
    """Return the largest gap of the frames of trunk and tips."""
    placed, worst = trunk_at_rest(chain, state), 0.0
    pairs = [(body.frame, tree.pose(link.name)) for body, link in zip(placed.bodies, chain.trunk.bodies, strict=True)]
    for name, arm in chain.arms.items():
        stands = placed.mounts[name].frame if name in placed.mounts else arm.base
        pairs.append((hf.dynamics.tip_pose(arm.at(stands), state.q[chain.joints[name]]), tree.pose(tips[name])))
    for ours, theirs in pairs:
        worst = max(worst, np.abs(ours.p - theirs.p).max(), np.abs(ours.R - theirs.R).max())
    return float(worst)


def _mass(tree: Tree, found: ArmsOnTrunk) -> float:
    """Return the gap of the mass that moves."""
    links = [*found.trunk.bodies, *(link for arm in found.arms.values() for link in arm.links)]
    return relative_gap(sum(link.mass for link in links), pin.computeTotalMass(tree.model))


def _dynamics(
    tree: Tree, chain: hf.ClosedChain, state: hf.State, tau: np.ndarray, result: hf.ForwardResult, tips: dict[str, str]
) -> tuple[float, float, float, float]:
    """Return the gaps of accelerations, torques, hands and tray."""
    model, data = tree.model, tree.data
    v, drive = tree.rates(state.qd, state.base_twist), tree.drive(tau, state.qd)
    pushes, C = [pin.Force.Zero() for _ in model.joints], state.object_pose[4:]
    on_tray = np.zeros(6)
    for name, link in tips.items():
        wrench, number = result[name].grasp_wrench, frame(model, link)
        moment, force, p = wrench[:3], wrench[3:], data.oMf[number].translation
        on_tray += np.r_[moment + np.cross(p - C, force), force]
        at_origin = pin.Force(-force, -(moment + np.cross(p, force)))
        joint = model.frames[number].parentJoint
        pushes[joint] += data.oMi[joint].actInv(at_origin)
    a = tree.rates_of_rates(v, result.qdd, result.base_acceleration)
    acceleration = relative_gap(a, np.array(pin.aba(model, data, tree.at, v, drive, pushes)))
    torque = relative_gap(np.array(pin.rnea(model, data, tree.at, v, a, pushes)), drive)
    pin.forwardKinematics(model, data, tree.at, v, a)
    hands = 0.0
    omega, spin, alpha = state.object_twist[:3], result.object_acceleration[:3], result.object_acceleration
    for link in tips.values():
        number = frame(model, link)
        found = pin.getFrameClassicalAcceleration(model, data, number, pin.LOCAL_WORLD_ALIGNED)
        r = data.oMf[number].translation - C
        rigid = np.r_[spin, alpha[3:] + np.cross(spin, r) + np.cross(omega, np.cross(omega, r))]
        turns = 3 if all(grasp.kind == "ball" for grasp in chain.grasps.values()) else 0  # a ball leaves turning free
        hands = max(hands, relative_gap(np.r_[found.angular, found.linear][turns:], rigid[turns:]))
    R = state.object_frame.R
    inertia = R @ chain.held_object.inertia @ R.T
    asked = np.r_[
        inertia @ spin + np.cross(omega, inertia @ omega), chain.held_object.mass * (alpha[3:] - chain.gravity)
    ]
    return acceleration, torque, hands, relative_gap(on_tray, asked)
