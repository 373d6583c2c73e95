"""The pose of one frame in another: a rotation and an origin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError
from holdfast.spatial import rotation
from holdfast.spatial.converted import ArrayField, Converted
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import product


@dataclass(frozen=True, eq=False)
class Pose:
    """A frame seen from a reference frame: x_reference = R x + p.

    Attributes:
        R: (3, 3) rotation, columns are the frame's axes in the reference frame.
        p: (3,) the frame's origin in the reference frame [m].
    """

    R: ArrayField
    p: ArrayField

    def __post_init__(self) -> None:
        if not (isinstance(self.R, np.ndarray) and isinstance(self.p, np.ndarray)):
            object.__setattr__(self, "R", _floats(self.R, (3, 3), "R"))
            object.__setattr__(self, "p", _floats(self.p, (3,), "p"))

    @staticmethod
    def identity() -> Pose:
        """Return the pose of the reference frame itself."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def translation(x: float, y: float, z: float) -> Pose:
        """Return a frame parallel to the reference frame, its origin at (x, y, z) [m]."""
        return Pose(np.eye(3), np.array([x, y, z], dtype=float))

    @staticmethod
    def from_wxyz_xyz(wxyz_xyz: ArrayLike) -> Pose:
        """Return the pose of a unit quaternion followed by a position, (7,)."""
        given = _floats(wxyz_xyz, (7,), "wxyz_xyz")
        return Pose(rotation.from_quaternion(given[:4]), given[4:])

    @cached_property
    def wxyz_xyz(self) -> Array:
        """The pose as unit quaternion (w >= 0) and position, (7,)."""
        return np.concatenate([rotation.to_quaternion(self.R), self.p])

    def __matmul__(self, other: Pose) -> Pose:
        """Return the pose of `other`, given in this frame, in the reference frame."""
        return Pose(product(self.R, other.R), self.p + product(self.R, other.p))

    def inverse(self) -> Pose:
        """Return the pose of the reference frame in this frame."""
        return Pose(self.R.T, -product(self.R.T, self.p))


PoseField = Converted[Pose, Pose | ArrayLike]  # given as a pose, or as unit quaternion and position (7,)


def _floats(given: ArrayLike, shape: tuple[int, ...], what: str) -> Array:
    """Return an array as it is, anything else as an array of the shape."""
    if isinstance(given, np.ndarray):
        return given
    try:
        made = np.array(given, dtype=float)
    except (TypeError, ValueError) as cause:
        raise ModelError(f"pose: {what}: expected numbers of shape {shape}, got {given!r}") from cause
    if made.shape != shape:
        raise ModelError(f"pose: {what}: expected shape {shape}, got shape {made.shape}")
    return made
