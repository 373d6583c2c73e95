"""The poses of the parts of a chain, serial or with branches: what everything that is drawn asks for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import joint_placement
from holdfast.model.joint import Joint
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


def joint_poses(joints: Sequence[Joint], q: Array) -> list[Pose]:
    """Return the pose of every link of an arm or a trunk in the axes of the link, or base, on which it stands.

    Args:
        joints: the joints.
        q: their positions, with four entries for a spherical joint.
    """
    found, at = [], 0
    for joint in joints:
        if joint.type.quaternion:
            turn = rotation.from_quaternion(q[at : at + 4])
            found.append(Pose.unchecked(joint.placement.R @ turn, joint.placement.p))
        else:
            found.append(Pose.unchecked(*joint_placement(joint, q[at])))
        at += joint.type.position_count
    return found


def link_poses_on(base: Pose, parents: Sequence[int | None], joints: Sequence[Joint], q: Array) -> list[Pose]:
    """Return the pose of every link of an arm or a trunk in the world.

    Args:
        base: pose of its base in the world.
        parents: per joint, the link on which it stands; None for the base.
        joints: its joints.
        q: their positions.
    """
    found: list[Pose] = []
    for parent, own in zip(parents, joint_poses(joints, q), strict=True):
        found.append((base if parent is None else found[parent]) @ own)
    return found


def object_poses(poses: Array) -> Array:
    """Return the poses of a chain's objects, (objects, 7), from those of a state."""
    return np.reshape(poses, (-1, 7))
