"""The pose of one frame in another, a rotation and an origin, and its tangents [turn; shift]."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError
from holdfast.names import called
from holdfast.spatial import rotation
from holdfast.spatial.frozen import REQUIRED, ArrayField, Converted, Frozen, frozen_property, read_only
from holdfast.spatial.real_numbers import numbers, pose_numbers, rotation_matrix
from holdfast.spatial.scalar import Array, concatenate
from holdfast.spatial.vector import axial, cross, dot, product, skew

PARALLEL = 1e-6  # sine of the angle between directions that count as one
UP = np.array([0.0, 0.0, 1.0])


@called
@dataclass(frozen=True, eq=False)
class Pose(Frozen):
    """A frame seen from a reference frame: x_reference = R x + p.

    Attributes:
        R: (3, 3) rotation, columns are the frame's axes in the reference frame.
        p: (3,) the frame's origin in the reference frame [m].

    Raises:
        ModelError: R is off from a rotation by more than 1e-6 (less is mended), or numbers are not finite.
    """

    R: ArrayField = REQUIRED
    p: ArrayField = REQUIRED

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

    @staticmethod
    def from_xyzw(xyzw: ArrayLike, p: ArrayLike = (0.0, 0.0, 0.0)) -> Pose:
        """Return the pose of a unit quaternion whose scalar is last, as SciPy and ROS write it, and a position.

        Args:
            xyzw: (4,).
            p: (3,) [m].

        Raises:
            ModelError: as for `from_wxyz_xyz`.
        """
        x, y, z, w = numbers(xyzw, (4,), "pose: xyzw")
        return Pose.from_wxyz_xyz([w, x, y, z, *numbers(p, (3,), "pose: p")])

    @staticmethod
    def from_rpy(roll: float, pitch: float, yaw: float, xyz: ArrayLike = (0.0, 0.0, 0.0)) -> Pose:
        """Return the pose of URDF's angles about the fixed axes x, y, z, in this order, and a position.

            R = Rz(yaw) Ry(pitch) Rx(roll)

        Args:
            roll: about x [rad]; within 1e-12 of a multiple of pi/2 an angle is that multiple.
            pitch: about y [rad].
            yaw: about z [rad].
            xyz: (3,) the frame's origin [m].

        Raises:
            ModelError: numbers that are not finite, or a position of another shape.
        """
        angles = numbers([roll, pitch, yaw], (3,), "pose: rpy")
        return Pose.unchecked(rotation.from_rpy(*angles.tolist()), numbers(xyz, (3,), "pose: xyz"))

    @staticmethod
    def from_matrix(T: ArrayLike) -> Pose:
        """Return the pose of a homogeneous matrix [R, p; 0, 1], (4, 4).

        Raises:
            ModelError: a bottom row other than 0 0 0 1, or R and p that `Pose` refuses.
        """
        matrix = numbers(T, (4, 4), "pose: matrix")
        if matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
            raise ModelError(
                f"pose: matrix: expected the bottom row 0 0 0 1, got {' '.join(f'{x:g}' for x in matrix[3])};"
                " try the transpose if its last column is 0 0 0 1"
            )
        return Pose(matrix[:3, :3], matrix[:3, 3])

    @staticmethod
    def looking(
        origin: ArrayLike = (0.0, 0.0, 0.0),
        *,
        at: ArrayLike | None = None,
        z: ArrayLike | None = None,
        x: ArrayLike | None = None,
    ) -> Pose:
        """Return a frame at a point whose z axis looks at another point, or along a direction.

        Its x axis is as near as it can be to `x`. By default the axes are a camera's, x to its right and y down, -z of
        the reference frame; where the z axes are parallel (within 1e-6 rad), x is near to the reference frame's.

        Args:
            origin: (3,) where the frame stands [m].
            at: (3,) the point that z looks at [m].
            z: (3,) the direction that z looks along, of any length, if not at a point.
            x: (3,) the direction for x, of any length.

        Raises:
            ModelError: both or neither of `at` and `z`, a direction of length zero, or an `x` along z.
        """
        p = numbers(origin, (3,), "pose: origin")
        if (at is None) == (z is None):
            raise ModelError(f"pose: looking: expected one of at and z, got {'neither' if at is None else 'both'}")
        ahead = _direction(z, "z") if at is None else _direction(numbers(at, (3,), "pose: at") - p, "at - origin")
        return Pose(_axes(ahead, x), p)

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


def _direction(value: Any, what: str) -> Array:
    """Return a vector scaled to length 1."""
    a = numbers(value, (3,), f"pose: {what}")
    length = math.hypot(*a)
    if length == 0.0:
        raise ModelError(f"pose: {what}: expected a direction, got a vector of length zero")
    return a / length


def _axes(z: Array, hint: ArrayLike | None) -> Array:
    """Return the rotation with that unit z axis, its x axis as near to the hint as it can be."""
    wished = cross(z, UP) if hint is None else _direction(hint, "x")
    across = wished - dot(wished, z) * z
    if math.hypot(*across) < PARALLEL:
        if hint is not None:
            raise ModelError("pose: x: expected a direction across z, got one along it")
        across = np.eye(3)[0] - z[0] * z
    x = across / math.hypot(*across)
    return np.column_stack([x, cross(z, x), z]) + 0.0  # no -0.0


PoseField = Converted[Pose, Pose | ArrayLike]  # given as a pose, or as unit quaternion and position (7,)


def rates_of(tangents: Mapping[str, Array], what: str, R: Array, named: str = "") -> dict[str, Array]:
    """Return the rates of the matrix and the origin of a pose for its tangent [turn; shift]; empty without a tangent.

    Args:
        tangents: tangents by argument.
        what: name of the pose, without "_pose".
        R: its matrix.
        named: name of matrix and origin in the result, without "_R" and "_p"; by default `what`.
    """
    if f"{what}_pose" not in tangents:
        return {}
    motion, name = tangents[f"{what}_pose"], named or what
    return {f"{name}_R": skew(motion[:3]) @ R, f"{name}_p": motion[3:]}


def by_motion(of_R: Array, R: Array, of_p: Array) -> Array:
    """Return the gradient (6,) with respect to [turn; shift] of a pose from those by its matrix and its origin."""
    return concatenate([axial(of_R @ R.T), of_p])


def by_motions(of_R: Array, R: Array, of_p: Array) -> Array:
    """Return the gradients (..., 6) with respect to one pose, or to several with a leading axis; see `by_motion`."""
    each = zip(of_R.reshape(-1, 3, 3), R.reshape(-1, 3, 3), of_p.reshape(-1, 3), strict=True)
    return np.array([by_motion(*one) for one in each]).reshape(*of_p.shape[:-1], 6)
