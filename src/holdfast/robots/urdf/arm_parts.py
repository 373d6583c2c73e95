"""The joints and links of an arm in a robot's file, and the options by which they are read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, TypedDict

from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.robots.urdf.bodies import FoldedChain, WeldedBody, welded_link
from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.robot import MOVABLE, UrdfRobot
from holdfast.spatial.pose import Pose

LoopClosures = Sequence[Any] | Mapping[str, Any]
JOINT_FIELDS = (
    "position_limits",
    "rate_limit",
    "effort_limit",
    "armature",
    "damping",
    "friction",
    "stiffness",
    "rest",
    "pitch",
)


class UrdfOptions(TypedDict, total=False):
    """The keywords that `load_urdf`, `load_urdf_arms`, `load_urdf_trunk`, `urdf_chain` and `urdf_chains` share."""

    locked: Mapping[str, float] | None
    lock_others: bool
    branches: bool
    mount: Any
    physical: bool
    xacro_args: Mapping[str, str] | None
    trust_xacro: bool
    packages: Mapping[str, str | PathLike[str]] | None
    loop_closures: LoopClosures | None


def joints_and_links(
    robot: UrdfRobot, folded: FoldedChain, options: UrdfOptions
) -> tuple[list[Joint], list[Link], list[str]]:
    """Return the joints of a chain and the links that they move, base to tip, with notes on changed inertias."""
    physical, notes = options.get("physical", True), list[str]()
    links = [
        welded_link(robot, body.links, f"joint {quoted(body.step.joint.name)} moves it", physical, notes)
        for body in folded.bodies
    ]
    return [_joint(body) for body in folded.bodies], links, notes


def _joint(body: WeldedBody) -> Joint:
    """Return the joint that moves a body."""
    joint, down = body.step
    if joint.fault is not None:
        raise joint.fault
    with joint.element.refusals():
        return Joint(
            kind=MOVABLE[joint.kind],  # pyright: ignore[reportArgumentType]
            axis=joint.axis if down else 0.0 - joint.axis,
            placement=plain(body.placement),
            name=joint.name,
            **{quantity: getattr(joint, quantity) for quantity in JOINT_FIELDS},
        )


def plain(pose: Pose) -> Pose:
    """Return the pose without -0.0, so that the compiler can drop zeros."""
    return Pose(pose.R + 0.0, pose.p + 0.0)
