"""A Stewart platform: six legs of two revolute joints and a drive that lengthens, balls at the top."""

from __future__ import annotations

import math

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.robots.mechanism import Mechanism
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

BASE_RADIUS, BASE_SPREAD = 0.35, np.deg2rad(25.0)  # of the lower joints [m]; half the angle within a pair
TOP_RADIUS, TOP_SPREAD = 0.22, np.deg2rad(12.0)
HEIGHT = 0.45  # of the upper joints over the lower ones, drives at mid stroke [m]
STROKE = 0.12  # each way [m]
TILT = np.deg2rad(40.0)  # each way
CROSS, CYLINDER, ROD = 0.4, 2.0, 1.2  # masses [kg]
CYLINDER_LENGTH, ROD_LENGTH, ROD_RADIUS = 0.28, 0.3, 0.015  # [m]
UP = np.array([0.0, 0.0, 1.0])


def stewart_platform(payload: float = 20.0) -> Mechanism:
    """Return a Stewart platform, its base at the world's origin, platform 0.45 m up.

    Every leg is an arm of three joints: a universal joint at the bottom (two revolute joints,
    undriven in a real machine: give them no torque), then the drive (prismatic). A ball joins
    its tip to the platform. All joint positions are 0 where the platform is level and centred.
    Six mobilities, six drives; the forces are unique though no leg alone can hold anything.

    Args:
        payload: mass of platform and load together, a disc [kg].

    Raises:
        ModelError: a payload that is not positive.

    Reference:
        The arrangement: D. Stewart, "A platform with six degrees of freedom", Proceedings of
        the Institution of Mechanical Engineers 180(1), 1965. Sizes and masses are our own,
        those of a table-top machine.
    """
    bottoms = _ring(BASE_RADIUS, BASE_SPREAD, 0.0)
    tops = _ring(TOP_RADIUS, np.pi / 3 - TOP_SPREAD, 0.0)
    arms, grasps = {}, {}
    for k, (bottom, top) in enumerate(zip(bottoms, tops, strict=True)):
        way = top + HEIGHT * UP - bottom
        length = math.hypot(*way)
        along = Pose(rotation.exp(rotation.align(UP, way / length)), bottom)
        arms[f"leg{k + 1}"] = _leg(length, along)
        grasps[f"leg{k + 1}"] = Grasp("ball", Pose(np.eye(3), top))
    thickness = 0.03
    disc = payload * np.diag([3 * TOP_RADIUS**2 + thickness**2] * 2 + [6 * TOP_RADIUS**2]) / 12
    return Mechanism(arms, HeldObject(payload, disc), grasps)


def _ring(radius: float, spread: float, height: float) -> list[Array]:
    """Return six points in three pairs around the z axis, two of a pair 2 spread apart."""
    angles = [2 * np.pi / 3 * pair + side * spread for pair in range(3) for side in (-1, 1)]
    return [np.array([radius * math.cos(a), radius * math.sin(a), height]) for a in angles]


def _leg(length: float, base: Pose) -> Arm:
    """Return a leg that points along z of its base and is so long at mid stroke."""
    x, y, z = np.eye(3)
    tilt = (-TILT, TILT)
    joints = [
        Joint("revolute", x, name="tilt_x", position_limits=tilt, rate_limit=4.0),
        Joint("revolute", y, name="tilt_y", position_limits=tilt, rate_limit=4.0),
        Joint(
            "prismatic", z, Pose.translation(0.0, 0.0, length), "drive", (-STROKE, STROKE), rate_limit=0.5,
            effort_limit=500.0,
        ),
    ]  # fmt: skip
    links = [
        Link(CROSS, np.zeros(3), 1e-4 * np.eye(3), "cross"),
        Link(CYLINDER, CYLINDER_LENGTH / 2 * z, _rod(CYLINDER, CYLINDER_LENGTH, 2 * ROD_RADIUS), "cylinder"),
        Link(ROD, -ROD_LENGTH / 2 * z, _rod(ROD, ROD_LENGTH, ROD_RADIUS), "rod"),
    ]
    return Arm(joints, links, base=base, name="leg")


def _rod(mass: float, length: float, radius: float) -> Array:
    """Return the inertia of a solid cylinder along z about its centre, (3, 3) [kg m^2]."""
    across = mass * (3 * radius**2 + length**2) / 12
    return np.diag([across, across, mass * radius**2 / 2])
