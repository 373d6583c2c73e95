"""Chains that hold by sliding, turning and threaded grasps, and the same with massless joints in their places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import holdfast as hf
from holdfast.dynamics.closed.object_motion import object_motion
from holdfast.model.joint_types import JOINT_TYPES, JointType
from holdfast.spatial import rotation
from tests.systems.random_parts import rotation as random_rotation

PITCH = 0.05  # m/rad
SHARE = 0.15  # of the object, which the last of the massless joints moves instead
X, Y, Z = np.eye(3)
# how the contact frame moves, seen from the tip
JOINTS = {
    "universal": (("revolute", X), ("revolute", Y)),
    "slider": (("prismatic", X),),
    "cylinder": (("revolute", X), ("prismatic", X)),
    "screw": (("lead", X),),
    "planar": (("prismatic", X), ("prismatic", Y), ("revolute", Z)),
}
# groups that have no name among the kinds of grasps
E = np.eye(6)
MOTIONS = {
    "two slides": E[:, [3, 4]],
    "three slides": E[:, 3:],
    "scara": E[:, 2:],
    "lead in a plane": np.column_stack([E[0] + PITCH * E[3], E[4], E[5]]),
}
JOINTS |= {
    "two slides": (("prismatic", X), ("prismatic", Y)),
    "three slides": (("prismatic", X), ("prismatic", Y), ("prismatic", Z)),
    "scara": (("prismatic", X), ("prismatic", Y), ("prismatic", Z), ("revolute", Z)),
    "lead in a plane": (("prismatic", Y), ("prismatic", Z), ("lead", X)),
}
LEAD = JointType(turns=True, travel=PITCH)


@dataclass(frozen=True)
class Pair:
    """A chain in motion, and what it is by joints.

    Attributes:
        chain, state, tau: the chain by its grasps.
        by_joints, same: the chain with joints for grasps, rigid ones beyond them, and its state.
        own: where the chain's joints are among those of `by_joints`.
    """

    chain: hf.ClosedChain
    state: hf.State
    tau: np.ndarray
    by_joints: hf.ClosedChain
    same: hf.State
    own: list[int]

    def torques_of_joints(self) -> np.ndarray:
        """Return the torques of the chain by joints; the massless ones have none."""
        tau = np.zeros(self.by_joints.joint_count)
        tau[self.own] = self.tau
        return tau

    def wrenches(self, found: hf.dynamics.ForwardResult) -> np.ndarray:
        """Return each arm's wrench on the whole object about its tip, from what the chain by joints found."""
        frame, wrenches, body = self.state.object_frame, [], self.chain.held_object
        share = hf.HeldObject(SHARE * body.mass, SHARE * body.inertia, body.com)
        moving = object_motion(share, frame, self.state.object_twist, np.zeros(6))
        weight = np.concatenate([np.zeros(3), self.chain.gravity])
        about_C = moving.inertia.apply(found.object_acceleration - weight) + moving.bias
        for i, (name, grasp) in enumerate(self.chain.grasps.items()):
            origin = frame.R @ grasp.frame.p
            moment, force = np.split(found.grasp_wrench[i], 2)
            if slides(grasp):
                moment = moment + about_C[:3] - np.cross(origin, about_C[3:])
                force = force + about_C[3:]
            tip = hf.dynamics.tip_pose(self.chain.arms[name], self.state.q[self.chain.joints[name]]).p
            lever = frame.p + origin - tip if slides(grasp) else np.zeros(3)
            wrenches.append(np.concatenate([moment + np.cross(lever, force), force]))
        return np.array(wrenches)


