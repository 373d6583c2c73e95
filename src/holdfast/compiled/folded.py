"""An arm whose numbers are constants of the machine code."""

from __future__ import annotations

from dataclasses import replace

from holdfast.compiler.constant import Constant, constants
from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.spatial.pose import Pose


def with_constants(arm: Arm) -> Arm:
    """Return the arm with everything that is folded into code as constants, whose products no BLAS rounds.

    Names and limits, which no algorithm asks for, are left out: arms that differ in them are of one type.
    """
    joints, links = [_joint(joint) for joint in arm.joints], [_link(link) for link in arm.links]
    return replace(arm, joints=joints, links=links, tip=_pose(arm.tip))


def _joint(joint: Joint) -> Joint:
    plain = Joint(joint.kind, constants(joint.axis), _pose(joint.placement))
    return replace(plain, armature=Constant(joint.armature), damping=Constant(joint.damping))


def _link(link: Link) -> Link:
    plain = Link(link.mass, constants(link.com), constants(link.inertia), physical=False)
    return replace(plain, mass=Constant(link.mass))


def _pose(pose: Pose) -> Pose:
    return Pose(constants(pose.R), constants(pose.p))
