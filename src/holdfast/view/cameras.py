"""Cameras for the view of a chain."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.link import Link
from holdfast.model.trunk import Trunk
from holdfast.robots.visuals import arm_length, chain_length, equivalent_box
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import cross
from holdfast.view.markers import box_lines
from holdfast.view.playback import Playback, spring_ends
from holdfast.view.scene_writer import FIELD_OF_VIEW, Camera

SEEN_OF = 5  # number of frames that must fit into the picture
PICTURE_MARGIN = 1.1  # size of the picture relative to its content
LINK_THICKNESS = 0.05  # thickness of links around the lines through their joints, relative to the longest


def upward(chain: ClosedChain) -> Array:
    """Return the unit vector opposite to gravity, (3,); world z without gravity."""
    g = float(np.linalg.norm(chain.gravity))
    return -chain.gravity / g if g > 0 else np.array([0.0, 0.0, 1.0])


def cameras(playback: Playback) -> list[Camera]:
    """Return views that show the whole chain, and one near the object; the first is the default."""
    up = upward(playback.chain)
    along = _spread(playback.base_pose[0, :, 4:], up)
    front = cross(along, up)  # from the chain towards the camera
    chosen = np.unique(np.linspace(0, len(playback) - 1, SEEN_OF).astype(int))
    near = np.concatenate([object_outline(playback, k) for k in chosen])
    springs = [np.reshape(spring_ends(playback, k), (-1, 3)) for k in chosen]
    points = np.concatenate([near, *(arms_outline(playback, k) for k in chosen), *springs])
    trunk, lengths = playback.chain.trunk, [chain_length(playback.chain)]
    if trunk is not None:
        points = np.concatenate([points, *(trunk_outline(trunk, playback, k) for k in chosen)])
        lengths += [] if trunk.serial is None else [arm_length(trunk.serial)]
    around = LINK_THICKNESS * max(lengths)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    held = playback.object_pose[chosen, 4:].mean(axis=0)
    directions = {
        "overview": front + 0.45 * along + 0.4 * up,
        "front": front,
        "side": along + 0.1 * up,
        "top": up + 0.02 * front,
    }
    views = [_fitted(name, direction, up, points, middle, around) for name, direction in directions.items()]
    return [*views, _fitted("object", front + 0.3 * along + 0.5 * up, up, near, held, 0.0)]


def _fitted(name: str, direction: Array, up: Array, points: Array, target: Array, around: float) -> Camera:
    """Return the nearest view that shows all points in a square picture.

    Args:
        name: name of the view.
        direction: (3,) direction from the target to the camera.
        up: (3,) upward direction.
        points: (points, 3) points to show [m].
        target: (3,) point at which the camera is aimed [m].
        around: margin around the points [m].
    """
    back = direction / np.linalg.norm(direction)
    right = cross(up, back)
    right = right / np.linalg.norm(right)
    seen = points - target
    beside = np.maximum(np.abs(seen @ right), np.abs(seen @ cross(back, right))) + around
    distance = float((PICTURE_MARGIN * beside / np.tan(FIELD_OF_VIEW / 2) + seen @ back).max())
    return Camera(name, target + distance * back, target)


def arms_outline(playback: Playback, k: int) -> Array:
    """Return bases, link origins and tips in a frame, (points, 3) world axes [m]."""
    points = []
    for i, (name, arm) in enumerate(playback.chain.arms.items()):
        base = Pose.from_wxyz_xyz(playback.base_pose[k, i])
        points += _serial_outline(arm, base, playback.q[k, playback.chain.joints[name]])
    return np.array(points)


def trunk_outline(trunk: Trunk, playback: Playback, k: int) -> Array:
    """Return base and link origins, and the corners of a floating body, in a frame, (points, 3) world axes [m]."""
    base = Pose.from_wxyz_xyz(playback.trunk_pose[k])
    points = [base.p]
    if trunk.floating is not None:
        points += list(_corners(trunk.floating) @ base.R.T + base.p)
    if trunk.serial is not None:
        points += _serial_outline(trunk.serial, base, playback.q[k, playback.chain.joints[TRUNK]])
    return np.array(points)


def _serial_outline(arm: Arm, base: Pose, q: Array) -> list[Array]:
    at = forward_kinematics(arm.at(base), q)
    return [base.p, at.tip.p, *(at.tip.p - reach for reach in at.reach)]


def _corners(body: HeldObject | Link) -> Array:
    """Return the corners of a body's equivalent box, (24, 3) in the body's axes [m]."""
    edges, box = equivalent_box(body)
    return box_lines(edges).reshape(-1, 3) @ box.R.T + box.p


def object_outline(playback: Playback, k: int) -> Array:
    """Return the corners of the object's box, and the contacts, in a frame, (points, 3) world axes [m]."""
    corners = _corners(playback.chain.held_object)
    contacts = [grasp.frame.p for grasp in playback.chain.grasps.values()]
    frame = Pose.from_wxyz_xyz(playback.object_pose[k])
    return np.concatenate([corners, np.reshape(contacts, (-1, 3))]) @ frame.R.T + frame.p


def _spread(bases: Array, up: Array) -> Array:
    """Return the horizontal direction in which bases (arms, 3) lie side by side, a unit vector (3,)."""
    level = bases - bases.mean(axis=0)
    level = level - np.outer(level @ up, up)
    sizes, directions = np.linalg.eigh(level.T @ level)
    along = directions[:, -1]
    if sizes[-1] < 1e-6:  # there is one base, or all are in one place
        along = cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    along = along - (along @ up) * up
    along = along / np.linalg.norm(along)
    return along if along.sum() >= 0 else -along
