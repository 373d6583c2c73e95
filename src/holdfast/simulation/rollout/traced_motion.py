"""Motions of bases as part of the machine code."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from holdfast.compiled.traced_chain import unit_pose
from holdfast.model import checks
from holdfast.model.checks import ROTATION_TOLERANCE
from holdfast.simulation.environment import BaseMotion, motion_of
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, where

Motions = Mapping[str, BaseMotion]  # of the bases that move, by arm name


def sound(name: str, motion: BaseMotion) -> Callable[[Scalar], tuple[Pose, Array, Array]]:
    """Return the motion, its pose not-a-number where what it returns is none: on floats that is refused."""

    def found(t: Scalar) -> tuple[Pose, Array, Array]:
        pose, twist, acceleration = motion_of(name, motion(t))
        if not isinstance(pose, Pose):
            seven = checks.numbers(pose, (7,), f"base motion of '{name}' (wxyz_xyz)")
            return unit_pose(seven, ()), twist, acceleration
        R = where(rotation.skewness(pose.R) <= ROTATION_TOLERANCE, pose.R, np.nan)
        return Pose.unchecked(R, pose.p), twist, acceleration

    return found
