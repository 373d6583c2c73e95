"""Arms from tables as published by manufacturers, with one row per joint and the link that it moves."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.robots.primitive import Primitive
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


class JointRow(NamedTuple):
    """A revolute joint about its link's z axis, and that link.

    Attributes:
        joint, link: names, those of the manufacturer if there are any.
        axes: directions of the link's x, y, z at q = 0 along its parent's axes, such as "x -z y".
        origin: origin of the link's frame in its parent's frame [m].
        limits: lowest and highest position [rad].
        rate: highest speed [rad/s].
        effort: highest torque [N m].
        mass: mass [kg].
        com: mass centre in link axes [m].
        inertia: xx, yy, zz, xy, xz, yz about the mass centre, link axes [kg m^2].
    """

    joint: str
    link: str
    axes: str
    origin: tuple[float, float, float]
    limits: tuple[float, float]
    rate: float
    effort: float
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]


class LinkTable(NamedTuple):
    """A built-in robot.

    Attributes:
        name: name of the robot.
        rows: its joints and links, base to tip.
        flange: pose of the flange, on which tools are mounted, relative to the last link.
        home: a configuration that is far from the joint limits, (N,) [rad].
        visuals: solids on its base and on each link.
    """

    name: str
    rows: tuple[JointRow, ...]
    flange: Pose
    home: Array
    visuals: tuple[tuple[Primitive, ...], ...]

    def arm(self, base: Any, tip: Any, armature: Any) -> Arm:
        """Return the arm of the table.

        Args:
            base: pose of the base frame in the world (a Pose or wxyz_xyz); None for the world frame.
            tip: pose of a massless tool's tip relative to the flange, likewise; None for the flange.
            armature: drive inertia reflected to the joints, one number or one per joint [kg m^2].

        Raises:
            ModelError: a pose is invalid, or an armature is negative.
        """
        count = len(self.rows)
        given = [armature] * count if np.ndim(armature) == 0 else armature
        drives = checks.numbers(given, (count,), f"{self.name}: armature").tolist()
        joints = [
            Joint(
                placement=Pose(signed_axes(row.axes), np.array(row.origin)),
                name=row.joint,
                position_limits=row.limits,
                rate_limit=row.rate,
                effort_limit=row.effort,
                armature=drive,
            )
            for row, drive in zip(self.rows, drives, strict=True)
        ]
        links = [Link(row.mass, np.array(row.com), symmetric(row.inertia), name=row.link) for row in self.rows]
        tool = Pose.identity() if tip is None else checks.pose(tip, f"{self.name}: tip")
        return Arm(joints, links, self.flange @ tool, Pose.identity() if base is None else base, name=self.name)


def signed_axes(text: str) -> Array:
    """Return the rotation whose columns are named axes, such as "x -z y", with entries that are exactly 0 or +-1."""
    columns = [np.eye(3)["xyz".index(axis[-1])] * (-1.0 if axis[0] == "-" else 1.0) for axis in text.split()]
    return np.array(columns).T + 0.0  # no -0.0


def symmetric(moments: tuple[float, float, float, float, float, float]) -> Array:
    """Return the symmetric (3, 3) matrix with the entries xx, yy, zz, xy, xz, yz."""
    xx, yy, zz, xy, xz, yz = moments
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
