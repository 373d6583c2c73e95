"""A smooth path of the object through given poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.control.paths import Target
from holdfast.control.piecewise import polynomial, quintics_between, row_at
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.names import called
from holdfast.spatial import rotation
from holdfast.spatial.frozen import REQUIRED, ArrayField, Converted, Frozen, frozen_property
from holdfast.spatial.pose import Pose
from holdfast.spatial.rotation import exp_curve
from holdfast.spatial.scalar import Array, Scalar, concatenate, maximum, minimum, where

HALF_TURN = np.pi - 1e-6  # [rad]: the direction of a larger rotation is ambiguous
EQUAL_POSES = 1e-12  # [m, rad]: poses that differ by less are equal
SAMPLES = 50  # evaluations per piece in the search for the largest speed


@called
@dataclass(frozen=True, eq=False)
class PoseSpline(Frozen):
    """A smooth path through given poses at given times, from rest to rest; it rests before and after.

    From pose k to the next, R = R_k exp(theta), where theta and p are quintic polynomials of time. Pose, twist and
    acceleration are continuous, and twist and acceleration begin and end at zero. At the poses, they are those of the
    path with least squared jerk through the positions p and through the accumulated rotation vectors of the steps.
    Between two equal successive poses the object rests. With two poses the path is that of `RestToRest`.

    Attributes:
        poses: two or more poses of the object frame in the world; successive ones are less than half a turn apart.
        times: times at which the object is at the poses, increasing [s].

    Raises:
        ModelError: there is no such path for the given poses and times.
    """

    poses: Converted[Sequence[Pose], Sequence[Pose | ArrayLike]] = REQUIRED
    times: ArrayField = REQUIRED

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "poses", _poses(self.poses))
        times = checks.vector(self.times, "path: times")
        if times.dtype == object:
            raise ModelError("path: times: expected numbers, got traced ones: a spline is computed beforehand")
        if len(times) != len(self.poses):
            raise ModelError(f"path: times: expected one for each of {len(self.poses)} poses, got {len(times)}")
        if (late := np.flatnonzero(np.diff(times) <= 0.0)).size:
            k = int(late[0])
            raise ModelError(
                f"path: times: expected them to increase, got times[{k}] = {times[k]:g} s and times[{k + 1}] ="
                f" {times[k + 1]:g} s; to rest somewhere, give its pose twice, at two times"
            )
        put(self, "times", times)
        self._require_short_ways()

    @staticmethod
    @np.errstate(over="ignore")  # times that overflow are refused
    def at_speed(
        poses: Sequence[Pose | ArrayLike], speed: float, turn_rate: float, *, begin: float = 0.0
    ) -> PoseSpline:
        """Return the path whose largest speed equals one of the given limits, to 0.1 %.

        The times between poses are proportional to the time that the translation or the rotation needs, whichever is
        longer.

        Args:
            poses: two or more poses; successive ones must differ.
            speed: largest speed of C [m/s].
            turn_rate: largest angular speed [rad/s].
            begin: time at which the motion begins [s].

        Raises:
            ModelError: a limit is not > 0, successive poses are equal, or there is no path through the poses.
        """
        turning = checks.number(turn_rate, "path: turn_rate", above=0.0)
        limits = np.repeat([turning, checks.number(speed, "path: speed", above=0.0)], 3)
        begin, given = checks.number(begin, "path: begin"), _poses(poses)
        spans = [np.linalg.norm((_step(a, b) / limits).reshape(2, 3), axis=1).max() for a, b in pairwise(given)]
        if (still := np.flatnonzero(_still(given))).size:
            raise ModelError(
                f"path: poses: poses[{still[0]}] and poses[{still[0] + 1}] are equal, so no duration between them"
                " follows from the limits; leave one out, or give times to pause there"
            )
        unscaled = PoseSpline(given, np.r_[0.0, np.cumsum(spans)])
        samples = np.concatenate([np.linspace(a, b, SAMPLES) for a, b in pairwise(unscaled.times)])
        fastest = max(
            np.linalg.norm((unscaled.at(float(t)).twist / limits).reshape(2, 3), axis=1).max() for t in samples
        )
        return PoseSpline(given, begin + float(fastest) * unscaled.times)

    @property
    def span(self) -> tuple[float, float]:
        """The times at which the motion begins and ends [s]."""
        return float(self.times[0]), float(self.times[-1])

    def at(self, t: Scalar) -> Target:
        """Return the target at time t [s].

        Raises:
            ModelError: no finite number.
        """
        t = checks.number(t, "path: t")
        row = row_at(t, self.times[:-1], self._rows)
        c, R, begin, span = row[:36].reshape(6, 6), row[36:45].reshape(3, 3), row[45], row[46]
        x = minimum(maximum((t - begin) / span, 0.0), 1.0)
        y, rate, second = polynomial(c, x)
        moves = where(t < self.times[-1], 1.0, 0.0)  # removes rounding errors at the end
        rate, second = moves / span * rate, moves / span / span * second
        turned, omega, omega_dot = exp_curve(y[:3], rate[:3], second[:3])
        twist, acceleration = concatenate([R @ omega, rate[3:]]), concatenate([R @ omega_dot, second[3:]])
        return Target(Pose(R @ turned, y[3:]), twist, acceleration)

    @frozen_property
    def _rows(self) -> Array:
        """Coefficients, rotation at the beginning, begin and span of each piece, (pieces, 47)."""
        R = [pose.R.ravel() for pose in self.poses[:-1]]
        return np.column_stack([self._pieces.reshape(-1, 36), R, self.times[:-1], np.diff(self.times)])

    @frozen_property
    def _pieces(self) -> Array:
        """Coefficients of [theta; p] in x = (t - t_k) / (t_k+1 - t_k), (pieces, 6, 6), six for each coordinate."""
        poses, spans = self.poses, np.diff(self.times)
        rate, second = _knots(poses, self.times)
        found = []
        for k, (a, b, h) in enumerate(zip(poses[:-1], poses[1:], spans, strict=True)):
            phi = _step(a, b)[:3]
            first = (np.r_[np.zeros(3), a.p], h * rate[k], h**2 * second[k])
            theta_rate, theta_second = _theta_derivatives(phi, rate[k + 1, :3], second[k + 1, :3])
            last = (
                np.r_[phi, b.p],
                h * np.r_[theta_rate, rate[k + 1, 3:]],
                h**2 * np.r_[theta_second, second[k + 1, 3:]],
            )
            found.append(quintics_between(first, last))
        return np.array(found)

    def _require_short_ways(self) -> None:
        """Refuse successive poses that are half a turn apart, and times for which the path would swing too far."""
        for k, c in enumerate(self._pieces):
            a, b = self.poses[k], self.poses[k + 1]
            if (angle := np.linalg.norm(_step(a, b)[:3])) > HALF_TURN:
                raise ModelError(
                    f"path: poses: poses[{k + 1}] is turned against poses[{k}] by {np.degrees(angle):.6g} degrees, and"
                    " either way round is as short; try a pose between them"
                )
            swing = max(np.linalg.norm(polynomial(c, x)[0][:3]) for x in np.linspace(0.0, 1.0, SAMPLES))
            if swing > 2 * np.pi:
                raise ModelError(
                    f"path: times: between times[{k}] and times[{k + 1}] a smooth path would swing by"
                    f" {swing / (2 * np.pi):.3g} turns and back, as times are so uneven; try PoseSpline.at_speed(poses,"
                    " speed, turn_rate)"
                )


def _poses(given: Any) -> tuple[Pose, ...]:
    """Return the checked poses."""
    listed = isinstance(given, Sequence) or (isinstance(given, np.ndarray) and given.ndim > 0)
    if not listed or isinstance(given, Pose | str):
        raise ModelError(f"path: poses: expected a list of poses, got {type(given).__name__}")
    if len(given) < 2:
        raise ModelError(f"path: poses: expected two or more, got {len(given)}")
    found = tuple(checks.pose(pose, f"path: poses[{k}]") for k, pose in enumerate(given))
    for k, pose in enumerate(found):
        if pose.R.dtype == object or pose.p.dtype == object:
            raise ModelError(f"path: poses[{k}]: expected numbers, got traced ones: a spline is computed beforehand")
    return found


def _step(a: Pose, b: Pose) -> Array:
    """Return [phi; d] from one pose to the next, (6,): R_b = R_a exp(phi), p_b = p_a + d."""
    return np.r_[rotation.log(a.R.T @ b.R), b.p - a.p]


def _still(poses: Sequence[Pose]) -> Array:
    """Return whether each pose equals the pose before it, (poses - 1,)."""
    return np.array([np.abs(_step(a, b)).max() <= EQUAL_POSES for a, b in pairwise(poses)])


def _knots(poses: Sequence[Pose], times: Array) -> tuple[Array, Array]:
    """Return the first and second derivatives at the poses, (poses, 6) each: rotations in body axes, then p.

    They are those of the quintic spline (with four continuous derivatives) through the accumulated steps, from rest to
    rest. If two successive poses are equal, one spline ends there and the next begins.
    """
    from scipy.interpolate import make_interp_spline  # imported here because it takes half a second

    steps = np.array([_step(a, b) for a, b in pairwise(poses)])
    way = np.concatenate([np.zeros((1, 6)), np.cumsum(steps, axis=0)])
    rate, second, first = np.zeros_like(way), np.zeros_like(way), 0
    for k, still in enumerate([*_still(poses), True]):
        if not still:
            continue
        if k > first:
            here = slice(first, k + 1)
            rest = [(1, np.zeros(6)), (2, np.zeros(6))]
            spline = make_interp_spline(times[here], way[here], k=5, bc_type=(rest, rest))
            inside = slice(first + 1, k)
            rate[inside], second[inside] = spline(times[inside], 1), spline(times[inside], 2)
        first = k + 1
    return rate, second


def _theta_derivatives(phi: Array, omega: Array, omega_dot: Array) -> tuple[Array, Array]:
    """Return the derivatives of theta at phi for an angular velocity and acceleration in body axes."""
    none = np.zeros(3)
    R, _, _ = exp_curve(phi, none, none)
    J = np.column_stack([exp_curve(phi, unit, none)[1] for unit in np.eye(3)])
    rate = np.linalg.solve(J, R @ omega)
    return rate, np.linalg.solve(J, R @ omega_dot - exp_curve(phi, rate, none)[2])
