"""The base and the tip of an arm in a tree of links, the joints between them, and the locked joints."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.errors import SceneError
from holdfast.model import checks
from holdfast.robots.urdf.attributes import LARGEST_VALUE
from holdfast.robots.urdf.document import hint, quoted
from holdfast.robots.urdf.robot import MOVABLE, PLANAR, SDF_BALL, UrdfJoint, UrdfRobot
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose

DEEPEST_MIMIC = 100


class PassedJoint(NamedTuple):
    """A joint passed on the path from one link to another.

    Attributes:
        joint: the joint.
        down: True from parent to child, False from child to parent.
    """

    joint: UrdfJoint
    down: bool

    @property
    def beyond(self) -> str:
        """Name of the link after the joint."""
        return self.joint.child if self.down else self.joint.parent


def path_between(robot: UrdfRobot, start: str, end: str) -> list[PassedJoint]:
    """Return the joints from one link to another, up to their common ancestor and then down. O(links)."""
    up, down = _to_root(robot, start), _to_root(robot, end)
    while up and down and up[-1] is down[-1]:
        up.pop()
        down.pop()
    return [PassedJoint(joint, False) for joint in up] + [PassedJoint(joint, True) for joint in reversed(down)]


def _to_root(robot: UrdfRobot, link: str) -> list[UrdfJoint]:
    """Return the joints from a link up to the root."""
    joints = []
    while (joint := robot.joint_above.get(link)) is not None:
        joints.append(joint)
        link = joint.parent
    return joints


def known_link(robot: UrdfRobot, link: str, what: str) -> str:
    """Return the name of a link after checking that the robot has it.

    Raises:
        SceneError: there is no link with this name.
    """
    if not isinstance(link, str) or link not in robot.links:
        if not isinstance(link, str):
            place = "; a pose in the world is mount=" if what == "base" else ""
            raise robot.element.refuse(f"{what}: expected the name of a link, got a {type(link).__name__}{place}")
        raise robot.element.refuse(f"{what}: no link {quoted(link)}.{hint(link, robot.links)}")
    return link


def ends(robot: UrdfRobot, base: str | None, tip: str | None, locked: Container[str]) -> tuple[str, str]:
    """Return base and tip, which are by default the root and the only end link after a moving joint.

    Raises:
        SceneError: a link is unknown, or there is no such end link or more than one; the message lists them.
    """
    start = robot.root if base is None else known_link(robot, base, "base")
    if tip is not None:
        return start, known_link(robot, tip, "tip")
    counts = _moving_joints(robot, start, locked)
    tips = [link for link, count in counts.items() if count and not robot.joints_below[link]]
    if not tips:
        raise robot.element.refuse(
            f"tip: no moving joint below base {quoted(start)}; try another base, or name the tip"
        )
    if len(tips) > 1:
        raise _choice(robot, start, sorted(tips, key=lambda link: -counts[link]), counts)
    return start, tips[0]


def _moving_joints(robot: UrdfRobot, start: str, locked: Container[str]) -> dict[str, int]:
    """Return the number of moving joints between a link and each link below it, itself included."""
    counts, waiting = {start: 0}, [start]
    while waiting:
        link = waiting.pop()
        for joint in robot.joints_below[link]:
            counts[joint.child] = counts[link] + (not joint.is_fixed and joint.name not in locked)
            waiting.append(joint.child)
    return counts


def _choice(robot: UrdfRobot, start: str, tips: list[str], counts: dict[str, int]) -> SceneError:
    """Return the error that lists the possible tips, longest arms first, and the link at which they branch."""
    shown = [f"{quoted(link)} ({counts[link]})" for link in tips[:12]]
    if len(tips) > 12:
        shown.append(f"{len(tips) - 12} more")
    fork = _fork(robot, start, tips)
    parting = f"; they part at {quoted(fork)} ({counts[fork]})" if counts[fork] else ""
    best = fork if 0 < counts[fork] < counts[tips[0]] else tips[0]
    return robot.element.refuse(
        f"tip: expected a link's name, since there are several ends (with so many joints): {', '.join(shown)}"
        f"{parting}; try tip={quoted(best)}"
    )


def _fork(robot: UrdfRobot, start: str, tips: list[str]) -> str:
    """Return the last link that is on the paths from the start to all tips."""
    on_path = {start}
    for link in tips:
        while link not in on_path:
            on_path.add(link)
            link = robot.joint_above[link].parent
    fork = start
    while len(onward := [j.child for j in robot.joints_below[fork] if j.child in on_path]) == 1:
        fork = onward[0]
    return fork


@dataclass(frozen=True, eq=False)
class Locks:
    """The joints that are locked.

    Attributes:
        robot: the robot.
        given: positions given by the caller, by joint name.
        others: also lock every joint on an arm, or below its base, that is not on the path of an arm.
        on_path: names of the joints between base and tip of the arms.
    """

    robot: UrdfRobot
    given: Mapping[str, float]
    others: bool
    on_path: frozenset[str]

    def position(self, joint: UrdfJoint) -> float | None:
        """Return the position at which a joint is locked [rad or m]; None if it moves.

        A joint that mimics a locked or fixed one is locked at the corresponding position.
        """
        try:
            return self._position(joint)
        except SceneError:
            if not self.passes_over(joint):
                raise
            return resting_position(joint)  # it follows no joint of the file

    def passes_over(self, joint: UrdfJoint) -> bool:
        """Return whether `others` locks a joint that is on no path, whatever is wrong with it."""
        return self.others and joint.name not in self.on_path and joint.kind not in ("floating", PLANAR)

    def _position(self, joint: UrdfJoint) -> float | None:
        followed, multiplier, offset = joint, 1.0, 0.0
        for _ in range(DEEPEST_MIMIC):
            mimic = followed.mimic
            if mimic is None or followed.name in self.given:
                held = self._own_position(followed)
                return None if held is None else _bounded(joint, multiplier * held + offset)
            offset += multiplier * mimic.offset
            multiplier *= mimic.multiplier
            if mimic.joint not in self.robot.joints:
                raise followed.element.refuse(
                    f"mimic: no joint {quoted(mimic.joint)}.{hint(mimic.joint, self.robot.joints)}"
                    f" Or try locked={{{quoted(followed.name)}: 0.0}}"
                )
            followed = self.robot.joints[mimic.joint]
            if followed.is_fixed:
                return _bounded(joint, offset)
        raise joint.element.refuse(f"mimic: follows {DEEPEST_MIMIC} joints or itself; expected one that follows none")

    def _own_position(self, joint: UrdfJoint) -> float | None:
        """Return the position at which a joint itself is locked, without mimicry; None if it is not."""
        if joint.name in self.given:
            return self.given[joint.name]
        if self.others and joint.kind in MOVABLE and joint.name not in self.on_path:
            return resting_position(joint)
        return None

    def pose(self, joint: UrdfJoint) -> Pose | None:
        """Return the pose of the child frame in the parent frame; None if the joint moves."""
        if joint.is_fixed:
            return joint.origin
        if joint.kind not in MOVABLE and self.passes_over(joint):
            return joint.origin
        q = self.position(joint)
        if q is None:
            return None
        if joint.fault is not None and q != 0.0:
            raise joint.fault
        if not joint.turns:
            return joint.origin @ Pose(np.eye(3), q * joint.axis)
        return joint.origin @ Pose(rotation.exp(q * joint.axis), q * (joint.pitch or 0.0) * joint.axis)


def resting_position(joint: UrdfJoint) -> float:
    """Return the default position of a locked joint: 0, or its limit nearest to 0 [rad or m]."""
    low, high = joint.position_limits
    return min(max(0.0, low), high)


def checked_locks(robot: UrdfRobot, locked: Mapping[str, float] | None) -> dict[str, float]:
    """Return the checked positions of joints to lock.

    Raises:
        SceneError: a joint is unknown or cannot move, or a position is not a number within its limits.
    """
    if not isinstance(locked or {}, Mapping):
        raise robot.element.refuse(f"locked: expected positions by joint name, got a {type(locked).__name__}")
    held = {}
    for name, position in (locked or {}).items():
        joint = robot.joints.get(name)
        if joint is None:
            raise robot.element.refuse(f"locked: no joint {quoted(str(name))}.{hint(str(name), robot.joints)}")
        if joint.kind not in MOVABLE:
            raise joint.element.refuse(f"locked: expected a joint with one degree of freedom, got a {joint.kind} one")
        if joint.fault is not None:
            raise joint.fault
        with joint.element.refusals():
            q = checks.number(position, "locked")
        if joint.kind == SDF_BALL and q != 0.0:
            raise joint.element.refuse(f"locked: expected 0 for a ball joint, got {q:g}")
        low, high = joint.position_limits
        if not low <= q <= high:
            raise joint.element.refuse(f"locked: expected a position from {low:g} to {high:g} [rad or m], got {q:g}")
        held[name] = q
    return held


def _bounded(joint: UrdfJoint, position: float) -> float:
    """Return a position after checking its size."""
    if not abs(position) <= LARGEST_VALUE:
        raise joint.element.refuse(f"locked: expected sizes up to {LARGEST_VALUE:g} [rad or m], got {position:g}")
    return position
