"""The Franka Emika Panda: 7 revolute joints, 0.855 m reach, 3 kg payload."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.robots.link_table import JointRow, LinkTable
from holdfast.robots.primitive import capsule, cylinder
from holdfast.spatial.pose import Pose

PANDA_HOME = checks.read_only(np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4]))

# Reflected inertia of the drives [kg m^2] of the successor FR3, provided by its manufacturer (in Drake's
# franka_description). For the Panda itself, none is published.
FR3_ARMATURE = checks.read_only(
    np.array([0.605721456, 0.605721456, 0.462474144, 0.462474144, 0.205544064, 0.205544064, 0.205544064])
)

FLANGE = Pose.translation(0.0, 0.0, 0.107)

# fmt: off
ROWS = (
    JointRow("joint1", "link1", "x y z", (0.0, 0.0, 0.333), (-2.8973, 2.8973), 2.175, 87.0, 4.970684,
        (3.875e-03, 2.081e-03, -4.762e-02), (7.0337e-01, 7.0661e-01, 9.117e-03, -1.39e-04, 6.772e-03, 1.9169e-02)),
    JointRow("joint2", "link2", "x -z y", (0.0, 0.0, 0.0), (-1.7628, 1.7628), 2.175, 87.0, 0.646926,
        (-3.141e-03, -2.872e-02, 3.495e-03), (7.962e-03, 2.811e-02, 2.5995e-02, -3.925e-03, 1.0254e-02, 7.04e-04)),
    JointRow("joint3", "link3", "x z -y", (0.0, -0.316, 0.0), (-2.8973, 2.8973), 2.175, 87.0, 3.228604,
        (2.7518e-02, 3.9252e-02, -6.6502e-02),
        (3.7242e-02, 3.6155e-02, 1.083e-02, -4.761e-03, -1.1396e-02, -1.2805e-02)),
    JointRow("joint4", "link4", "x z -y", (0.0825, 0.0, 0.0), (-3.0718, -0.0698), 2.175, 87.0, 3.587895,
        (-5.317e-02, 1.04419e-01, 2.7454e-02), (2.5853e-02, 1.9552e-02, 2.8323e-02, 7.796e-03, -1.332e-03, 8.641e-03)),
    JointRow("joint5", "link5", "x -z y", (-0.0825, 0.384, 0.0), (-2.8973, 2.8973), 2.61, 12.0, 1.225946,
        (-1.1953e-02, 4.1065e-02, -3.8437e-02), (3.5549e-02, 2.9474e-02, 8.627e-03, -2.117e-03, -4.037e-03, 2.29e-04)),
    JointRow("joint6", "link6", "x z -y", (0.0, 0.0, 0.0), (-0.0175, 3.7525), 2.61, 12.0, 1.666555,
        (6.0149e-02, -1.4117e-02, -1.0517e-02), (1.964e-03, 4.354e-03, 5.433e-03, 1.09e-04, -1.158e-03, 3.41e-04)),
    JointRow("joint7", "link7", "x z -y", (0.088, 0.0, 0.0), (-2.8973, 2.8973), 2.61, 12.0, 7.35522e-01,
        (1.0517e-02, -4.252e-03, 6.1597e-02), (1.2516e-02, 1.0027e-02, 4.815e-03, -4.28e-04, -1.196e-03, -7.41e-04)),
)
# fmt: on

# visuals of the base and of each link, which follow the outline of the real ones
VISUALS = (
    (capsule((-0.08, 0, 0.06), (0, 0, 0.06), 0.06, "white"), cylinder((0, 0, 0), (0, 0, 0.14), 0.07)),
    (capsule((0, 0, -0.18), (0, 0, -0.02), 0.06, "white"),),
    (cylinder((0, 0, -0.07), (0, 0, 0.07), 0.06, "white"), capsule((0, 0, 0), (0, -0.12, 0), 0.06)),
    (capsule((0, 0, -0.19), (0, 0, -0.08), 0.06, "white"), capsule((0, 0, -0.05), (0.08, 0, 0), 0.05)),
    (cylinder((0, 0, -0.07), (0, 0, 0.07), 0.055, "white"), capsule((0, 0, 0), (-0.08, 0.09, 0), 0.05)),
    (
        capsule((0, 0, -0.25), (0, 0, -0.19), 0.055, "white"),
        capsule((0, 0.07, -0.19), (0, 0.08, -0.02), 0.03, "white"),
        cylinder((0, -0.06, 0), (0, 0.08, 0), 0.05),
    ),
    (cylinder((0, 0, -0.07), (0, 0, 0.06), 0.045, "white"), capsule((0, 0, 0), (0.088, 0, 0), 0.045, "white")),
    (cylinder((0, 0, 0), (0, 0, 0.107), 0.042),),
)
PANDA = LinkTable("panda", ROWS, FLANGE, PANDA_HOME, VISUALS)


def panda(base: Any = None, tip: Any = None, *, armature: Any = 0.0) -> Arm:
    """Return the Panda without its hand, with the flange (link 8) as its tip frame.

    Link frames, position limits and rate limits are those of the manufacturer. Masses, mass centres and inertias were
    identified on a real arm, from the torque sensors after the gears, so they do not include the drive inertias. These
    are not published for the Panda: `armature` is 0 unless it is given. `FR3_ARMATURE` contains those of the successor.
    Joint friction is 0.

    Args:
        base: pose of the base frame in the world (a Pose or wxyz_xyz); by default the world frame.
        tip: pose of a massless tool's tip relative to the flange (a Pose or wxyz_xyz); by default the flange. The
            manufacturer's hand is 0.1034 m long, and rotated by -pi/4 about z.
        armature: drive inertia reflected to the joints, one number or 7 [kg m^2].

    Raises:
        ModelError: a pose is invalid, or an armature is negative.

    Reference:
        Franka Emika, "Robot and interface specifications" (Franka Control Interface
        documentation): Denavit-Hartenberg parameters and limits of the Panda.
        C. Gaz, M. Cognetti, A. Oliva, P. Robuffo Giordano, A. De Luca, "Dynamic
        identification of the Franka Emika Panda robot with retrieval of feasible
        parameters using penalty-based optimization", IEEE Robotics and Automation
        Letters 4(4), 2019: inertial parameters, as in the manufacturer's URDF.
    """
    return PANDA.arm(base, tip, armature)
