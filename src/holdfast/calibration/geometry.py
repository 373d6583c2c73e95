"""Gaps of all closures in all postures, and their exact derivatives by geometry.

Every unknown, joint and free body moves what stands on it by a spatial twist [omega; v_0] about the world's origin. A
closure whose frame a is carried by it opens at the rate

    d/dt (R_b^T R_a) = (R_b^T omega)~ R_b^T R_a,    d/dt R_b^T (p_a - p_b) = R_b^T (v_0 + omega x p_a)

and a closure whose frame b is carried by it at the opposite one. All of this is done for all postures at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.calibration.layout import FrameLayout, Meeting
from holdfast.model.joint import Joint
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import skew

SMALL_ANGLE = 1e-6


class Poses(NamedTuple):
    """Poses in all postures: (postures, 3, 3) and (postures, 3)."""

    R: Array
    p: Array

    def then(self, R: Array, p: Array) -> Poses:
        """Return these poses followed by others, or by one."""
        return Poses(self.R @ R, self.p + (self.R @ p[..., None])[..., 0])

    def inverse(self) -> Poses:
        """Return the inverse poses."""
        back = np.swapaxes(self.R, -1, -2)
        return Poses(back, -(back @ self.p[..., None])[..., 0])

    def part(self, chosen: Array) -> Poses:
        """Return some of them."""
        return Poses(self.R[chosen], self.p[chosen])


@dataclass(frozen=True, eq=False)
class OpenGaps:
    """Gaps, and their derivatives.

    Attributes:
        gaps: (postures, rows): closed angles, then closed lengths, of every meeting.
        unknowns: (postures, rows, p) derivatives by the unknowns.
        joints: (postures, rows, n_v) by the freedoms of all joints.
        free: (postures, rows, 6 f) by the twists of the free bodies.
    """

    gaps: Array
    unknowns: Array
    joints: Array
    free: Array


def left_jacobian(w: Array) -> Array:
    """Return J (3, 3) with exp(w + dw) = exp(J dw) exp(w)."""
    angle = float(np.sqrt(w @ w))
    W = skew(w)
    if angle < SMALL_ANGLE:
        return np.eye(3) + 0.5 * W + W @ W / 6.0
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * W + (angle - np.sin(angle)) / angle**3 * W @ W


def adjusted(layout: FrameLayout, x: Array) -> list[tuple[Pose, Array]]:
    """Return every frame with corrections x, and its twists per unknown, (6, d) [turn; shift] along its axes."""
    found = []
    for frame in layout.frames:
        if not frame.unknowns:
            found.append((frame.pose, frame.directions))
            continue
        step = frame.directions @ x[list(frame.unknowns)]
        w, t, angular, linear = step[:3], step[3:], frame.directions[:3], frame.directions[3:]
        turn = rotation.exp(w)
        if frame.own_axes:
            pose = Pose.unchecked(frame.pose.R @ turn, frame.pose.p + frame.pose.R @ t)
        else:
            pose = Pose.unchecked(turn @ frame.pose.R, frame.pose.p + t)
        found.append((pose, np.concatenate([left_jacobian(w) @ angular, linear])))
    return found


def gaps(layout: FrameLayout, x: Array, q: Array, free: dict[int, Poses]) -> OpenGaps:
    """Return the gaps of all meetings with corrections x, and their derivatives. O(postures rows (p + n)).

    Args:
        layout: the layout.
        x: (p,) corrections of the unknowns.
        q: (postures, n_q) joint positions.
        free: the poses of the free bodies, by body.
    """
    count, frames = len(q), adjusted(layout, x)
    world = Poses(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
    at: list[Poses] = []
    moved: list[tuple[str, int, Array]] = []  # kind, index, twists (postures, 6, columns)
    carried: list[set[tuple[str, int]]] = []  # by body, what moves it

    def through(start: Poses, chain: tuple[int, ...]) -> Poses:
        """Return the pose after some frames, and note their twists."""
        for k in chain:
            frame, (pose, twists) = layout.frames[k], frames[k]
            after = start.then(pose.R, pose.p)
            if frame.unknowns and not any(kind == "frame" and index == k for kind, index, _ in moved):
                axes = start.R @ frame.pose.R if frame.own_axes else start.R
                moved.append(("frame", k, about_world(axes @ twists[:3], axes @ twists[3:], after.p)))
            start = after
        return start

    for k, body in enumerate(layout.bodies):
        if body.joint is None:
            pose, mine = free[k], {("free", k)}
            moved.append(("free", k, about_world(np.tile(np.eye(3, 6), (count, 1, 1)), np.eye(3, 6, 3), pose.p)))
        else:
            start = through(world if body.parent is None else at[body.parent], body.frames)
            pose = start.then(*displacement(body.joint, q[:, body.position :]))
            mine = {("frame", f) for f in body.frames} | {("joint", k)}
            moved.append(("joint", k, about_world(*joint_twists(body.joint, start, pose), pose.p)))
        at.append(pose)
        carried.append(mine | (set() if body.parent is None else carried[body.parent]))

    rows, slopes = [], []
    for meeting in layout.meetings:
        (a, chain_a), (b, chain_b) = meeting.a, meeting.b
        end_a = through(world if a is None else at[a], chain_a)
        end_b = through(world if b is None else at[b], chain_b)
        if meeting.target is not None:
            end_b = end_b.then(*meeting.target)
        by_a = {("frame", f) for f in chain_a} | (set() if a is None else carried[a])
        by_b = {("frame", f) for f in chain_b} | (set() if b is None else carried[b])
        gap, slope = _gap(meeting, end_a, end_b)
        rows.append(gap)
        slopes.append((slope, by_a, by_b))

    kinds = {"frame": len(layout.unknowns), "joint": 0, "free": 0}
    where: dict[tuple[str, int], slice] = {}
    for kind, k, twists in moved:
        if kind == "frame":
            first = layout.frames[k].unknowns[0]
            where[kind, k] = slice(first, first + twists.shape[2])
        else:
            where[kind, k] = slice(kinds[kind], kinds[kind] + twists.shape[2])
            kinds[kind] += twists.shape[2]
    total = sum(gap.shape[1] for gap in rows)
    found = {kind: np.zeros((count, total, width)) for kind, width in kinds.items()}
    for kind, k, twists in moved:
        start = 0
        for slope, by_a, by_b in slopes:
            sign = ((kind, k) in by_a) - ((kind, k) in by_b)
            stop = start + slope.shape[1]
            if sign:
                found[kind][:, start:stop, where[kind, k]] = sign * (slope @ twists)
            start = stop
    return OpenGaps(np.concatenate(rows, axis=1), found["frame"], found["joint"], found["free"])


def about_world(angular: Array, linear: Array, origin: Array) -> Array:
    """Return spatial twists (postures, 6, columns) about the world's origin from those about points (postures, 3)."""
    x, y, z = origin[:, 0, None], origin[:, 1, None], origin[:, 2, None]
    a, b, c = angular[:, 0], angular[:, 1], angular[:, 2]
    shifted = linear - np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)  # v - omega x origin
    return np.concatenate([np.broadcast_to(angular, shifted.shape), shifted], axis=1)


