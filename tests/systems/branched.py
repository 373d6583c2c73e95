"""Chains with branches: two arms with grippers, one of which holds a box with a finger."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

import holdfast as hf
from holdfast.spatial import scalar

FINGERS = ("finger1", "finger2")


class Branched(NamedTuple):
    """A chain that is answered as a forest.

    Attributes:
        chain: the chain.
        state: a state that keeps its grasps and couplings.
        tau: torques.
    """

    chain: hf.ClosedChain
    state: hf.State
    tau: np.ndarray


def link(name: str, mass: float = 1.0) -> hf.Link:
    """Return a link whose mass centre is off its joint."""
    return hf.Link(mass, [0.02, 0.05, -0.03], mass * np.diag([0.01, 0.02, 0.015]), name)


def arm_with_gripper(joints: int = 6) -> hf.Arm:
    """Return an arm with two fingers on its last link, which close by equal strokes: a mimic joint."""
    axes, at = (
        ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]),
        hf.Pose.from_rpy(0.2, -0.1, 0.3, xyz=(0.2, 0.1, 0.15)),
    )
    own = [hf.Joint(axis=axes[k % 3], placement=at, name=f"joint{k + 1}", damping=0.1) for k in range(joints)]
    along = hf.Pose.translation(0.05, 0.0, 0.1)
    fingers = [
        hf.Joint("prismatic", [0.0, sign, 0.0], along, name, armature=0.01)
        for name, sign in zip(FINGERS, (1.0, -1.0), strict=True)
    ]
    links = [*(link(f"link{k + 1}") for k in range(joints)), *(link(name, 0.2) for name in FINGERS)]
    parents = [None, *range(joints - 1), joints - 1, joints - 1]
    pads = {f"pad{k + 1}": (name, hf.Pose.translation(0.0, 0.0, 0.04)) for k, name in enumerate(FINGERS)}
    mimic = [hf.Coupling({FINGERS[0]: 1.0, FINGERS[1]: -1.0})]
    return hf.Arm([*own, *fingers], links, parents=parents, frames=pads, couplings=mimic)


def two_arms_with_grippers(seed: int = 0) -> Branched:
    """Return two arms, the first of which holds a box by a rigid grasp of its palm and a ball at the pad of a finger.

    The second one holds it by a soft finger at its palm. At rest, since the fingers keep the box.
    """
    random = np.random.default_rng(seed)
    arms = {"arm1": arm_with_gripper(), "arm2": arm_with_gripper().at(hf.Pose.translation(0.5, 0.4, 0.0))}
    q = random.normal(size=16, scale=0.4)
    q[[6, 7, 14, 15]] = [0.03, 0.03, 0.05, 0.05]
    places = {name: hf.dynamics.link_poses(arm, q[8 * i : 8 * i + 8]) for i, (name, arm) in enumerate(arms.items())}
    box = hf.Pose.from_rpy(0.1, 0.2, 0.3, xyz=(0.4, 0.3, 0.5))
    pad = places["arm1"][6] @ arms["arm1"].frames["pad1"][1]
    grasps = {
        ("arm1", "link6"): hf.Grasp("rigid", box.inverse() @ places["arm1"][5]),
        ("arm1", "pad1"): hf.Grasp("ball", box.inverse() @ pad),
        ("arm2", "link6"): hf.Grasp("softfinger", box.inverse() @ places["arm2"][5]),
    }
    chain = hf.ClosedChain(arms, hf.HeldObject.box(2.0, 0.3, 0.2, 0.1), grasps)
    return Branched(chain, hf.State(q, np.zeros(16), box), random.normal(size=16))


def moving(chain: hf.ClosedChain, near: hf.State, seed: int = 0, speed: float = 0.5) -> Branched:
    """Return a chain in motion at the closed state near a guess, with random rates and torques of its drives."""
    random = np.random.default_rng(seed)
    guess = hf.State(
        near.q,
        random.normal(size=len(near.qd), scale=speed),
        near.object_pose,
        random.normal(size=near.object_twist.shape, scale=speed),
        near.base_pose,
        None if near.base_pose is None else random.normal(size=6, scale=speed),
    )
    driven = np.concatenate([[joint.actuated] * joint.type.freedoms for joint in chain.all_joints])
    return Branched(chain, hf.close(chain, guess), driven * random.normal(size=chain.joint_count))


def swinging(tau: np.ndarray) -> hf.ControlLaw:
    """Return a law with torques that swing about given ones; driven joints are damped."""
    driven = (np.abs(tau) > 0.0).astype(float)

    def torque(t: Any, now: Any, memory: Any, given: Any) -> Any:
        return tau * (1.0 + 0.3 * scalar.sin(40.0 * t)) - 0.5 * driven * now.qd, memory

    return hf.ControlLaw(torque)


def palletiser(base: hf.Pose | None = None) -> Branched:
    """Return an arm whose hand a parallelogram with a passive rod and wrist keeps level; it turns at its base."""
    at = hf.Pose.translation

    def bar(mass: float, name: str) -> hf.Link:
        return hf.Link(mass, [0.0, 0.0, 0.5], mass / 12 * np.diag([1.0, 1.0, 0.1]), name)

    def hinge(p: hf.Pose, name: str, axis=(0, 1, 0), **given) -> hf.Joint:
        return hf.Joint("revolute", axis, p, name, **given)

    joints = [
        hinge(at(0, 0, 0.2), "turn", (0, 0, 1), armature=0.1, damping=0.3),
        hinge(at(0, 0, 0.3), "shoulder", armature=0.2, damping=0.2),
        hinge(at(0, 0, 1.0), "wrist", actuated=False, damping=0.1, stiffness=2.0, rest=0.1),
        hinge(at(0.2, 0, 0.3), "rod", actuated=False),
    ]
    hand = hf.Link(5.0, [0.3, 0, 0], 0.1 * np.eye(3), "hand")
    side = hf.Pose.from_rpy(0, 0, np.pi / 2).R
    pin = hf.Grasp("ball", hf.Pose(side, [0.2, 0, 0]))
    level = hf.Closure("rod", "hand", pin, tip=hf.Pose(side, [0, 0, 1.0]))
    links = [link("pillar", 8.0), bar(20.0, "upper"), hand, bar(4.0, "rod")]
    arm = hf.Arm(joints, links, parents=[None, "pillar", "upper", "pillar"], loops={"level": level})
    chain = hf.ClosedChain({"robot": arm.at(base or hf.Pose.identity())})
    return moving(chain, hf.State([0.4, 0.3, -0.3, 0.3], np.zeros(4)))


def pot_and_lid() -> Branched:
    """Return two arms with grippers, one of which holds a pot by a palm and a pad, the other its lid; both touch."""
    one = two_arms_with_grippers()
    arms, grasps = one.chain.arms, dict(one.chain.grasps)
    palm = hf.dynamics.link_poses(arms["arm2"], one.state.q[8:])[5]
    lid = palm @ hf.Pose.translation(0.0, 0.02, 0.1)
    grasps["arm2", "link6"] = hf.Grasp("rigid", lid.inverse() @ palm, of="lid")
    loop = hf.Closure("lid", "object", hf.Grasp("ball", one.state.object_frame.inverse() @ lid))
    objects = {"lid": hf.HeldObject.cylinder(0.5, 0.12, 0.02)}
    chain = hf.ClosedChain(arms, one.chain.held_object, grasps, objects=objects, loops={"knob": loop})
    return moving(chain, hf.State(one.state.q, one.state.qd, [one.state.object_frame, lid]))


def on_a_shoulder() -> Branched:
    """Return a flying trunk with an arm on a spherical joint that holds a box by its palm, and a gripper of its own."""
    ball = hf.Joint("spherical", placement=hf.Pose.translation(0.1, 0.0, 0.2), name="ball", damping=0.2, armature=0.05)
    gripper = arm_with_gripper(3)
    arm = hf.Arm(
        [ball, *gripper.joints],
        [link("upper", 2.0), *gripper.links],
        parents=[None, *("upper" if k is None else k + 1 for k in gripper.parent_of)],
        frames={name: (f"finger{name[-1]}", pose) for name, (_, pose) in gripper.frames.items()},
        couplings=gripper.couplings,
    )
    trunk = hf.Trunk([hf.Joint(axis=[0.0, 1.0, 0.0], name="waist")], [link("chest", 4.0)], floating=link("hull", 6.0))
    quaternion = hf.Pose.from_rpy(0.3, -0.2, 0.5).wxyz_xyz[:4]
    q = np.concatenate([[0.1], quaternion, [0.2, -0.3, 0.4, 0.03, 0.03]])
    base = hf.Pose.from_rpy(0.1, 0.2, -0.3, xyz=(0.5, 0.0, 1.0))
    box = hf.HeldObject.box(2.0, 0.3, 0.2, 0.1)
    key, mounts = ("arm", "link3"), {"arm": "chest"}
    rough = hf.ClosedChain({"arm": arm}, box, {key: hf.Grasp("rigid")}, trunk=trunk, mounts=mounts)
    palm = rough.forest.poses(np.concatenate([base.wxyz_xyz, q, hf.Pose.identity().wxyz_xyz]))[5]
    place = palm @ hf.Pose.translation(0.0, 0.1, 0.1)
    grasps = {key: hf.Grasp("hinge", place.inverse() @ palm)}
    chain = hf.ClosedChain({"arm": arm}, box, grasps, trunk=trunk, mounts=mounts)
    return moving(chain, hf.State(q, np.zeros(9), place, base_pose=base))


@cache
def branched_problems() -> Mapping[str, Branched]:
    """Return chains with all that makes a chain a forest, in motion, by name."""
    gripper = two_arms_with_grippers()
    made = {
        "grippers": moving(gripper.chain, gripper.state),
        "palletiser": palletiser(),
        "pot and lid": pot_and_lid(),
        "on a shoulder": on_a_shoulder(),
    }
    for problem in made.values():
        problem.tau.flags.writeable = False
    return MappingProxyType(made)
