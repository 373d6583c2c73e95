"""The longest reach of an arm, and the distance of its joints from their limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State

LIMIT_ROOM = 0.02  # desired distance from a limit, relative to the joint's range


def longest_reach(arm: Arm) -> float:
    """Return an upper bound of the distance from the first joint to the tip in any configuration [m].

    It is the sum of the lengths from joint to joint and to the tip, and of the strokes; infinite if a stroke has no
    limit.
    """
    sliding = [joint for joint in arm.joints if joint.travel]
    strokes = [abs(joint.travel) * max(map(abs, joint.position_limits)) for joint in sliding]
    return math.fsum([arm.length, *strokes])


def required_reach(chain: ClosedChain, name: str, object_pose: Pose) -> float:
    """Return the distance from an arm's first joint to its contact point [m]."""
    contact = object_pose @ chain.grasps[name].frame
    return float(np.linalg.norm(contact.p - shoulder(chain.arms[name])))


def shoulder(arm: Arm) -> Array:
    """Return the position of the first joint, (3,) world axes [m], or that of the base of an anchor."""
    return (arm.base @ arm.joints[0].placement).p if arm.joints else arm.base.p


def with_room(chain: ClosedChain, preferred: Mapping[str, Array]) -> ClosedChain:
    """Return the chain with limits narrowed by 2 % of each joint's range, if the preferred configuration allows it."""
    arms = {}
    for name, arm in chain.arms.items():
        low, high = arm.position_limits.T
        wish, room = np.clip(preferred[name], low, high), LIMIT_ROOM * _spans(arm)
        limits = zip(np.minimum(low + room, wish), np.maximum(high - room, wish), strict=True)
        joints = [replace(joint, position_limits=pair) for joint, pair in zip(arm.joints, limits, strict=True)]
        arms[name] = arm.of(joints)
    return ClosedChain(arms, chain.held_object, chain.grasps, chain.gravity)


def room_left(chain: ClosedChain, state: State) -> float:
    """Return the smallest distance from a joint limit, relative to the joint's range and at most `LIMIT_ROOM`."""
    low, high = chain.position_limits.T
    spans = np.concatenate([_spans(arm) for arm in chain.arms.values()])
    margin = np.minimum(state.q - low, high - state.q) / np.maximum(spans, 1e-300)
    return float(np.clip(margin.min(initial=LIMIT_ROOM), 0.0, LIMIT_ROOM))


def _spans(arm: Arm) -> Array:
    """Return the joints' ranges, (N,); 2 pi rad or m for a joint without two limits."""
    low, high = arm.position_limits.T
    return np.where(np.isfinite(high - low), high - low, 2 * np.pi)
