"""The motion of a base that stands on something that moves: a table that tilts, a deck, a vehicle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

from numpy.typing import ArrayLike

from holdfast.control.object_tracking import ObjectPath
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.spatial.converted import REQUIRED
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.spatial.vector import cross

Motion = Callable[[Any], tuple[Any, ArrayLike, ArrayLike]]


@dataclass(frozen=True, eq=False)
class CarriedBase(Frozen):
    """A base fixed to a frame that moves, as `base_motion` of runs and rollouts takes it.

    With r from the frame's origin to the base's,

        v_base = v + omega x r,   v_dot_base = v_dot + omega_dot x r + omega x (omega x r).

    Attributes:
        motion: t [s] -> pose, twist (6,) and acceleration (6,) [omega_dot; v_dot] of the frame, world axes; or a path,
            such as `control.PoseSpline`, whose `at` is taken.
        frame: where the base is, in the axes of that frame.

    Raises:
        ModelError: a motion that is no function and no path.
    """

    motion: Motion | ObjectPath
    frame: PoseField = REQUIRED

    def __post_init__(self) -> None:
        motion = self.motion if callable(self.motion) else getattr(self.motion, "at", None)
        if not callable(motion):
            got = type(self.motion).__name__
            raise ModelError(
                f"carried base: motion: expected a path such as PoseSpline(...), or a function of time, got {got}"
            )
        object.__setattr__(self, "motion", motion)
        object.__setattr__(self, "frame", checks.pose(self.frame, "carried base: frame"))

    @property
    def traceable(self) -> bool:
        """Whether it may become part of machine code: a motion of this library's may, a function may do anything."""
        return exact_fingerprint(self.motion) is not None

    def __call__(self, t: Scalar) -> tuple[Pose, Array, Array]:
        """Return pose, twist and acceleration of the base at time t, world axes."""
        found, twist, acceleration = cast(Motion, self.motion)(t)
        under = found if isinstance(found, Pose) else Pose.unchecked_seven(array(found))
        twist, acceleration = array(twist), array(acceleration)
        at, omega = under @ self.frame, twist[:3]
        r = at.p - under.p
        a = acceleration[3:] + cross(acceleration[:3], r) + cross(omega, cross(omega, r))
        return at, shift_twist(r, twist), concatenate([acceleration[:3], a])
