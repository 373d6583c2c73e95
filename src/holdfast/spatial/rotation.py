"""Rotations: matrices, unit quaternions (w, x, y, z), rotation vectors and curves of these, Euler angles.

A matrix R maps the coordinates of a vector from the rotated frame to the reference frame.
"""

from __future__ import annotations

import math
from math import factorial

import numpy as np

from holdfast.spatial.scalar import (
    Array,
    Scalar,
    arctan2,
    array,
    concatenate,
    cos,
    maximum,
    minimum,
    select,
    sin,
    sqrt,
    where,
)
from holdfast.spatial.vector import cross, dot, product

RIGHT_ANGLE = 1e-12  # [rad]; what rounding a double, or 13 digits, leaves of a multiple of pi/2


def from_quaternion(wxyz: Array) -> Array:
    """Return the rotation matrix of a unit quaternion.

    R = (w^2 - v.v) I + 2 v v^T + 2 w v~.

    Args:
        wxyz: (4,) scalar first, unit length (not checked here).

    Returns:
        (3, 3).
    """
    w, x, y, z = wxyz
    return array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def to_quaternion(R: Array) -> Array:
    """Return the unit quaternion (w, x, y, z) with w >= 0 of a rotation matrix.

    4 q q^T is linear in R; the row of the largest component is taken, so no digits cancel.

    Args:
        R: (3, 3).

    Returns:
        (4,).
    """
    (x, y, z), trace = np.diag(R), R[0, 0] + R[1, 1] + R[2, 2]
    a, b, c = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    d, e, f = R[0, 1] + R[1, 0], R[1, 2] + R[2, 1], R[2, 0] + R[0, 2]
    q, most = array([1.0 + trace, a, b, c]), trace
    for entry, row in (
        (x, [a, 1.0 + x - y - z, d, f]),
        (y, [b, d, 1.0 + y - z - x, e]),
        (z, [c, f, e, 1.0 + z - x - y]),
    ):
        q, most = select(entry > most, array(row), q), maximum(entry, most)
    q = q / sqrt(dot(q, q))
    return where(q[0] < 0.0, -1.0, 1.0) * q


def exp(rotation_vector: Array) -> Array:
    """Return the rotation by |r| radians about r / |r|."""
    return from_quaternion(quaternion_exp(rotation_vector))


def quaternion_exp(rotation_vector: Array) -> Array:
    """Return the unit quaternion of a rotation vector [rad]."""
    half = 0.5 * sqrt(dot(rotation_vector, rotation_vector))
    # sin(half)/(2 half): the series is exact to the last digit below 1e-4
    small = half < 1e-4
    ratio = where(small, 0.5 * (1 - half * half / 6), 0.5 * sin(half) / where(small, 1.0, half))
    return concatenate([[cos(half)], ratio * rotation_vector])


def log(R: Array) -> Array:
    """Return the rotation vector [rad], of length <= pi, of a rotation matrix.

    Args:
        R: (3, 3).

    Returns:
        (3,); not-a-number where R is.
    """
    q = to_quaternion(R)
    sine = sqrt(dot(q[1:], q[1:]))
    small = sine < 1e-9  # angle = 2 sine (1 + sine^2/6 ...)
    return where(small, 2.0, 2.0 * arctan2(sine, q[0]) / where(small, 1.0, sine)) * q[1:]


def cosine(R: Array) -> Scalar:
    """Return the cosine of the angle of a rotation matrix, (trace R - 1) / 2."""
    return 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)


def beyond_quarter_turn(cosine: Scalar) -> Scalar:
    """Return an angle [rad] that exceeds a quarter turn, from its cosine; 0 for others.

    The sine of such an angle is that of a smaller one, and vanishes at half a turn. With d = pi - angle it returns
    pi - 2 sin(d/2), which exceeds the angle by d^3 / 24, without an inverse tangent.
    """
    return where(cosine < 0.0, math.pi - sqrt(maximum(2.0 + 2.0 * cosine, 0.0)), 0.0)


def quaternion_product(p: Array, q: Array) -> Array:
    """Return the quaternion of the rotation q followed by p."""
    vector = p[0] * q[1:] + q[0] * p[1:] + cross(p[1:], q[1:])
    return array([p[0] * q[0] - p[1:] @ q[1:], *vector])


def normalised(wxyz: Array) -> Array:
    """Return the quaternion scaled to unit length."""
    return wxyz / sqrt(wxyz @ wxyz)


def quaternion_midpoint(p: Array, q: Array) -> Array:
    """Return the unit quaternion halfway between two of unit length, along the shorter way, (4,) w, x, y, z."""
    return normalised(p + where(p @ q < 0.0, -1.0, 1.0) * q)


def from_euler_zyx(yaw: Scalar, pitch: Scalar, roll: Scalar) -> Array:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll), for any scalars; URDF's `rpy` has these angles in reverse order."""
    z, y, x = np.eye(3)[::-1]
    return product(product(exp(yaw * z), exp(pitch * y)), exp(roll * x))