def pair(kinds: tuple[str, ...], seed: int, joints: int = 7) -> Pair:
    """Return a random chain of arms that hold by these kinds; JOINT_TYPES must have "lead", see `with_lead`."""
    random = np.random.default_rng(seed)
    arms, by_joints, grasps, q, every, own = {}, {}, {}, [], [], []
    body = hf.HeldObject(3.0, _inertia(random), 0.1 * random.normal(size=3))
    object_frame = _pose(random, 0.3)
    for i, kind in enumerate(kinds):
        links = [
            hf.Link(random.uniform(0.5, 2.0), 0.1 * random.normal(size=3), _inertia(random)) for _ in range(joints)
        ]
        made = [hf.Joint("revolute", _unit(random), _pose(random, 0.3)) for _ in range(joints)]
        arm = hf.Arm(made, links, _pose(random, 0.2), _pose(random, 0.5))
        of_arm = random.normal(size=joints)
        at, frame, more, moved = hf.dynamics.tip_pose(arm, of_arm), arm.tip, [], []
        for joint, axis in JOINTS.get(kind, ()):
            x = random.normal(scale=0.4)
            turn, slide = x * (joint != "prismatic"), {"prismatic": x, "lead": PITCH * x}.get(joint, 0.0)
            at = at @ hf.Pose(rotation.exp(turn * axis), slide * axis)
            more.append(hf.Joint(joint, axis, frame))
            moved.append(x)
            frame = hf.Pose.identity()
        contact = object_frame.inverse() @ at
        own += [len(every) + k for k in range(joints)]
        q += list(of_arm)
        every += [*of_arm, *moved]
        arms[f"arm{i}"] = arm
        grasps[f"arm{i}"] = grasp_of(kind, contact)
        by_joints[f"arm{i}"] = hf.Arm([*made, *more], [*links, *_massless(more, body, contact)], frame, arm.base)
    rest = 1.0 - SHARE * sum(kind in JOINTS for kind in kinds)
    rigid = {name: hf.Grasp("rigid" if slides(grasp) else grasp.kind, grasp.frame) for name, grasp in grasps.items()}
    other = hf.ClosedChain(by_joints, hf.HeldObject(rest * body.mass, rest * body.inertia, body.com), rigid)
    rates = random.normal(size=len(every)), random.normal(size=6)
    same = hf.dynamics.project_velocity(other, hf.State(every, rates[0], object_frame.wxyz_xyz, rates[1]))
    state = hf.State(q, same.qd[own], same.object_pose, same.object_twist)
    return Pair(hf.ClosedChain(arms, body, grasps), state, random.normal(size=len(q), scale=5.0), other, same, own)


def slides(grasp: hf.Grasp) -> bool:
    """Whether joints stand for a grasp."""
    return grasp.kind in JOINTS or grasp.kind == "subspace"


def grasp_of(kind: str, contact: hf.Pose) -> hf.Grasp:
    """Return a grasp by its kind, or by what its motion is called here."""
    if kind in MOTIONS:
        return hf.Grasp("subspace", contact, motion=MOTIONS[kind])
    return hf.Grasp(kind, contact, pitch=PITCH if kind == "screw" else None)


def with_lead(patch) -> None:
    """Put the joint type of a thread into the table while a test runs."""
    patch.setitem(JOINT_TYPES, "lead", LEAD)


def _massless(more: list[hf.Joint], body: hf.HeldObject, contact: hf.Pose) -> list[hf.Link]:
    """Return links without mass but for the last, which has a share of the object."""
    if not more:
        return []
    back = contact.inverse()
    share = hf.Link(SHARE * body.mass, back.R @ body.com + back.p, SHARE * back.R @ body.inertia @ back.R.T)
    return [*(hf.Link(0.0) for _ in more[1:]), share]


def _pose(random: np.random.Generator, size: float) -> hf.Pose:
    return hf.Pose(random_rotation(random), random.normal(size=3, scale=size))


def _inertia(random: np.random.Generator) -> np.ndarray:
    Q, (a, b, c) = random_rotation(random), random.uniform(0.01, 0.05, 3)
    return Q @ np.diag([b + c, a + c, a + b]) @ Q.T


def _unit(random: np.random.Generator) -> np.ndarray:
    v = random.normal(size=3)
    return v / np.linalg.norm(v)
