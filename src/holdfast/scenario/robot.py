"""The arms of a scene: built-in robots, and those of URDF files beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from holdfast.assembly.preferred import preferred_posture
from holdfast.errors import HoldfastError
from holdfast.io.place import Place
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.robots import ROBOTS
from holdfast.robots.urdf import UrdfChain, urdf_chain
from holdfast.scenario.parts import pose
from holdfast.scenario.scene import ArmData, UrdfData
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class Robot:
    """An arm of a scene.

    Attributes:
        arm: the arm, where it stands, with its tool.
        q: (N,) joint positions to start from [rad or m].
        file: the URDF that it is out of; None for a built-in robot.
        links: what became of the file's links; None for a built-in robot.
    """

    arm: Arm
    q: Array
    file: Path | None = None
    links: UrdfChain | None = None


def robot(data: ArmData, folder: Path, at: Place) -> Robot:
    """Return an arm where it stands, and the joint positions to start from.

    Args:
        data: the arm's.
        folder: that relative names of files start from.
        at: its place in the scene.

    Raises:
        SceneError: no robot of that name, a URDF that cannot be that arm, or positions of the wrong number.
        MissingExtra: a xacro file without xacrodoc.
    """
    if (data.robot is None) == (data.urdf is None):
        raise at.refuse(f"expected robot or urdf, got {'neither' if data.robot is None else 'both'}")
    base = pose(data.base, at / "base")
    tool = None if data.tip is None else pose(data.tip, at / "tip")
    found = _built_in(data.robot, base, tool, at) if data.urdf is None else _of_file(data.urdf, folder, base, tool, at)
    if data.q is None:
        return found
    q, joints = np.array(data.q, dtype=float), found.arm.joint_count
    if q.shape != (joints,):
        raise (at / "q").refuse(f"expected {joints} joint positions for a {found.arm.name}, got {len(q)}")
    return replace(found, q=q)


def _built_in(name: str | None, base: Pose, tool: Pose | None, at: Place) -> Robot:
    if name not in ROBOTS:
        raise (at / "robot").refuse(f"no robot '{name}'.{checks.did_you_mean(str(name), ROBOTS)}")
    with at.refusals():
        arm = ROBOTS[name](base=base, tip=tool)
    return Robot(arm, preferred_posture(arm))


def _of_file(data: UrdfData, folder: Path, base: Pose, tool: Pose | None, at: Place) -> Robot:
    file = folder / data.file
    try:
        links = urdf_chain(
            file,
            base=data.base,
            tip=data.tip,
            locked=data.locked,
            lock_others=data.lock_others,
            mount=base,
            xacro_args=data.xacro_args,
        )
    except HoldfastError as cause:  # it names file and line
        raise type(cause)((at / "urdf").said(str(cause))) from cause
    arm = links.arm
    if tool is not None:  # what there is to say of the link's own frame says nothing of the tool's
        arm = arm.with_tip(arm.tip @ tool)
        links = replace(links, notes=tuple(note for note in links.notes if note != links.tip_note), tip_note="")
    if data.armature:
        arm = replace(arm, joints=_driven(arm, data.armature, at / "urdf" / "armature"))
    return Robot(arm, preferred_posture(arm), file, links)


def _driven(arm: Arm, armature: dict[str, float], at: Place) -> list[Joint]:
    """Return the joints with their drives' inertia."""
    names = [joint.name for joint in arm.joints]
    for name in armature:
        if name not in names:
            raise at.refuse(f"no moving joint '{name}'.{checks.did_you_mean(name, names)}")
    joints = []
    for joint in arm.joints:
        with (at / joint.name).refusals():
            joints.append(replace(joint, armature=armature.get(joint.name, joint.armature)))
    return joints
