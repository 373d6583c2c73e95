"""Chains with branches: two arms with grippers, one of which holds a box with a finger."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import holdfast as hf

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
