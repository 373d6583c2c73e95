"""Cameras for the view of a chain."""

from __future__ import annotations

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.link import Link
from holdfast.model.trunk import TRUNK, Trunk
from holdfast.robots.visuals import arm_length, chain_length, ends_of, equivalent_box
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import cross
from holdfast.view.markers import box_lines, contacts_on
from holdfast.view.playback import Playback, spring_ends
from holdfast.view.poses import link_poses_on, object_poses
from holdfast.view.scene_writer import FIELD_OF_VIEW, Camera

SEEN_OF = 5  # number of frames that must fit into the picture
PICTURE_MARGIN = 1.1  # size of the picture relative to its content
LINK_THICKNESS = 0.05  # thickness of links around the lines through their joints, relative to the longest


def upward(chain: ClosedChain) -> Array:
    """Return the unit vector opposite to gravity, (3,); world z without gravity."""
    g = float(np.linalg.norm(chain.gravity))
    return -chain.gravity / g if g > 0 else np.array([0.0, 0.0, 1.0])


def cameras(playback: Playback) -> list[Camera]:
    """Return views that show the whole chain, and one near the objects, if any; the first is the default."""
    up = upward(playback.chain)
    along = _spread(playback.base_pose[0, :, 4:], up)
    front = cross(along, up)  # from the chain towards the camera
    chosen = np.unique(np.linspace(0, len(playback) - 1, SEEN_OF).astype(int))
    near = np.concatenate([objects_outline(playback, k) for k in chosen])
    springs = [np.reshape(spring_ends(playback, k), (-1, 3)) for k in chosen]
    points = np.concatenate([near, *(arms_outline(playback, k) for k in chosen), *springs])
    trunk, lengths = playback.chain.trunk, [chain_length(playback.chain)]
    if trunk is not None:
        points = np.concatenate([points, *(trunk_outline(trunk, playback, k) for k in chosen)])
        lengths += [] if trunk.serial is None else [arm_length(trunk.serial)]
    around = LINK_THICKNESS * max(lengths)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    directions = {
        "overview": front + 0.45 * along + 0.4 * up,
        "front": front,
        "side": along + 0.1 * up,
        "top": up + 0.02 * front,
    }
    views = [_fitted(name, direction, up, points, middle, around) for name, direction in directions.items()]
    if not playback.chain.free_objects:
        return views
    held = np.mean([object_poses(playback.object_pose[k])[:, 4:].mean(axis=0) for k in chosen], axis=0)
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
        links = link_poses_on(base, arm.parent_of, arm.joints, playback.q[k, playback.chain.positions[name]])
        points += [base.p, *(link.p for link in links)]
        for frame, ends in zip([base, *links], ends_of(arm), strict=True) if arm.parents else ():
            points += [frame.R @ end + frame.p for end in ends]
    return np.concatenate([np.array(points).reshape(-1, 3), playback.tip[k]])


def trunk_outline(trunk: Trunk, playback: Playback, k: int) -> Array:
    """Return base and link origins, and the corners of a floating body, in a frame, (points, 3) world axes [m]."""
    base = Pose.from_wxyz_xyz(playback.trunk_pose[k])
    points = [base.p]
    if trunk.floating is not None:
        points += list(_corners(trunk.floating) @ base.R.T + base.p)
    if trunk.serial is not None:
        serial, q = trunk.serial, playback.q[k, playback.chain.positions[TRUNK]]
        links = link_poses_on(base, serial.parent_of, serial.joints, q)
        points += [link.p for link in links]
    return np.array(points)


def _corners(body: HeldObject | Link) -> Array:
    """Return the corners of a body's equivalent box, (24, 3) in the body's axes [m]."""
    edges, box = equivalent_box(body)
    return box_lines(edges).reshape(-1, 3) @ box.R.T + box.p


def objects_outline(playback: Playback, k: int) -> Array:
    """Return the corners of the objects' boxes, and the contacts, in a frame, (points, 3) world axes [m].

    Without objects, these are the tips and the contacts of loops.
    """
    points = []
    poses = object_poses(playback.object_pose[k])
    for (name, held), pose in zip(playback.chain.free_objects.items(), poses, strict=True):
        contacts = contacts_on(playback.chain, name)
        frame = Pose.from_wxyz_xyz(pose)
        points.append(np.concatenate([_corners(held), np.reshape(contacts, (-1, 3))]) @ frame.R.T + frame.p)
    return np.concatenate(points or [playback.tip[k]])


def _spread(bases: Array, up: Array) -> Array:
    """Return the horizontal direction in which bases (arms, 3) lie side by side, a unit vector (3,)."""
    level = bases - bases.sum(axis=0) / max(len(bases), 1)
    level = level - np.outer(level @ up, up)
    sizes, directions = np.linalg.eigh(level.T @ level)
    along = directions[:, -1]
    if sizes[-1] < 1e-6:  # there is one base, or all are in one place
        along = cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    along = along - (along @ up) * up
    along = along / np.linalg.norm(along)
    return along if along.sum() >= 0 else -along
