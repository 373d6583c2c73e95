"""How far an arm reaches at most, and how far it is asked to."""

from __future__ import annotations

import math

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.pose import Pose


def longest_reach(arm: Arm) -> float:
    """Return a distance from the first joint that the tip cannot exceed in any posture [m].

    The lengths from joint to joint and on to the tip, and the strokes; infinite with a
    stroke that has no limit.
    """
    lengths = [float(np.linalg.norm(joint.placement.p)) for joint in arm.joints[1:]]
    strokes = [max(map(abs, joint.position_limits)) for joint in arm.joints if joint.kind == "prismatic"]
    return math.fsum([*lengths, *strokes, float(np.linalg.norm(arm.tip.p))])


def asked_reach(chain: ClosedChain, name: str, object_pose: Pose) -> float:
    """Return the distance from an arm's first joint to its contact point [m]."""
    arm = chain.arms[name]
    contact = object_pose @ chain.grasps[name].frame
    return float(np.linalg.norm(contact.p - (arm.base @ arm.joints[0].placement).p))
