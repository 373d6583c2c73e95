"""The Kinova Gen3 with 7 revolute joints and vision module: 0.90 m reach, 4 kg payload."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.joint import UNBOUNDED
from holdfast.robots.link_table import JointRow, LinkTable, signed_axes
from holdfast.robots.primitive import box, capsule, cylinder
from holdfast.spatial.pose import Pose

# the manufacturer's home position
GEN3_HOME = checks.read_only(np.deg2rad([0.0, 15.0, 180.0, -130.0, 0.0, 55.0, 90.0]))
FLANGE = Pose(signed_axes("x -y -z"), np.array([0.0, 0.0, -0.061525]))  # the interface module's face

# fmt: off
ROWS = (
    JointRow("joint_1", "shoulder_link", "x -y -z", (0.0, 0.0, 0.15643), UNBOUNDED, 1.3963, 39.0, 1.3773,
        (-2.3e-05, -0.010364, -0.07336), (0.00457, 0.004831, 0.001409, 1e-06, 2e-06, 0.000448)),
    JointRow("joint_2", "half_arm_1_link", "x z -y", (0.0, 0.005375, -0.12838), (-2.24, 2.24), 1.3963, 39.0, 1.1636,
        (-4.4e-05, -0.09958, -0.013278), (0.011088, 0.001072, 0.011255, 5e-06, 0.0, -0.000691)),
    JointRow("joint_3", "half_arm_2_link", "x -z y", (0.0, -0.21038, -0.006375), UNBOUNDED, 1.3963, 39.0, 1.1636,
        (-4.4e-05, -0.006641, -0.117892), (0.010932, 0.011127, 0.001043, 0.0, -7e-06, 0.000606)),
    JointRow("joint_4", "forearm_link", "x z -y", (0.0, 0.006375, -0.21038), (-2.57, 2.57), 1.3963, 39.0, 0.9302,
        (-1.8e-05, -0.075478, -0.015006), (0.008147, 0.000631, 0.008316, -1e-06, 0.0, -0.0005)),
    JointRow("joint_5", "spherical_wrist_1_link", "x -z y", (0.0, -0.20843, -0.006375), UNBOUNDED, 1.2218, 9.0, 0.6781,
        (1e-06, -0.009432, -0.063883), (0.001596, 0.001607, 0.000399, 0.0, 0.0, 0.000256)),
    JointRow("joint_6", "spherical_wrist_2_link", "x z -y", (0.0, 0.00017505, -0.10593), (-2.09, 2.09), 1.2218, 9.0,
        0.6781, (1e-06, -0.045483, -0.00965), (0.001641, 0.00041, 0.001641, 0.0, 0.0, -0.000278)),
    JointRow("joint_7", "bracelet_link", "x -z y", (0.0, -0.10593, -0.00017505), UNBOUNDED, 1.2218, 9.0, 0.5,
        (0.000281, 0.011402, -0.029798), (0.000587, 0.000369, 0.000609, 3e-06, 3e-06, -0.000118)),
)
# fmt: on

# visuals of the base and of each link
VISUALS = (
    (cylinder((0, 0, 0), (0, 0, 0.156), 0.046, "dark"),),
    (
        cylinder((0, 0, 0), (0, 0, -0.09), 0.045, "white"),
        cylinder((0, 0.04, -0.12838), (0, -0.04, -0.12838), 0.045, "dark"),
    ),
    (capsule((0, 0, -0.006), (0, -0.2, -0.006), 0.04, "white"),),
    (
        capsule((0, 0, -0.02), (0, 0, -0.2), 0.04, "white"),
        cylinder((0, 0.04, -0.21038), (0, -0.04, -0.21038), 0.042, "dark"),
    ),
    (capsule((0, 0, -0.006), (0, -0.2, -0.006), 0.038, "white"),),
    (
        capsule((0, 0, -0.02), (0, 0, -0.09), 0.034, "white"),
        cylinder((0, 0.035, -0.10593), (0, -0.035, -0.10593), 0.035, "dark"),
    ),
    (capsule((0, 0, 0), (0, -0.09, 0), 0.034, "white"),),
    (cylinder((0, 0, 0), (0, 0, -0.0615), 0.035, "dark"), box((0, 0.05, -0.045), (0.06, 0.03, 0.02), "dark")),
)
GEN3 = LinkTable("gen3", ROWS, FLANGE, GEN3_HOME, VISUALS)


def gen3(base: Any = None, tip: Any = None, *, armature: Any = 0.0) -> Arm:
    """Return the Gen3 with 7 joints and vision module; its tip frame is at the face of its interface module.

    Geometry, inertial parameters and limits are those of the manufacturer. Joints 1, 3, 5 and 7 have no position
    limits. The manufacturer's URDF rounds right angles to 1.5708 and 3.1416; here they are exact, as in the
    transformation matrices of the user guide. The drive inertias are not published: `armature` is 0 unless it is given.
    Joint damping and friction are 0.

    Args:
        base: pose of the base frame in the world (a Pose or wxyz_xyz); by default the world frame.
        tip: pose of a massless tool's tip relative to the interface frame (a Pose or wxyz_xyz);
            by default that frame.
        armature: drive inertia reflected to the joints, one number or 7 [kg m^2].

    Raises:
        ModelError: a pose is invalid, or an armature is negative.

    Reference:
        Kinova, ros_kortex, kortex_description/arms/gen3/7dof/urdf/gen3_macro.xacro
        (BSD-3-Clause): frames, inertial parameters, torque and rate limits; the position
        limits of GEN3-7DOF-VISION_ARM_URDF_V12.urdf there, the narrower of the two.
    """
    return GEN3.arm(base, tip, armature)
