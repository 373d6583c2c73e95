"""Robots with a floating base that stand on two soles and hold a box between their palms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

import holdfast as hf

X, Y, Z = np.eye(3)
SOLE = hf.Friction(mu=0.6, half_lengths=(0.1, 0.06))
PALM = hf.Friction(mu=0.8, half_lengths=(0.04, 0.04))
HANDS, FEET = ("left", "right"), ("left_leg", "right_leg")
LEG = ((Z, (0, 0, -0.1)), (X, (0, 0, 0)), (Y, (0, 0, 0)), (Y, (0, 0, -0.4)), (Y, (0, 0, -0.4)), (X, (0, 0, 0)))
CROUCHED = (0.0, 0.0, -0.4, 0.8, -0.4, 0.0)


class Standing(NamedTuple):
    """A robot on two soles with a box between its palms, at rest."""

    chain: hf.ClosedChain
    state: hf.State


def standing(
    arms: Mapping[str, hf.Arm],
    trunk: hf.Trunk,
    mounts: Mapping[str, Any],
    q: Mapping[str, Sequence[float]],
    mass: float = 3.0,
) -> Standing:
    """Return a robot on the soles of its legs, the frames at their tips, with a box between the tips of its arms.

    Args:
        arms: its arms, by the names of `HANDS` and `FEET`.
        trunk: its floating trunk.
        mounts: on which of its bodies they are.
        q: joint positions of the arms, and of the trunk.
        mass: of the box [kg].
    """
    free = hf.ClosedChain(arms, trunk=trunk, mounts=mounts)
    flat = np.concatenate([q["trunk"], *(q[name] for name in arms)])
    poses = free.as_forest.forest.poses(np.concatenate([hf.Pose.identity().wxyz_xyz, flat]))
    last = {name: poses[free.as_forest.arms[name][-1]] for name in arms}
    left, right = (last[name] @ arms[name].tip for name in HANDS)
    across = right.p - left.p
    palms = {
        "left": hf.Pose.looking(left.p, z=across, x=X),
        "right": hf.Pose.looking(right.p, z=-across, x=X),
    }
    turned = {name: arms[name].with_tip(last[name].inverse() @ palm) for name, palm in palms.items()}
    box = hf.Pose(np.eye(3), (left.p + right.p) / 2)
    grasps = {name: hf.Grasp("sole", box.inverse() @ palm, contact=PALM) for name, palm in palms.items()}
    soles = {
        f"{name}_sole": hf.Closure(
            None,
            f"{name}/{arms[name].links[-1].name}",
            hf.Grasp("sole", arms[name].tip, contact=SOLE),
            last[name] @ arms[name].tip,
        )
        for name in FEET
    }
    held = hf.HeldObject.box(mass, 0.2, float(np.linalg.norm(across)), 0.2)
    chain = hf.ClosedChain({**arms, **turned}, held, grasps, trunk=trunk, mounts=mounts, loops=soles)
    return Standing(chain, hf.State(flat, np.zeros(chain.joint_count), box, base_pose=hf.Pose.identity()))


def humanoid_with_box(mass: float = 3.0) -> Standing:
    """Return a pelvis with a waist, two legs of six joints and two Pandas, 27 joints."""

    def link(name: str, kilograms: float, com: Sequence[float]) -> hf.Link:
        return hf.Link(kilograms, com, kilograms * 0.02 * np.diag([1.0, 1.2, 0.8]), name)

    arms, mounts, panda = {}, {}, hf.robots.panda()
    for name, side in zip(HANDS, (1.0, -1.0), strict=True):
        arms[name] = panda.at(hf.Pose.translation(-0.2, 0.2 * side, 0.2))
        mounts[name] = "chest"
    for name, side in zip(FEET, (1.0, -1.0), strict=True):
        joints = [
            hf.Joint(axis=axis, placement=hf.Pose.translation(*p), name=f"joint{k + 1}", effort_limit=300.0)
            for k, (axis, p) in enumerate(LEG)
        ]
        links = [link(f"link{k + 1}", 3.0, (0, 0, -0.2 if k in (2, 3) else 0.0)) for k in range(6)]
        hip = hf.Pose.translation(0, 0.12 * side, 0)
        arms[name] = hf.Arm(joints, links, base=hip, tip=hf.Pose.translation(0.03, 0, -0.1))
        mounts[name] = "base"
    waist = hf.Joint(axis=Z, placement=hf.Pose.translation(0, 0, 0.1), name="waist", effort_limit=200.0)
    trunk = hf.Trunk([waist], [link("chest", 15.0, (0, 0, 0.2))], floating=link("pelvis", 15.0, (0, 0, 0)))
    home = hf.robots.HOME["panda"]
    q = {"trunk": [0.0], "left": home, "right": home, "left_leg": CROUCHED, "right_leg": CROUCHED}
    return standing(arms, trunk, mounts, q, mass)
