"""The KUKA LBR iiwa 14 R820: 7 revolute joints, 0.82 m reach, 14 kg payload."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.robots.link_table import JointRow, LinkTable
from holdfast.robots.primitive import Primitive, capsule, cylinder, sphere
from holdfast.spatial.pose import Pose

IIWA14_HOME = checks.read_only(np.array([0.0, np.pi / 4, 0.0, -np.pi / 2, 0.0, np.pi / 4, 0.0]))  # flange down
FLANGE = Pose.translation(0.0, 0.0, 0.045)
DEGREE = np.pi / 180
A170, A120, A175 = ((-angle * DEGREE, angle * DEGREE) for angle in (170, 120, 175))

# fmt: off
ROWS = (
    JointRow("iiwa_joint_1", "iiwa_link_1", "x y z", (0.0, 0.0, 0.1575), A170, 85 * DEGREE, 320.0,
        5.76, (0.0, -0.03, 0.12), (0.033, 0.0333, 0.0123, 0.0, 0.0, 0.0)),
    JointRow("iiwa_joint_2", "iiwa_link_2", "-x z y", (0.0, 0.0, 0.2025), A120, 85 * DEGREE, 320.0,
        6.35, (0.0003, 0.059, 0.042), (0.0305, 0.0304, 0.011, 0.0, 0.0, 0.0)),
    JointRow("iiwa_joint_3", "iiwa_link_3", "-x z y", (0.0, 0.2045, 0.0), A170, 100 * DEGREE, 176.0,
        3.5, (0.0, 0.03, 0.13), (0.025, 0.0238, 0.0076, 0.0, 0.0, 0.0)),
    JointRow("iiwa_joint_4", "iiwa_link_4", "x z -y", (0.0, 0.0, 0.2155), A120, 75 * DEGREE, 176.0,
        3.5, (0.0, 0.067, 0.034), (0.017, 0.0164, 0.006, 0.0, 0.0, 0.0)),
    JointRow("iiwa_joint_5", "iiwa_link_5", "-x z y", (0.0, 0.1845, 0.0), A170, 130 * DEGREE, 110.0,
        3.5, (0.0001, 0.021, 0.076), (0.01, 0.0087, 0.00449, 0.0, 0.0, 0.0)),
    JointRow("iiwa_joint_6", "iiwa_link_6", "x z -y", (0.0, 0.0, 0.2155), A120, 135 * DEGREE, 40.0,
        1.8, (0.0, 0.0006, 0.0004), (0.0049, 0.0047, 0.0036, 0.0, 0.0, 0.0)),
    JointRow("iiwa_joint_7", "iiwa_link_7", "-x z y", (0.0, 0.081, 0.0), A175, 135 * DEGREE, 40.0,
        1.2, (0.0, 0.0, 0.02), (0.001, 0.001, 0.001, 0.0, 0.0, 0.0)),
)
# fmt: on


def _upright(length: float, radius: float) -> tuple[Primitive, ...]:
    """Return a body along its own joint axis, up to the next joint."""
    return (
        capsule((0, -0.02, 0), (0, -0.02, length - 0.08), radius),
        cylinder((0, -0.06, length), (0, 0.06, length), radius, "white"),
    )


def _crosswise(length: float, radius: float) -> tuple[Primitive, ...]:
    """Return a body across its own joint axis, along y."""
    return (
        sphere((0, 0, 0), 1.15 * radius, "accent"),
        capsule((0, 0, 0.03), (0, length - 0.03, 0), 0.9 * radius, "accent"),
    )


# visuals of the base and of each link
VISUALS = (
    (cylinder((0, 0, 0), (0, 0, 0.14), 0.09),),
    _upright(0.2025, 0.075),
    _crosswise(0.2045, 0.08),
    _upright(0.2155, 0.07),
    _crosswise(0.1845, 0.07),
    _upright(0.2155, 0.055),
    (sphere((0, 0, 0), 0.07, "accent"), cylinder((0, 0, -0.07), (0, 0, 0.05), 0.055)),
    (cylinder((0, 0, -0.02), (0, 0, 0.045), 0.05, "dark"),),
)
IIWA14 = LinkTable("iiwa14", ROWS, FLANGE, IIWA14_HOME, VISUALS)


def iiwa14(base: Any = None, tip: Any = None, *, armature: Any = 0.0) -> Arm:
    """Return the LBR iiwa 14 R820, with its media flange as tip frame.

    Geometry and limits are those of the manufacturer. Masses, mass centres and inertias are those of Drake's model,
    whose comments also quote smaller masses from the manufacturer's drawings. In that model, the principal axes of
    inertia are the link axes. No identified parameters and no drive inertias are published: `armature` is 0 unless it
    is given. Joint damping and friction are 0.

    Args:
        base: pose of the base frame in the world (a Pose or wxyz_xyz); by default the world frame.
        tip: pose of a massless tool's tip relative to the flange (a Pose or wxyz_xyz); by default the flange.
        armature: drive inertia reflected to the joints, one number or 7 [kg m^2].

    Raises:
        ModelError: a pose is invalid, or an armature is negative.

    Reference:
        KUKA, "Sensitive robotics: LBR iiwa" (brochure), axis data of the LBR iiwa 14 R820.
        Drake, manipulation/models/iiwa_description, iiwa14_no_collision.urdf (BSD-3-Clause),
        which goes back to the iiwa_stack of IFL-CAMP: frames and inertial parameters.
    """
    return IIWA14.arm(base, tip, armature)
