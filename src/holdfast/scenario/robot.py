"""The arms of a scene: built-in robots, and those of URDF files beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from holdfast.assembly.preferred import preferred_posture
from holdfast.errors import HoldfastError
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.robots import ROBOTS
from holdfast.robots.urdf import UrdfChain, urdf_chain
from holdfast.robots.urdf.source import Source, read_source
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
        source: the URDF that it is out of; None for a built-in robot.
        links: what became of the file's links; None for a built-in robot.
    """

    arm: Arm
    q: Array
    source: Source | None = None
    links: UrdfChain | None = None


@dataclass(frozen=True)
class RobotFiles:
    """Where a scene's robots come from.

    Attributes:
        folder: that relative names of files start from.
        trust_xacro: whether xacro files may be expanded, which runs the Python in them.
        kept: texts that are taken instead of an arm's file, by the arm's name.
    """

    folder: Path = Path()
    trust_xacro: bool = False
    kept: Mapping[str, Source] = field(default_factory=dict)

    def source(self, data: UrdfData, arm: str) -> Source:
        """Return the URDF of an arm.

        Raises:
            SceneError: the file cannot be read, or is xacro that may not or cannot be expanded.
            MissingExtra: a xacro file without xacrodoc.
        """
        return self.kept.get(arm) or read_source(self.folder / data.file, data.xacro_args, self.trust_xacro)


def robot(data: ArmData, files: RobotFiles, at: Location) -> Robot:
    """Return an arm where it stands, and the joint positions to start from.

    Args:
        data: the arm's.
        files: where its URDF is, if it has one.
        at: its place in the scene.

    Raises:
        SceneError: no robot of that name, a URDF that cannot be that arm, or positions of the wrong number.
        MissingExtra: a xacro file without xacrodoc.
    """
    if (data.robot is None) == (data.urdf is None):
        raise at.refuse(f"expected robot or urdf, got {'neither' if data.robot is None else 'both'}")
    base = pose(data.base, at / "base")
    tool = None if data.tip is None else pose(data.tip, at / "tip")
    if data.urdf is None:
        found = _built_in(data.robot, base, tool, at)
    else:
        found = _of_file(data.urdf, files, data.name, base, tool, at)
    if data.q is None:
        return found
    q, joints = np.array(data.q, dtype=float), found.arm.joint_count
    if q.shape != (joints,):
        raise (at / "q").refuse(f"expected {joints} joint positions for a {found.arm.name}, got {len(q)}")
    return replace(found, q=q)


def _built_in(name: str | None, base: Pose, tool: Pose | None, at: Location) -> Robot:
    if name is None or name not in ROBOTS:
        raise (at / "robot").refuse(f"no robot '{name}'.{checks.did_you_mean(str(name), ROBOTS)}")
    with at.refusals():
        arm = ROBOTS[name](base=base, tip=tool)
    return Robot(arm, preferred_posture(arm))


def _of_file(data: UrdfData, files: RobotFiles, name: str, base: Pose, tool: Pose | None, at: Location) -> Robot:
    try:
        source = files.source(data, name)
        links = urdf_chain(
            source,
            base=data.base,
            tip=data.tip,
            locked=data.locked,
            lock_others=data.lock_others,
            mount=base,
        )
    except HoldfastError as cause:  # it names file and line
        raise type(cause)((at / "urdf").message(str(cause))) from cause
    arm = links.arm
    if tool is not None:  # what there is to say of the link's own frame says nothing of the tool's
        arm = arm.with_tip(arm.tip @ tool)
        links = replace(links, notes=tuple(note for note in links.notes if note != links.tip_note), tip_note="")
    if data.armature:
        arm = replace(arm, joints=_driven(arm, data.armature, at / "urdf" / "armature"))
    return Robot(arm, preferred_posture(arm), source, links)


def _driven(arm: Arm, armature: dict[str, float], at: Location) -> list[Joint]:
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
