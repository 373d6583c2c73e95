"""A rotation that moves along a curve of rotation vectors: its matrix, angular velocity and angular acceleration."""

from __future__ import annotations

from math import factorial

from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.spatial.vector import cross, dot

TERMS = 19  # of the series in -|theta|^2 / 4, good to the last digit up to two full turns


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
    s, s1, s2 = (_series(table, z) for table in SINE)
    c = _series(COSINE, z)
    dc, ddc = -0.25 * s * du, -0.25 * (s * ddu + s1 * du * du)
    ds, dds = s1 * du, s1 * ddu + s2 * du * du
    v = s * theta
    dv = ds * theta + s * rate
    ddv = dds * theta + 2.0 * ds * rate + s * second
    R = rotation.from_quaternion(concatenate([[c], v]))
    return R, 2.0 * (c * dv - dc * v + cross(v, dv)), 2.0 * (c * ddv - ddc * v + cross(v, ddv))


def _series(coefficients: list[float], z: Scalar) -> Scalar:
    total: Scalar = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = total * z + c
    return total


def _derivative(coefficients: list[float]) -> list[float]:
    """Return the series' derivative by u = -4 z."""
    return [-0.25 * k * c for k, c in enumerate(coefficients)][1:]


COSINE = [1.0 / factorial(2 * k) for k in range(TERMS)]
_S = [0.5 / factorial(2 * k + 1) for k in range(TERMS)]
SINE = (_S, _derivative(_S), _derivative(_derivative(_S)))
