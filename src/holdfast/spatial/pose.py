"""The pose of one frame in another: a rotation and an origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.spatial import rotation
from holdfast.spatial.converted import ArrayField, Converted
from holdfast.spatial.frozen import Frozen, frozen_property, read_only
from holdfast.spatial.real_numbers import numbers, pose_numbers, rotation_matrix
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import product


@dataclass(frozen=True, eq=False)
class Pose(Frozen):
    """A frame seen from a reference frame: x_reference = R x + p.

    Attributes:
        R: (3, 3) rotation, columns are the frame's axes in the reference frame.
        p: (3,) the frame's origin in the reference frame [m].

    Raises:
        ModelError: R is off from a rotation by more than 1e-6 (less is mended), or numbers are not finite.
    """

    R: ArrayField
    p: ArrayField

    def __post_init__(self) -> None:
        object.__setattr__(self, "R", rotation_matrix(self.R, "pose: R"))
        object.__setattr__(self, "p", numbers(self.p, (3,), "pose: p"))

    @staticmethod
    def unchecked(R: Array, p: Array) -> Pose:
        """Return the pose of arrays that are known to be sound, for algorithms; they are not copied."""
        pose = object.__new__(Pose)
        pose.__dict__.update(R=read_only(R), p=read_only(p))
        return pose

    @staticmethod
    def unchecked_seven(wxyz_xyz: Array) -> Pose:
        """Return the pose of a unit quaternion and a position that are known to be sound."""
        return Pose.unchecked(rotation.from_quaternion(wxyz_xyz[:4]), wxyz_xyz[4:])

    @staticmethod
    def identity() -> Pose:
        """Return the pose of the reference frame itself."""
        return Pose.unchecked(np.eye(3), np.zeros(3))

    @staticmethod
    def translation(x: float, y: float, z: float) -> Pose:
        """Return a frame parallel to the reference frame, its origin at (x, y, z) [m]."""
        return Pose.unchecked(np.eye(3), numbers([x, y, z], (3,), "pose: translation"))

    @staticmethod
    def from_wxyz_xyz(wxyz_xyz: ArrayLike) -> Pose:
        """Return the pose of a unit quaternion followed by a position, (7,).

        Raises:
            ModelError: another shape, numbers that are not finite, or a quaternion off from unit length by over 1e-6.
        """
        return Pose.unchecked_seven(pose_numbers(wxyz_xyz, "pose"))

    @frozen_property
    def wxyz_xyz(self) -> Array:
        """The pose as unit quaternion (w >= 0) and position, (7,)."""
        return np.concatenate([rotation.to_quaternion(self.R), self.p])

    def __matmul__(self, other: Pose) -> Pose:
        """Return the pose of `other`, given in this frame, in the reference frame."""
        return Pose.unchecked(product(self.R, other.R), self.p + product(self.R, other.p))

    def inverse(self) -> Pose:
        """Return the pose of the reference frame in this frame."""
        return Pose.unchecked(self.R.T, -product(self.R.T, self.p))


PoseField = Converted[Pose, Pose | ArrayLike]  # given as a pose, or as unit quaternion and position (7,)
