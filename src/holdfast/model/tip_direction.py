"""Whether the z axis of an arm's tip, along which its hand presses, points out of the hand."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.grasp import Grasp
from holdfast.spatial.scalar import Array

SHORT = 1e-3  # of the arm's length: a tip nearer to the last joint lies on it
LIKE = 0.7  # cosine with the last axis from which the tip's z axis goes along it
ALONG = 0.1  # cosine with the last axis from which a direction tells which way along it is outward


class _Turn(NamedTuple):
    """A turn of the tip by quarters that brings its z axis to where another axis was.

    Attributes:
        axis: that axis.
        wxyz: its quaternion, as code.
        rpy: roll, pitch and yaw [rad], as code.
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
    """Return the direction out of the hand as the arm's geometry has it: a unit vector in tip axes, (3,), or None.

    The way from the last joint to the tip. Where the tip lies on that joint, as a UR's does, or where both
    this way and the tip's z axis go along the joint's axis, as with an angled tool on a wrist that rolls,
    it is the axis itself, outward. None where the tip lies on the last joint and the joint before tells no
    outward sense of the axis: such a frame is no hand. Nor is an anchor.
    """
    if not arm.joints:
        return None
    joint, offset = arm.joints[-1], arm.tip.p
    lengths = [float(np.linalg.norm(part.p)) for part in (*(j.placement for j in arm.joints[1:]), arm.tip)]
    short = SHORT * math.fsum(lengths)
    if on_joint := lengths[-1] <= short:
        offset = (
            joint.placement.R.T @ joint.placement.p
        )  # from the joint before; `along` is the same in any configuration
    distance = float(np.linalg.norm(offset))
    along = float(joint.axis @ offset) / distance if distance > short else 0.0
    if on_joint and abs(along) <= ALONG:
        return None
    rolls = abs(along) > ALONG and abs(float(joint.axis @ arm.tip.R[:, 2])) >= LIKE
    way = math.copysign(1.0, along) * joint.axis if on_joint or rolls else offset / distance
    return arm.tip.R.T @ way


def tip_angle(arm: Arm) -> float:
    """Return the angle from the way to the tip to the tip's z axis, 0 to pi [rad]; nan where there is no such way."""
    way = way_to_tip(arm)
    return math.nan if way is None else math.atan2(math.hypot(way[0], way[1]), way[2])


def tip_advice(arm: Arm) -> str:
    """Return what to say of a tip whose z axis points sideways or backwards, with the turn as code; or nothing."""
    turn = _turn(arm)
    if turn.axis == "+z":
        return ""
    return (
        f"the tip's z axis is {math.degrees(tip_angle(arm)):.0f} deg off the direction from the last joint to the tip,"
        f" which is along its {turn.axis}. If z is to point out of the hand, try arm.with_tip(arm.tip @"
        f" hf.Pose.from_wxyz_xyz([{turn.wxyz}, 0, 0, 0])), in a scene tip = {{ rpy = [{', '.join(turn.rpy)}] }}"
    )


def advice_for(arm: Arm, grasp: Grasp) -> str:
    """Return the same where the grasp feels how the tip is turned; a ball without friction does not."""
    return "" if not grasp.of_kind.oriented and grasp.contact is None else tip_advice(arm)


def _turn(arm: Arm) -> _Turn:
    """Return the turn to the tip's axis that is nearest to the way."""
    way = way_to_tip(arm)
    return _NONE if way is None else _TURNS[int(np.argmax(np.concatenate([way, -way])))]
