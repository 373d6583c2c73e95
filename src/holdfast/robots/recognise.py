"""Recognition of built-in robots by their joints, which determines visuals and the home configuration of an arm."""

from __future__ import annotations

import numpy as np

from holdfast.model.arm import Arm
from holdfast.robots.gen3 import GEN3
from holdfast.robots.iiwa14 import IIWA14
from holdfast.robots.link_table import LinkTable, signed_axes
from holdfast.robots.panda import PANDA
from holdfast.robots.ur5e import UR5E
from holdfast.spatial.scalar import Array

SAME = 1e-4  # tolerance of lengths [m] and of rotations, because files round right angles to 1.5708
BUILT_IN = (PANDA, IIWA14, UR5E, GEN3)


def builtin_of(arm: Arm) -> LinkTable | None:
    """Return the built-in robot with the same joints (kinds, axes, placements), or None.

    Names, masses, tools and the base pose do not matter, so arms from files are recognised, too.
    """
    return next((robot for robot in BUILT_IN if _same_joints(arm, robot)), None)


def home_of(arm: Arm) -> Array | None:
    """Return the home configuration (N,) of the built-in robot with the arm's joints [rad], or None."""
    robot = builtin_of(arm)
    return None if robot is None else robot.home


def _same_joints(arm: Arm, robot: LinkTable) -> bool:
    return arm.joint_count == len(robot.rows) and all(
        joint.motion_subspace[1] is None
        and np.allclose(joint.axis, [0.0, 0.0, 1.0], rtol=0, atol=SAME)
        and np.allclose(joint.placement.R, signed_axes(row.axes), rtol=0, atol=SAME)
        and np.allclose(joint.placement.p, row.origin, rtol=0, atol=SAME)
        for joint, row in zip(arm.joints, robot.rows, strict=True)
    )