def joint_twists(joint: Joint, start: Poses, pose: Poses) -> tuple[Array, Array]:
    """Return the angular and linear twists of a joint per rate, (postures, 3, freedoms) each."""
    if joint.type.quaternion:
        return start.R, np.zeros_like(start.R)
    h, s = joint.motion_subspace
    zero = np.zeros((len(pose.p), 3, 1))
    return (zero if h is None else pose.R @ h[:, None], zero if s is None else pose.R @ s[:, None])


def displacement(joint: Joint, q: Array) -> tuple[Array, Array]:
    """Return the attitudes (postures, 3, 3) and positions (postures, 3) of a joint's link in its placement."""
    if joint.type.quaternion:
        R = np.moveaxis(rotation.from_quaternion(q[:, :4].T), 2, 0)
        return R, np.zeros((len(q), 3))
    angle = q[:, :1, None]
    along = np.outer(joint.axis, joint.axis)
    if joint.turns:
        R = along + np.cos(angle) * (np.eye(3) - along) + np.sin(angle) * skew(joint.axis)
    else:
        R = np.tile(np.eye(3), (len(q), 1, 1))
    return R, joint.travel * q[:, :1] * joint.axis


def _gap(meeting: Meeting, a: Poses, b: Poses) -> tuple[Array, Array]:
    """Return the closed rows of a meeting (postures, rows), and their derivatives by a spatial twist of a."""
    back = np.swapaxes(b.R, 1, 2)
    R, p = back @ a.R, (back @ (a.p - b.p)[:, :, None])[:, :, 0]
    shifts = list(meeting.shifts)
    rows = np.concatenate([R.reshape(-1, 9) @ meeting.turns.T, p[:, shifts]], axis=1)
    by_turn = np.stack([(skew(e) @ R).reshape(-1, 9) @ meeting.turns.T for e in np.eye(3)], axis=2)
    angular = by_turn @ back  # (postures, t, 3), by omega in world axes
    reach = np.zeros((len(R), 3, 3))  # v_0 + omega x p_a = v_0 - p_a~ omega
    for (i, j), k, sign in (((0, 1), 2, 1.0), ((0, 2), 1, -1.0), ((1, 2), 0, 1.0)):
        reach[:, i, j], reach[:, j, i] = sign * a.p[:, k], -sign * a.p[:, k]
    lower = np.concatenate([back @ reach, back], axis=2)[:, shifts]
    upper = np.concatenate([angular, np.zeros_like(angular)], axis=2)
    return rows, np.concatenate([upper, lower], axis=1)
