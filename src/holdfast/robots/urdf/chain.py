"""An arm out of a robot's links and joints, with what became of the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from typing import Any, TypedDict, Unpack

import numpy as np

from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.model.tip_direction import tip_advice, tip_angle
from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.folding import Body, Fold, fold
from holdfast.robots.urdf.inertia import welded_link
from holdfast.robots.urdf.locking import Locks, checked_locks
from holdfast.robots.urdf.reading import read_urdf
from holdfast.robots.urdf.refusals import hanging, refuse_loose, refuse_unsupported
from holdfast.robots.urdf.robot import UrdfRobot
from holdfast.robots.urdf.source import Source
from holdfast.robots.urdf.tips import ends
from holdfast.robots.urdf.tree import Step, way
from holdfast.spatial.pose import Pose

SAME_PLACE = 1e-6  # [m] between the origins of two frames
UPRIGHT = 0.1  # [rad] between z and the way to the tip


class UrdfOptions(TypedDict, total=False):
    """The keywords that `load_urdf`, `load_urdf_arms`, `urdf_chain` and `urdf_chains` share."""

    locked: Mapping[str, float] | None
    lock_others: bool
    mount: Any
    physical: bool
    xacro_args: Mapping[str, str] | None
    trust_xacro: bool


@dataclass(frozen=True, eq=False)
class UrdfChain:
    """An arm, and what became of the rest of the robot.

    Attributes:
        arm: the arm; its joints and links bear the file's names.
        robot: the file's links and joints.
        base: name of the link that stands still.
        tip: name of the link whose frame is the tip.
        locked: where joints within the arm and its base are held [rad or m], by name.
        bodies: N + 1 mappings from link name to pose: of the links on the base in the base's
            frame, then of the links welded into arm link k in its frame.
        elsewhere: names of the links that joints of their own move on the base.
        notes: what was read in another way than it stands, or not at all, with its line; and a tip
            whose z axis does not point out of the hand.
        tip_note: that last note alone; empty if there is none.
    """

    arm: Arm
    robot: UrdfRobot
    base: str
    tip: str
    locked: Mapping[str, float]
    bodies: tuple[Mapping[str, Pose], ...]
    elsewhere: tuple[str, ...]
    notes: tuple[str, ...]
    tip_note: str = ""


def urdf_chain(
    path_or_text: str | PathLike[str] | Source,
    *,
    base: str | None = None,
    tip: str | None = None,
    **options: Unpack[UrdfOptions],
) -> UrdfChain:
    """Return what `load_urdf` loads, with what became of every link, and notes. O(links).

    Args:
        path_or_text: as for `load_urdf`.
        base: as for `load_urdf`.
        tip: as for `load_urdf`.
        **options: as for `load_urdf`.

    Raises:
        SceneError, ModelError, MissingExtra: as for `load_urdf`.
    """
    robot = read_urdf(path_or_text, xacro_args=options.get("xacro_args"), trust_xacro=options.get("trust_xacro", False))
    held = checked_locks(robot, options.get("locked"))
    start, end = ends(robot, base, tip, held)
    steps = way(robot, start, end)
    locks = Locks(robot, held, bool(options.get("lock_others")), frozenset(step.joint.name for step in steps))
    refuse_unsupported(locks, steps)
    folded = fold(start, steps, locks)
    refuse_loose(locks, hanging(locks, folded, steps))
    return chain_of(locks, start, folded, steps, mounted(options), options)


def mounted(options: UrdfOptions) -> Pose:
    """Return the `mount` of the options as a pose; the world's own frame by default."""
    mount = options.get("mount")
    return Pose.identity() if mount is None else checks.pose(mount, "mount")


def chain_of(locks: Locks, base: str, folded: Fold, steps: list[Step], mount: Pose, options: UrdfOptions) -> UrdfChain:
    """Return the arm along the steps from a base link that is mounted at a pose; nothing moves on it unheld."""
    robot, tip = locks.robot, steps[-1].beyond if steps else base
    if not folded.bodies:
        raise robot.element.refuse(
            f"expected a joint that moves between base {quoted(base)} and tip {quoted(tip)}, got none"
        )
    links = [welded_link(robot, body, options.get("physical", True)) for body in folded.bodies]
    arm = Arm([_joint(body) for body in folded.bodies], links, _plain(folded.tip), mount, robot.name)
    bodies = (folded.on_base, *(body.links for body in folded.bodies))
    inside = {name: robot.links[name] for links in bodies for name in links}
    within = [joint for joint in robot.joints.values() if joint.parent in inside and joint.child in inside]
    notes = [note for part in (robot, *inside.values(), *within) for note in part.notes]
    notes += [_massless(robot, name) for body in folded.bodies for name in body.links if not robot.links[name].inertial]
    tip_note = _tip_note(robot, arm, tip, folded)
    return UrdfChain(
        arm=arm,
        robot=robot,
        base=base,
        tip=tip,
        locked={j.name: q for j in within if not j.is_fixed and (q := locks.position(j)) is not None},
        bodies=bodies,
        elsewhere=tuple(name for name in robot.links if name not in inside),
        notes=(*notes, *([tip_note] if tip_note else [])),
        tip_note=tip_note,
    )


def _massless(robot: UrdfRobot, link: str) -> str:
    """Return the note on a link that moves and weighs nothing; of one that stands still no mass is needed."""
    return robot.links[link].element.said("no <inertial>, taken as massless")


def _tip_note(robot: UrdfRobot, arm: Arm, tip: str, folded: Fold) -> str:
    """Return the note on a tip whose z axis does not point out of the hand, with links there whose does; or nothing."""
    if not (advice := tip_advice(arm)):
        return ""
    better = [
        f"tip={quoted(name)}"
        for name, at in folded.bodies[-1].links.items()
        if np.allclose(at.p, arm.tip.p, rtol=0, atol=SAME_PLACE) and tip_angle(arm.with_tip(at)) < UPRIGHT
    ]
    others = f", or {' or '.join(better[:3])}, a frame in the same place" if better else ""
    return robot.links[tip].element.said(f"as a tip: {advice}{others}")


def _joint(body: Body) -> Joint:
    """Return the joint that moves a body."""
    joint, down = body.step
    with joint.element.refusals():
        return Joint(
            kind="prismatic" if joint.kind == "prismatic" else "revolute",
            axis=joint.axis if down else 0.0 - joint.axis,
            placement=_plain(body.placement),
            name=joint.name,
            position_limits=joint.position_limits,
            rate_limit=joint.rate_limit,
            effort_limit=joint.effort_limit,
            damping=joint.damping,
            friction=joint.friction,
        )


def _plain(pose: Pose) -> Pose:
    """Return the pose without -0.0, so that compiled code folds it."""
    return Pose(pose.R + 0.0, pose.p + 0.0)
