"""The built-in arms and their home positions by name, and their recognition by their joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from holdfast.model.arm import Arm
from holdfast.robots.gen3 import GEN3, gen3
from holdfast.robots.iiwa14 import IIWA14, iiwa14
from holdfast.robots.link_table import LinkTable, signed_axes
from holdfast.robots.panda import PANDA, panda
from holdfast.robots.ur5e import UR5E, ur5e
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array

SAME_JOINT = 1e-4  # tolerance of lengths [m] and of rotations, because files round right angles to 1.5708
BUILT_IN = (PANDA, IIWA14, UR5E, GEN3)
ROBOTS: Mapping[str, Callable[..., Arm]] = FrozenDict({"panda": panda, "iiwa14": iiwa14, "ur5e": ur5e, "gen3": gen3})
HOME: Mapping[str, Array] = FrozenDict({robot.name: robot.home for robot in BUILT_IN})


def builtin_of(arm: Arm) -> LinkTable | None:
    """Return the built-in robot with the same joints (kinds, axes, placements), or None.

    Names, masses, tools and the base pose do not matter, so arms from files are recognised, too. So are arms with
    branches on the last of these links, such as fingers.
    """
    return next((robot for robot in BUILT_IN if _same_joints(arm, robot)), None)


def home_of(arm: Arm) -> Array | None:
    """Return the home configuration (N,) of the built-in robot with the arm's joints [rad], or None."""
    robot = builtin_of(arm)
    return None if robot is None or arm.parents else robot.home


def _same_joints(arm: Arm, robot: LinkTable) -> bool:
    count = len(robot.rows)
    if arm.joint_count < count or any(on is None or on < count - 1 for on in arm.parent_of[count:]):
        return False
    if arm.joint_count > count and not arm.parents:
        return False
    return arm.parent_of[:count] == (None, *range(count - 1)) and all(
        joint.motion_subspace[1] is None
        and np.allclose(joint.axis, [0.0, 0.0, 1.0], rtol=0, atol=SAME_JOINT)
        and np.allclose(joint.placement.R, signed_axes(row.axes), rtol=0, atol=SAME_JOINT)
        and np.allclose(joint.placement.p, row.origin, rtol=0, atol=SAME_JOINT)
        for joint, row in zip(arm.joints, robot.rows, strict=False)
    )
