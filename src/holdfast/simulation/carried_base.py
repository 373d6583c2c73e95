"""The motion of a base that is mounted on a moving frame, such as a tilting table, a deck or a vehicle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

from numpy.typing import ArrayLike

from holdfast.control.paths import ObjectPath, path_function
from holdfast.model import checks
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, Frozen
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.spatial.vector import cross

FrameMotion = Callable[[Any], tuple[Any, ArrayLike, ArrayLike]]


@called
@dataclass(frozen=True, eq=False)
class CarriedBase(Frozen):
    """A base fixed to a moving frame, for the argument `base_motion` of runs and rollouts.

    With r the vector from the origin of the frame to that of the base,

        v_base = v + omega x r,   v_dot_base = v_dot + omega_dot x r + omega x (omega x r).

    Attributes:
        motion: function of t [s] that returns the pose, twist (6,) and acceleration (6,) [omega_dot; v_dot] of the
            frame in world axes, or a path such as `control.PoseSpline`, whose method `at` is used.
        frame: pose of the base in the moving frame.

    Raises:
        ModelError: the motion is neither a function nor a path.
    """

    motion: FrameMotion | ObjectPath
    frame: PoseField = REQUIRED

    def __post_init__(self) -> None:
        object.__setattr__(self, "motion", path_function(self.motion, "carried base: motion"))
        object.__setattr__(self, "frame", checks.pose(self.frame, "carried base: frame"))

    @property
    def traceable(self) -> bool:
        """Whether it may be compiled to machine code: only motions defined by this library are."""
        return exact_fingerprint(self.motion) is not None

    def __call__(self, t: Scalar) -> tuple[Pose, Array, Array]:
        """Return the pose, twist and acceleration of the base at time t, in world axes.

        Raises:
            StateError: numbers have overflowed.
        """
        found, twist, acceleration = cast(FrameMotion, self.motion)(t)
        under = found if isinstance(found, Pose) else Pose.unchecked_seven(array(found))
        twist, acceleration = array(twist), array(acceleration)
        at, omega = under @ self.frame, twist[:3]
        r = at.p - under.p
        a = acceleration[3:] + cross(acceleration[:3], r) + cross(omega, cross(omega, r))
        found = concatenate([shift_twist(r, twist), acceleration[:3], a])
        checks.finite(found, "carried base")
        return at, found[:6], found[6:]
