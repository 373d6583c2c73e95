"""Targets for the object's motion, and smooth paths from rest to rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.compiler.elementary import LARGEST_ARGUMENT
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.names import called
from holdfast.spatial import rotation
from holdfast.spatial.frozen import REQUIRED, ArrayField, Frozen, making
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array, Scalar, concatenate, maximum, minimum


class Target(NamedTuple):
    """The desired pose, twist and acceleration of the object at one time.

    Attributes:
        pose: pose of the object frame (origin C) in the world.
        twist: (6,) twist of C, world axes [rad/s, m/s].
        acceleration: (6,) [omega_dot; v_dot] of C, world axes [rad/s^2, m/s^2].
    """

    pose: Pose
    twist: Array
    acceleration: Array


Joints = tuple[Array, Array, Array]  # positions and their first two derivatives, (n,) each


class ObjectPath(Protocol):
    """The desired motion of the object over time, such as `RestToRest` or `PoseSpline`."""

    def at(self, t: Any) -> Target:
        """Return the target at time t [s]."""
        ...


def path_function(path: Any, what: str) -> Callable[[Any], Any]:
    """Return a path as a function of time: itself if it is one, else its method `at`.

    Raises:
        ModelError: it is neither a function nor a path; the message begins with `what`.
    """
    found = path if callable(path) else getattr(path, "at", None)
    if not callable(found):
        got = type(path).__name__
        raise ModelError(f"{what}: expected a path such as RestToRest(...), or a function of time, got {got}")
    return found


def pose_error(wanted: Pose, frame: Pose) -> Array:
    """Return [log(R_d R^T); p_d - p], (6,) world axes [rad, m]."""
    return concatenate([rotation.log(wanted.R @ frame.R.T), wanted.p - frame.p])


@called
@dataclass(frozen=True, eq=False)
class RestToRest(Frozen):
    """A path that rests, moves by a displacement and a rotation together, and rests again.

    R = exp(s turn) R_0 and p = p_0 + s displacement, with the quintic s = 10 x^3 - 15 x^4
    + 6 x^5 of x = (t - begin) / duration, so that velocity and acceleration begin and end at zero.

    Attributes:
        start: pose at the start.
        displacement: (3,) displacement of C, world axes [m].
        turn: (3,) rotation vector, world axes [rad].
        begin: time at which the motion begins [s].
        duration: duration of the motion [s].
    """

    start: PoseField = REQUIRED
    displacement: ArrayField = field(default_factory=making(np.zeros, 3))
    turn: ArrayField = field(default_factory=making(np.zeros, 3))
    begin: float = 0.0
    duration: float = 1.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "start", checks.pose(self.start, "path: start"))
        put(self, "displacement", checks.numbers(self.displacement, (3,), "path: displacement"))
        put(self, "turn", checks.numbers(self.turn, (3,), "path: turn"))
        if self.turn.dtype != object and np.abs(self.turn).max() > LARGEST_ARGUMENT:
            got = checks.short(self.turn.tolist())
            raise ModelError(f"path: turn: expected at most {LARGEST_ARGUMENT:g} rad, got {got}")
        put(self, "begin", checks.number(self.begin, "path: begin", at_least=0.0))
        put(self, "duration", checks.number(self.duration, "path: duration", above=0.0))

    @property
    def span(self) -> tuple[float, float]:
        """The times at which the motion begins and ends [s]."""
        return self.begin, self.begin + self.duration

    def at(self, t: Scalar) -> Target:
        """Return the target at time t [s].

        Raises:
            ModelError: no finite number.
            StateError: a motion that overflows.
        """
        t = checks.number(t, "path: t")
        s, rate, acceleration = quintic((t - self.begin) / self.duration)
        way = np.concatenate([self.turn, self.displacement])
        with np.errstate(all="ignore"):  # what overflows is refused
            twist, acceleration = rate / self.duration * way, acceleration / self.duration / self.duration * way
            place = self.start.p + s * self.displacement
            checks.finite(np.concatenate([twist, acceleration, place]), "path")
        return Target(Pose(rotation.exp(s * self.turn) @ self.start.R, place), twist, acceleration)


def quintic(x: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Return s = 10 x^3 - 15 x^4 + 6 x^5 and its two derivatives; constant outside 0..1."""
    x = minimum(maximum(x, 0.0), 1.0)
    rest = 1.0 - x
    square = x * x
    return square * x * (10 - 15 * x + 6 * square), 30 * square * rest * rest, 60 * x * rest * (1 - 2 * x)
