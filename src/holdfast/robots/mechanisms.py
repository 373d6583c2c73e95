"""Mechanisms made of short arms around one object: a Stewart platform and a three-finger hand."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.grasp import Friction, Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.spatial import rotation
from holdfast.spatial.pose import UP, Pose
from holdfast.spatial.scalar import Array

# The platform.
BASE_RADIUS, BASE_SPREAD = 0.35, np.deg2rad(25.0)  # radius of the lower joints [m]; half the angle within a pair
TOP_RADIUS, TOP_SPREAD = 0.22, np.deg2rad(12.0)
PLATFORM_HEIGHT = 0.45  # height of the upper joints above the lower ones, with drives at mid stroke [m]
STROKE = 0.12  # in each direction [m]
TILT = np.deg2rad(40.0)  # in each direction
CROSS_MASS, CYLINDER, ROD = 0.4, 2.0, 1.2  # masses [kg]
CYLINDER_LENGTH, ROD_LENGTH, ROD_RADIUS = 0.28, 0.3, 0.015  # [m]

# The hand.
KNUCKLE_RADIUS = 0.06  # radius of the knuckles [m]
PHALANGES = (0.055, 0.05)  # [m]
FINGER_RADIUS = 0.009  # [m]
# name, axis in a finger's axes (z along it, x away from the centre of the palm), limits [rad], effort [N m];
# the middle of the limits is a pinch
FINGER_JOINTS = (
    ("swing", (1.0, 0.0, 0.0), (-0.4, 0.4), 0.7),
    ("twist", (0.0, 0.0, 1.0), (-0.6, 0.6), 0.4),
    ("bend", (0.0, -1.0, 0.0), (-1.2, 0.6), 1.2),
    ("curl", (0.0, -1.0, 0.0), (0.0, 2.5), 0.7),
)
FINGER = (("knuckle", 0.02, 0.02), ("base", 0.02, 0.02), ("proximal", 0.05, 0.055), ("distal", 0.035, 0.05))  # kg, m
FEET = (0.0, 0.0, 0.0, PHALANGES[0])  # origin of each link along its parent's z axis [m]
FINGERTIP = Friction(mu=0.8, torsion_radius=0.006)


class Mechanism(NamedTuple):
    """Arms, an object and grasps; `assemble(*mechanism)` makes a closed chain of them.

    Attributes:
        arms: arms by name, with their bases in place.
        held_object: the object.
        grasps: grasps by arm name.
    """

    arms: dict[str, Arm]
    held_object: HeldObject
    grasps: dict[str, Grasp]

    def __repr__(self) -> str:
        """Return the arms' names and the object's mass."""
        return f"<Mechanism of {', '.join(self.arms)}: object {self.held_object.mass:.4g} kg>"


def stewart_platform(payload: float = 20.0) -> Mechanism:
    """Return a Stewart platform with its base at the world's origin and its platform at a height of 0.45 m.

    Every leg is an arm with three joints: a universal joint at the bottom (two revolute joints, which are passive in a
    real machine, so their torques should be zero), and a prismatic drive. A ball grasp connects its tip to the
    platform. All joint positions are 0 if the platform is level and centred. The mobility is six, with six drives. The
    forces are unique, although no leg can hold the platform alone.

    Args:
        payload: mass of platform and load together, which form a disc [kg].

    Raises:
        ModelError: the payload is not positive.

    Reference:
        The arrangement: D. Stewart, "A platform with six degrees of freedom", Proceedings of
        the Institution of Mechanical Engineers 180(1), 1965. The sizes and masses are ours,
        typical of a table-top machine.
    """
    bottoms, tops = _ring(BASE_RADIUS, BASE_SPREAD), _ring(TOP_RADIUS, np.pi / 3 - TOP_SPREAD)
    arms, grasps = {}, {}
    for k, (bottom, top) in enumerate(zip(bottoms, tops, strict=True)):
        axis = top + PLATFORM_HEIGHT * UP - bottom
        length = math.hypot(*axis)
        arms[f"leg{k + 1}"] = _leg(length, Pose(rotation.exp(rotation.align(UP, axis / length)), bottom))
        grasps[f"leg{k + 1}"] = Grasp("ball", Pose(np.eye(3), top))
    thickness = 0.03
    disc = payload * np.diag([3 * TOP_RADIUS**2 + thickness**2] * 2 + [6 * TOP_RADIUS**2]) / 12
    return Mechanism(arms, HeldObject(payload, disc), grasps)


def _ring(radius: float, spread: float) -> list[Array]:
    """Return six points in three pairs around the z axis; the angle within a pair is 2 spread."""
    angles = [2 * np.pi / 3 * pair + side * spread for pair in range(3) for side in (-1, 1)]
    return [np.array([radius * math.cos(a), radius * math.sin(a), 0.0]) for a in angles]


def _leg(length: float, base: Pose) -> Arm:
    """Return a leg along the z axis of its base with the given length at mid stroke."""
    x, y, z = np.eye(3)
    tilt, stroke = (-TILT, TILT), (-STROKE, STROKE)
    joints = [
        Joint("revolute", x, name="tilt_x", position_limits=tilt, rate_limit=4.0),
        Joint("revolute", y, name="tilt_y", position_limits=tilt, rate_limit=4.0),
        Joint("prismatic", z, Pose.translation(0, 0, length), "drive", stroke, rate_limit=0.5, effort_limit=500.0),
    ]
    links = [
        Link(CROSS_MASS, np.zeros(3), 1e-4 * np.eye(3), "cross"),
        Link(CYLINDER, CYLINDER_LENGTH / 2 * z, _solid_cylinder(CYLINDER, CYLINDER_LENGTH, 2 * ROD_RADIUS), "cylinder"),
        Link(ROD, -ROD_LENGTH / 2 * z, _solid_cylinder(ROD, ROD_LENGTH, ROD_RADIUS), "rod"),
    ]
    return Arm(joints, links, base=base, name="leg")


def three_finger_hand(mass: float = 0.15, radius: float = 0.035) -> Mechanism:
    """Return a hand that opens upward, with its palm at the world's origin, and a ball between its fingertips.

    Every finger is an arm with four joints: two at the knuckle swing and twist it, and two bend it inward. It touches
    the ball's equator with a soft fingertip, which can press, and transmits friction and a small moment about the
    normal. The mobility of the ball is six.

    Args:
        mass: mass of the ball, which is solid and uniform [kg].
        radius: radius of the ball [m].

    Raises:
        ModelError: the mass or the radius is not positive.

    Reference:
        Three fingertips around an object: J. K. Salisbury, J. J. Craig, "Articulated hands: force
        control and kinematic issues", International Journal of Robotics Research 1(1), 1982.
        The sizes, masses and friction are ours, typical of a large human hand and of rubber.
    """
    arms, grasps = {}, {}
    for k in range(3):
        turn = rotation.exp(2 * np.pi / 3 * k * UP)
        outward = turn[:, 0]
        arms[f"finger{k + 1}"] = _finger(Pose(turn, KNUCKLE_RADIUS * outward))
        inward = Pose(np.stack([turn[:, 2], turn[:, 1], -turn[:, 0]], axis=1), radius * outward)
        grasps[f"finger{k + 1}"] = Grasp("softfinger", inward, FINGERTIP)
    return Mechanism(arms, HeldObject(mass, 0.4 * mass * radius**2 * np.eye(3)), grasps)


def _finger(base: Pose) -> Arm:
    """Return a finger along the z axis of its base, with x pointing away from the centre of the palm."""
    joints = [
        Joint("revolute", np.array(axis), Pose.translation(0.0, 0.0, foot), name, limits, 6.0, effort)
        for (name, axis, limits, effort), foot in zip(FINGER_JOINTS, FEET, strict=True)
    ]
    links = [
        Link(mass, length / 2 * UP, _solid_cylinder(mass, length, FINGER_RADIUS), name) for name, mass, length in FINGER
    ]
    return Arm(joints, links, Pose.translation(0.0, 0.0, PHALANGES[1]), base, name="finger")


def _solid_cylinder(mass: float, length: float, radius: float) -> Array:
    """Return the inertia of a solid cylinder along z about its centre, (3, 3) [kg m^2]."""
    across = mass * (3 * radius**2 + length**2) / 12
    return np.diag([across, across, mass * radius**2 / 2])
