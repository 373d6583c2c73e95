"""The displacement of a floating base."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array


class BaseTravel(NamedTuple):
    """The displacement of a base from its initial pose.

    Attributes:
        shift: (frames, 3) displacement of its origin, world axes [m].
        turn: (frames, 3) rotation vector from its initial attitude, world axes [rad].
    """

    shift: Array
    turn: Array


def base_travel(poses: Array) -> BaseTravel:
    """Return the displacements of poses (frames, 7), wxyz_xyz, from the first one."""
    attitudes = [rotation.from_quaternion(pose[:4]) for pose in poses]
    return BaseTravel(poses[:, 4:] - poses[0, 4:], np.array([rotation.log(R @ attitudes[0].T) for R in attitudes]))
