"""Which joints of a robot are held, and where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from holdfast.model import checks
from holdfast.robots.urdf.attributes import LARGEST
from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.robot import MOVING, UrdfJoint, UrdfRobot
from holdfast.robots.urdf.tree import hint
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose

DEEPEST_MIMIC = 100


@dataclass(frozen=True, eq=False)
class Locks:
    """The joints that are held.

    Attributes:
        robot: the robot.
        given: position by joint name, as the caller said.
        others: hold also every joint that hangs on an arm, or moves its base, but is on no arm's way.
        on_the_way: names of the joints between base and tip of the arms.
    """

    robot: UrdfRobot
    given: Mapping[str, float]
    others: bool
    on_the_way: frozenset[str]

    def position(self, joint: UrdfJoint) -> float | None:
        """Return where a joint is held [rad or m], None if it moves.

        A joint that mimics a held one is held where that one puts it.
        """
        followed, multiplier, offset = joint, 1.0, 0.0
        for _ in range(DEEPEST_MIMIC):
            if followed.mimic is None or followed.name in self.given:
                held = self._own_position(followed)
                return None if held is None else _bounded(joint, multiplier * held + offset)
            offset += multiplier * followed.mimic.offset
            multiplier *= followed.mimic.multiplier
            followed = self._followed(followed, followed.mimic.joint)
        raise joint.element.refuse(f"mimic: follows {DEEPEST_MIMIC} joints or itself; expected one that follows none")

    def _followed(self, joint: UrdfJoint, name: str) -> UrdfJoint:
        """Return the joint of that name, which another one mimics."""
        if name not in self.robot.joints:
            raise joint.element.refuse(
                f"mimic: no joint {quoted(name)}.{hint(name, self.robot.joints)}"
                f" Or try locked={{{quoted(joint.name)}: 0.0}}"
            )
        return self.robot.joints[name]

    def _own_position(self, joint: UrdfJoint) -> float | None:
        """Return where a joint is held by itself, None if it is not."""
        if joint.name in self.given:
            return self.given[joint.name]
        if self.others and joint.kind in MOVING and joint.name not in self.on_the_way:
            return resting_position(joint)
        return None

    def pose(self, joint: UrdfJoint) -> Pose | None:
        """Return the pose of the child frame in the parent frame, None if the joint moves."""
        if joint.is_fixed:
            return joint.origin
        q = self.position(joint)
        if q is None:
            return None
        if joint.kind == "prismatic":
            return joint.origin @ Pose(np.eye(3), q * joint.axis)
        return joint.origin @ Pose(rotation.exp(q * joint.axis), np.zeros(3))


def resting_position(joint: UrdfJoint) -> float:
    """Return where a joint rests if nobody says: at 0, or at its limit nearest to 0 [rad or m]."""
    low, high = joint.position_limits
    return min(max(0.0, low), high)


def checked_locks(robot: UrdfRobot, locked: Mapping[str, float] | None) -> dict[str, float]:
    """Return the positions to hold joints at, each of a joint that can move, within its limits.

    Raises:
        SceneError: an unknown or immovable joint, a position that is none or beyond a limit.
    """
    if not isinstance(locked or {}, Mapping):
        raise robot.element.refuse(f"locked: expected positions by joint name, got a {type(locked).__name__}")
    held = {}
    for name, position in (locked or {}).items():
        joint = robot.joints.get(name)
        if joint is None:
            raise robot.element.refuse(f"locked: no joint {quoted(str(name))}.{hint(str(name), robot.joints)}")
        if joint.kind not in MOVING:
            raise joint.element.refuse(f"locked: expected a joint of one freedom, got a {joint.kind} one")
        with joint.element.refusals():
            q = checks.number(position, "locked")
        low, high = joint.position_limits
        if not low <= q <= high:
            raise joint.element.refuse(f"locked: expected a position from {low:g} to {high:g} [rad or m], got {q:g}")
        held[name] = q
    return held


def _bounded(joint: UrdfJoint, position: float) -> float:
    """Return a position that is small enough to compute with."""
    if not abs(position) <= LARGEST:
        raise joint.element.refuse(f"locked: expected sizes up to {LARGEST:g} [rad or m], got {position:g}")
    return position
