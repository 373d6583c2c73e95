"""Search for configurations in which an arm reaches its contact, from many starts at once.

The search uses damped Newton steps of least norm within the joint limits (Levenberg-Marquardt, with one damping for
each start), vectorised over the starts. It only finds starting points, which `dynamics.closing.close` then refines.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.grasp import Grasp
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import skew

MOST_DAMPED_STEPS = 80
REACHED = 1e-6  # rad, or fraction of the arm's length
LONGEST_DAMPED_STEP = 0.5  # rad, or fraction of the arm's length, in one iteration
SAME_CONFIGURATION = 1e-3  # rad or m: configurations that differ by less are the same
NEAR_HALF_TURN = -0.99  # cosine of an angle near half a turn
LEAST_DAMPING, MOST_DAMPING = 1e-8, 1e4


def reaching_configurations(
    arm: Arm, grasp: Grasp, object_pose: Pose, starts: Iterable[Array], preferred: Array
) -> Array:
    """Return configurations found from the starts that close the grasp, in order of distance from the preferred one.

    Whole turns are subtracted from revolute joints to bring them as close to the preferred configuration as their
    limits allow.

    Args:
        arm: the arm.
        grasp: its grasp.
        object_pose: pose of the object.
        starts: starting configurations, (N,) each.
        preferred: (N,) preferred joint positions.

    Returns:
        (found, N) configurations; for an anchor its only configuration, without a check.
    """
    if not arm.joints:
        return np.zeros((1, 0))
    contact, K = object_pose @ grasp.frame, grasp.of_kind.directions[list(grasp.of_kind.position_rows)]
    size = arm.length or 1.0  # m
    scale = np.array([1.0 if joint.turns else size for joint in arm.joints])
    low, high = arm.position_limits.T
    q = np.clip(np.array(list(starts)), low, high)
    damping = np.full(len(q), 1e-2)
    gap, J = _gap(arm, q, contact, size)
    gap, J = gap @ K.T, K @ J * scale
    for _ in range(MOST_DAMPED_STEPS):
        active = (np.abs(gap).max(axis=1) > REACHED) & (damping < MOST_DAMPING)
        if not active.any():
            break
        at, here, slope = q[active], gap[active], J[active]
        step = _step(slope, here, damping[active], at <= low, at >= high) * scale
        trial = np.clip(at + step, low, high)
        there, trial_slope = _gap(arm, trial, contact, size)
        there, trial_slope = there @ K.T, K @ trial_slope * scale
        better = np.linalg.norm(there, axis=1) < np.linalg.norm(here, axis=1)
        kept = np.flatnonzero(active)[better]
        q[kept], gap[kept], J[kept] = trial[better], there[better], trial_slope[better]
        damping[active] = np.maximum(damping[active] * np.where(better, 0.2, 10.0), LEAST_DAMPING)
    found = _unwound(arm, q[np.abs(gap).max(axis=1) <= REACHED], preferred)
    order = np.argsort(np.linalg.norm((found - preferred) / scale, axis=1), kind="stable")
    return _distinct(found[order])


def _gap(arm: Arm, q: Array, contact: Pose, size: float) -> tuple[Array, Array]:
    """Return the displacements of the tips from the contact frame, [turn; shift / size] (B, 6), and their Jacobians."""
    R, p, axes, places = np.broadcast_to(arm.base.R, (len(q), 3, 3)), np.tile(arm.base.p, (len(q), 1)), [], []
    for k, joint in enumerate(arm.joints):
        p, R = p + R @ joint.placement.p, R @ joint.placement.R
        axes.append(R @ joint.axis)
        places.append(p)
        if joint.travel:
            p = p + q[:, k, None] * (joint.travel * axes[-1])
        if joint.turns:
            R = R @ _turns(joint.axis, q[:, k])
    p, R = p + R @ arm.tip.p, contact.R.T @ R @ arm.tip.R
    J = np.zeros((len(q), 6, arm.joint_count))
    for k, joint in enumerate(arm.joints):
        turning = axes[k] if joint.turns else 0.0 * axes[k]
        J[:, :3, k] = turning @ contact.R
        J[:, 3:, k] = (np.cross(turning, p - places[k]) + joint.travel * axes[k]) @ contact.R / size
    return np.hstack([_logs(R), (p - contact.p) @ contact.R / size]), J


def _turns(axis: Array, angles: Array) -> Array:
    """Return rotations about a unit axis, (B, 3, 3): 1 + sin K + (1 - cos) K^2."""
    K = skew(axis)
    return np.eye(3) + np.sin(angles)[:, None, None] * K + (1 - np.cos(angles))[:, None, None] * (K @ K)


def _logs(R: Array) -> Array:
    """Return the rotation vectors of matrices, (B, 3)."""
    sines = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine, cosine = np.linalg.norm(sines, axis=1), 0.5 * (np.trace(R, axis1=1, axis2=2) - 1)
    turns = sines * (np.arctan2(sine, cosine) / np.maximum(sine, 1e-12))[:, None]
    for k in np.flatnonzero(cosine < NEAR_HALF_TURN):  # where the sines lose the axis
        turns[k] = rotation.log(R[k])
    return turns


def _step(J: Array, gap: Array, damping: Array, lowest: Array, highest: Array) -> Array:
    """Return -J^T (J J^T + damping 1)^-1 gap, (B, N), without joints that it would push beyond their limits."""
    J = J.copy()
    while True:
        A = J @ J.transpose(0, 2, 1) + damping[:, None, None] * np.eye(J.shape[1])
        step = -(J.transpose(0, 2, 1) @ np.linalg.solve(A, gap[:, :, None]))[:, :, 0]
        beyond = ((lowest & (step < 0)) | (highest & (step > 0))) & J.any(axis=1)
        if not beyond.any():
            return step * np.minimum(1.0, LONGEST_DAMPED_STEP / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        J[np.broadcast_to(beyond[:, None, :], J.shape)] = 0.0


def _unwound(arm: Arm, q: Array, preferred: Array) -> Array:
    """Return the same configurations with whole turns subtracted towards the preferred one, if the limits allow it."""
    turns = 2 * np.pi * np.round((q - preferred) / (2 * np.pi))
    turns[:, [bool(joint.travel) for joint in arm.joints]] = 0.0
    low, high = arm.position_limits.T
    there = q - turns
    return np.where((low <= there) & (there <= high), there, q)


def _distinct(q: Array) -> Array:
    """Return the configurations without those that are nearly equal to an earlier one."""
    kept: list[Array] = []
    for one in q:
        if all(np.abs(one - other).max() > SAME_CONFIGURATION for other in kept):
            kept.append(one)
    return np.array(kept).reshape(len(kept), q.shape[1])
