"""A check whether the z axis of an arm's tip, the direction in which its hand presses, points out of the hand."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.grasp import Grasp
from holdfast.spatial.scalar import Array

SHORT = 1e-3  # tips nearer to the last joint than this fraction of the arm's length count as on it
LEAST_COSINE = 0.7  # least cosine between the tip's z axis and the last joint's axis for which z counts as along it
ALONG = 0.1  # least cosine with the last joint's axis for which a direction determines its outward sense


class _Turn(NamedTuple):
    """A rotation of the tip by quarter turns that moves its z axis to another of its axes.

    Attributes:
        axis: that axis.
        wxyz: quaternion of the rotation, as code.
        rpy: roll, pitch and yaw of the rotation [rad], as code.
    """

    axis: str
    wxyz: str
    rpy: tuple[str, str, str]


_QUARTER = repr(math.pi / 2)
_NONE = _Turn("+z", "1, 0, 0, 0", ("0", "0", "0"))
_TURNS = (
    _Turn("+x", "0.5**0.5, 0, 0.5**0.5, 0", ("0", _QUARTER, "0")),
    _Turn("+y", "0.5**0.5, -0.5**0.5, 0, 0", ("-" + _QUARTER, "0", "0")),
    _NONE,
    _Turn("-x", "0.5**0.5, 0, -0.5**0.5, 0", ("0", "-" + _QUARTER, "0")),
    _Turn("-y", "0.5**0.5, 0.5**0.5, 0, 0", (_QUARTER, "0", "0")),
    _Turn("-z", "0, 1, 0, 0", (repr(math.pi), "0", "0")),
)


def way_to_tip(arm: Arm) -> Array | None:
    """Return the direction out of the hand according to the arm's geometry, a unit vector in tip axes, (3,), or None.

    This is the direction from the last joint to the tip. It is the outward axis of the last joint instead if the tip
    lies on that joint, as for a UR, or if both the direction and the tip's z axis are along the joint's axis, as for an
    angled tool on a wrist that rolls. The result is None if the tip lies on the last joint and the joint before does
    not determine the outward sense of the axis, because such a frame is not a hand, and for an anchor.
    """
    if not arm.joints:
        return None
    joint, offset = arm.joints[-1], arm.tip.p
    short = SHORT * arm.length
    if on_joint := float(np.linalg.norm(offset)) <= short:  # `along` does not depend on the configuration
        offset = joint.placement.R.T @ joint.placement.p  # from the joint before
    distance = float(np.linalg.norm(offset))
    along = float(joint.axis @ offset) / distance if distance > short else 0.0
    if on_joint and abs(along) <= ALONG:
        return None
    rolls = abs(along) > ALONG and abs(float(joint.axis @ arm.tip.R[:, 2])) >= LEAST_COSINE
    way = math.copysign(1.0, along) * joint.axis if on_joint or rolls else offset / distance
    return arm.tip.R.T @ way


def tip_angle(arm: Arm) -> float:
    """Return the angle between the direction out of the hand and the tip's z axis, 0 to pi [rad]; NaN without one."""
    way = way_to_tip(arm)
    return math.nan if way is None else math.atan2(math.hypot(way[0], way[1]), way[2])


def tip_advice(arm: Arm) -> str:
    """Return advice for a tip whose z axis points sideways or backwards, with the rotation as code; otherwise ''."""
    turn = _turn(arm)
    if turn.axis == "+z":
        return ""
    return (
        f"the tip's z axis is {math.degrees(tip_angle(arm)):.0f} deg off the direction from the last joint to the tip,"
        f" which is along its {turn.axis}. If z is to point out of the hand, try arm.with_tip(arm.tip @"
        f" hf.Pose.from_wxyz_xyz([{turn.wxyz}, 0, 0, 0])), in a scene tip = {{ rpy = [{', '.join(turn.rpy)}] }}"
    )


def advice_for(arm: Arm, grasp: Grasp) -> str:
    """Return `tip_advice` if the tip's attitude matters for the grasp; it does not for a ball without friction."""
    return "" if not grasp.of_kind.oriented and grasp.contact is None else tip_advice(arm)


def _turn(arm: Arm) -> _Turn:
    """Return the rotation to the tip's axis that is nearest to the direction out of the hand."""
    way = way_to_tip(arm)
    return _NONE if way is None else _TURNS[int(np.argmax(np.concatenate([way, -way])))]
