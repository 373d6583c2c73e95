"""The Universal Robots UR5e: 6 revolute joints, 0.85 m reach, 5 kg payload."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.robots.link_table import JointRow, LinkTable
from holdfast.robots.primitive import capsule, cylinder
from holdfast.spatial.pose import Pose

RIGHT = np.pi / 2
UR5E_HOME = checks.read_only(np.array([0.0, -RIGHT, RIGHT, -RIGHT, -RIGHT, 0.0]))  # flange down
ONE_TURN, HALF = (-2 * np.pi, 2 * np.pi), (-np.pi, np.pi)
JOINT_RATE = np.pi

# fmt: off
ROWS = (
    JointRow("shoulder_pan_joint", "shoulder_link", "-x -y z", (0.0, 0.0, 0.1625), ONE_TURN, JOINT_RATE, 150.0, 3.761,
        (0.0, -0.00193, -0.02561), (0.00700210, 0.00657286, 0.00648091, 0.00001053, 0.00000073, -0.00049994)),
    JointRow("shoulder_lift_joint", "upper_arm_link", "x z -y", (0.0, 0.0, 0.0), ONE_TURN, JOINT_RATE, 150.0, 8.058,
        (-0.2125, 0.0, 0.11336), (0.01505885, 0.33388086, 0.33247207, -0.00005400, 0.00000563, -0.00000181)),
    JointRow("elbow_joint", "forearm_link", "x y z", (-0.425, 0.0, 0.0), HALF, JOINT_RATE, 150.0, 2.846,
        (-0.2422, 0.0, 0.0265), (0.00399632, 0.07879254, 0.07848510, -0.00001365, 0.00137272, -0.00000660)),
    JointRow("wrist_1_joint", "wrist_1_link", "x y z", (-0.3922, 0.0, 0.1333), ONE_TURN, JOINT_RATE, 28.0, 1.37,
        (0.0, -0.01634, -0.0018), (0.00165491, 0.00126279, 0.00135962, 0.00000438, -0.00000282, -0.00010157)),
    JointRow("wrist_2_joint", "wrist_2_link", "x z -y", (0.0, -0.0997, 0.0), ONE_TURN, JOINT_RATE, 28.0, 1.3,
        (0.0, 0.01634, -0.0018), (0.00135617, 0.00096614, 0.00127827, 0.00000444, 0.00000274, 0.00005048)),
    JointRow("wrist_3_joint", "wrist_3_link", "x -z y", (0.0, 0.0996, 0.0), ONE_TURN, JOINT_RATE, 28.0, 0.365,
        (0.0, 0.0, -0.001159), (0.00018694, 0.00018908, 0.00025756, 0.00000006, -0.00000017, -0.00000092)),
)
# fmt: on

# visuals of the base and of each link; the tubes are beside the frames, at the shoulder and elbow offsets
VISUALS = (
    (cylinder((0, 0, 0), (0, 0, 0.1), 0.075),),
    (cylinder((0, 0, -0.06), (0, 0, 0.06), 0.06), cylinder((0, 0, 0), (0, -0.1, 0), 0.06, "accent")),
    (
        cylinder((0, 0, 0.08), (0, 0, 0.2), 0.06),
        capsule((0, 0, 0.138), (-0.425, 0, 0.138), 0.045),
        cylinder((-0.425, 0, 0.06), (-0.425, 0, 0.19), 0.055, "accent"),
    ),
    (
        cylinder((0, 0, -0.05), (0, 0, 0.06), 0.05),
        capsule((0, 0, 0.007), (-0.3922, 0, 0.007), 0.037),
        cylinder((-0.3922, 0, -0.045), (-0.3922, 0, 0.075), 0.042, "accent"),
    ),
    (cylinder((0, 0, -0.06), (0, 0, 0.045), 0.04), cylinder((0, 0, 0), (0, -0.06, 0), 0.04, "accent")),
    (cylinder((0, 0, -0.045), (0, 0, 0.045), 0.04), cylinder((0, 0, 0), (0, 0.06, 0), 0.04, "accent")),
    (cylinder((0, 0, -0.04), (0, 0, 0), 0.038),),
)
UR5E = LinkTable("ur5e", ROWS, Pose.identity(), UR5E_HOME, VISUALS)


def ur5e(base: Any = None, tip: Any = None, *, armature: Any = 0.0) -> Arm:
    """Return the UR5e, with the tool flange (the manufacturer's zero tool frame) as its tip frame.

    The base frame is `base_link` of ROS, with x forward; the base frame of the robot's controller is rotated by half a
    turn about z. Geometry, masses, mass centres and limits are those of the manufacturer. The elbow is limited to half
    a turn in each direction, because it would otherwise collide with the shoulder. The calibrated geometry of a real
    arm differs by millimetres. The drive inertias are not published: `armature` is 0 unless it is given. Joint damping
    and friction are 0.

    Args:
        base: pose of the base frame in the world (a Pose or wxyz_xyz); by default the world frame.
        tip: pose of a massless tool's tip relative to the flange (a Pose or wxyz_xyz); by default the flange.
        armature: drive inertia reflected to the joints, one number or 6 [kg m^2].

    Raises:
        ModelError: a pose is invalid, or an armature is negative.

    Reference:
        Universal Robots, "DH parameters for calculations of kinematics and dynamics" and "Max.
        joint torques" (support articles): geometry, masses, mass centres, torques.
        Universal Robots, Universal_Robots_ROS2_Description, config/ur5e (BSD-3-Clause):
        inertias, limits, the same in URDF frames.
    """
    return UR5E.arm(base, tip, armature)
