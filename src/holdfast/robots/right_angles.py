"""Right angles that were written with too few digits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.model.arm import Arm
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


def with_right_angles(arm: Arm, tolerance: float = 1e-10) -> Arm:
    """Return the arm with right angles between its links made exact. O(N).

    Many URDF files say `1.57079632679`, 5e-12 rad from pi/2. Compiled dynamics fold exact
    zeros and ones away, and not 5e-12: for Baxter's arm that is a tenth of the time. Motion
    and forces change by about the tolerance, relatively.

    Args:
        arm: the arm.
        tolerance: how far from a right angle [rad].
    """
    return replace(
        arm,
        joints=[replace(joint, placement=_rounded(joint.placement, tolerance)) for joint in arm.joints],
        tip=_rounded(arm.tip, tolerance),
    )


def _rounded(pose: Pose, tolerance: float) -> Pose:
    """Return the pose with small rotation entries 0, and what then stands alone in its row +-1."""
    R: Array = np.where(np.abs(pose.R) <= tolerance, 0.0, pose.R)
    alone = np.count_nonzero(R, axis=1) == 1
    return Pose(np.where(alone[:, None], np.sign(R), R), pose.p)
