"""The classical fourth-order Runge-Kutta step, on rotation vectors where there is a rotation.

An attitude is written R = exp(u) R_0 about the attitude R_0 at the step's start, so the
step adds plain vectors and never leaves the rotation group (Munthe-Kaas).
"""

from __future__ import annotations

import math
from collections.abc import Callable

from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import cross


def rk4_step(
    derivative: Callable[[float, Array], Array], t: float, y: Array, step: float, first: Array | None = None
) -> Array:
    """Return y(t + step) for y' = derivative(t, y), to the fourth order.

    Args:
        derivative: (t, y) -> y'.
        t: time [s].
        y: (m,) at time t.
        step: h [s].
        first: derivative(t, y), where it is known already.
    """
    half = 0.5 * step
    k1 = derivative(t, y) if first is None else first
    k2 = derivative(t + half, y + half * k1)
    k3 = derivative(t + half, y + half * k2)
    k4 = derivative(t + step, y + step * k3)
    return y + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def rotation_vector_rate(u: Array, w: Array) -> Array:
    """Return u' for R = exp(u) R_0 that turns at w [rad/s], world axes.

    u' = w - u x w / 2 + c u x (u x w), c = (1 - (a/2) cot(a/2)) / a^2, a = |u| < 2 pi.
    """
    angle = math.sqrt(u @ u)
    # the series is exact to the last digit below 1e-3
    c = 1 / 12 + angle**2 / 720 if angle < 1e-3 else (1 - 0.5 * angle / math.tan(0.5 * angle)) / angle**2
    turned = cross(u, w)
    return w - 0.5 * turned + c * cross(u, turned)
