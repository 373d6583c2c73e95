"""The pose of one frame in another: a rotation and an origin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class Pose:
    """A frame seen from a reference frame: x_reference = R x + p.

    Attributes:
        R: (3, 3) rotation, columns are the frame's axes in the reference frame.
        p: (3,) the frame's origin in the reference frame [m].
    """

    R: Array
    p: Array

    @staticmethod
    def identity() -> Pose:
        """Return the pose of the reference frame itself."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def translation(x: float, y: float, z: float) -> Pose:
        """Return a frame parallel to the reference frame, its origin at (x, y, z) [m]."""
        return Pose(np.eye(3), np.array([x, y, z], dtype=float))

    @staticmethod
    def from_wxyz_xyz(wxyz_xyz: Array) -> Pose:
        """Return the pose of a unit quaternion followed by a position, (7,)."""
        return Pose(rotation.from_quaternion(wxyz_xyz[:4]), wxyz_xyz[4:])

    @cached_property
    def wxyz_xyz(self) -> Array:
        """The pose as unit quaternion (w >= 0) and position, (7,)."""
        return np.concatenate([rotation.to_quaternion(self.R), self.p])

    def __matmul__(self, other: Pose) -> Pose:
        """Return the pose of `other`, given in this frame, in the reference frame."""
        return Pose(self.R @ other.R, self.p + self.R @ other.p)

    def inverse(self) -> Pose:
        """Return the pose of the reference frame in this frame."""
        return Pose(self.R.T, -(self.R.T @ self.p))