def from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll), floats only; entries of right angles are exactly 0 or +-1."""
    (cr, sr), (cp, sp), (cy, sy) = _cosine_sine(roll), _cosine_sine(pitch), _cosine_sine(yaw)
    R = array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return R + 0.0  # no -0.0


def _cosine_sine(angle: float) -> tuple[float, float]:
    """Return cosine and sine; an angle within 1e-12 of a multiple of pi/2 is that multiple."""
    quarters = round(angle / (math.pi / 2))
    if abs(angle - quarters * (math.pi / 2)) <= RIGHT_ANGLE:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarters % 4]
    return math.cos(angle), math.sin(angle)


def to_euler_zyx(R: Array) -> Array:
    """Return (yaw, pitch, roll) [rad] with R = Rz Ry Rx and |pitch| <= pi/2, floats only.

    At |pitch| = pi/2 only yaw -+ roll is defined; roll = 0 is returned there.
    """
    pitch = math.atan2(-R[2, 0], math.hypot(R[2, 1], R[2, 2]))
    if math.hypot(R[2, 1], R[2, 2]) < 1e-12:
        return array([math.atan2(-R[0, 1], R[1, 1]), pitch, 0.0])
    return array([math.atan2(R[1, 0], R[0, 0]), pitch, math.atan2(R[2, 1], R[2, 2])])


def is_rotation(R: Array, tolerance: float) -> bool:
    """Return whether R^T R = I and det R = +1 within the tolerance, floats only."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()  # Python's floats, as models are made of thousands of rotations
    lengths = (a * a + d * d + g * g - 1.0, b * b + e * e + h * h - 1.0, c * c + f * f + i * i - 1.0)
    angles = (a * b + d * e + g * h, a * c + d * f + g * i, b * c + e * f + h * i)
    right_handed = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) > 0.0
    return right_handed and all(abs(gap) <= tolerance for gap in (*lengths, *angles))


def skewness(R: Array) -> Scalar:
    """Return the sum of |R^T R - 1| over all entries: how far the columns are from orthogonal unit vectors."""
    return abs(product(R.T, R) - np.eye(3)).sum()


def nearest(R: Array) -> Array:
    """Return the rotation nearest to a matrix that differs from a rotation by at most 1e-3: its polar factor.

    Newton's iteration R <- (R + R^-T) / 2 converges quadratically: four steps reach rounding.
    """
    for _ in range(4):
        cofactors = array([cross(R[1], R[2]), cross(R[2], R[0]), cross(R[0], R[1])])
        R = 0.5 * (R + cofactors / dot(R[0], cofactors[0]))
    return R


def align(a: Array, b: Array) -> Array:
    """Return the shortest rotation vector [rad] that turns one unit vector to another.

    Where a = -b any perpendicular axis serves and one is chosen.

    Args:
        a: (3,).
        b: (3,).

    Returns:
        (3,).
    """
    axis, cosine = cross(a, b), dot(a, b)
    sine = sqrt(dot(axis, axis))
    small = sine <= 1e-12
    ratio = where(small, 1.0, arctan2(sine, cosine) / where(small, 1.0, sine))
    other, least = cross(a, np.eye(3)[0]), abs(a[0])
    for unit, entry in zip(np.eye(3)[1:], a[1:], strict=True):
        other, least = select(abs(entry) < least, cross(a, unit), other), minimum(abs(entry), least)
    back = where(small, where(cosine <= 0.0, 1.0, 0.0), 0.0) > 0.5
    return select(back, (math.pi / sqrt(dot(other, other))) * other, ratio * axis)


_TERMS = 19  # of the series in -|theta|^2 / 4, good to the last digit up to two full turns


def exp_curve(theta: Array, rate: Array, second: Array) -> tuple[Array, Array, Array]:
    """Return R = exp(theta), omega and omega_dot of a rotation vector's curve.

    Of q = [c; s theta] with c = cos(|theta|/2) and s = sin(|theta|/2)/|theta|, entire functions of u = theta.theta,

        omega = 2 vec(q_dot q*),   omega_dot = 2 vec(q_ddot q*).

    Args:
        theta: (3,) rotation vector, its length below 4 pi [rad].
        rate: (3,) its derivative [rad/s].
        second: (3,) its second derivative [rad/s^2].

    Returns:
        (3, 3), and (3,) and (3,) in the axes that R maps to [rad/s, rad/s^2].
    """
    u = dot(theta, theta)
    du, ddu = 2.0 * dot(theta, rate), 2.0 * (dot(rate, rate) + dot(theta, second))
    z = -0.25 * u
    s, s1, s2 = (_series(table, z) for table in _SINE)
    c = _series(_COSINE, z)
    dc, ddc = -0.25 * s * du, -0.25 * (s * ddu + s1 * du * du)
    ds, dds = s1 * du, s1 * ddu + s2 * du * du
    v = s * theta
    dv = ds * theta + s * rate
    ddv = dds * theta + 2.0 * ds * rate + s * second
    R = from_quaternion(concatenate([[c], v]))
    return R, 2.0 * (c * dv - dc * v + cross(v, dv)), 2.0 * (c * ddv - ddc * v + cross(v, ddv))


def _series(coefficients: list[float], z: Scalar) -> Scalar:
    total: Scalar = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = total * z + c
    return total


def _derivative(coefficients: list[float]) -> list[float]:
    """Return the series' derivative by u = -4 z."""
    return [-0.25 * k * c for k, c in enumerate(coefficients)][1:]


_COSINE = [1.0 / factorial(2 * k) for k in range(_TERMS)]
_SINE_OVER = [0.5 / factorial(2 * k + 1) for k in range(_TERMS)]
_SINE = (_SINE_OVER, _derivative(_SINE_OVER), _derivative(_derivative(_SINE_OVER)))
