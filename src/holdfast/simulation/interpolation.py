"""The state between two samples: Hermite's quintic through positions, rates and accelerations at both."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.errors import StateError
from holdfast.spatial.rotation import quaternion_product
from holdfast.spatial.scalar import Array
from holdfast.state import State


class Knot(NamedTuple):
    """What a quintic goes through.

    Attributes:
        t: time [s].
        state: positions and velocities.
        qdd: (n,) joint accelerations [rad/s^2 or m/s^2].
        object_acceleration: (6,) [omega_dot; v_dot of C], world axes.
    """

    t: float
    state: State
    qdd: Array
    object_acceleration: Array


def interpolant(now: Knot, later: Knot) -> Callable[[float], State]:
    """Return the state as a function of time between two knots.

    Joint positions, the object's position and the four numbers of its quaternion follow
    quintics; velocities are their slopes. Over a step h positions are good to O(h^6),
    velocities to O(h^5), and both are exact at the ends. A state between is not projected:
    its grasps are open by the same O(h^6) and O(h^5). Where torques jump at `later` (a
    controller that holds them for a step) the accelerations do not belong to the step and
    the orders are 2 and 1.

    Args:
        now: the earlier knot.
        later: the one after it.

    Raises:
        StateError: from the returned function, at a time not between the two.
    """
    step = later.t - now.t
    ends = _motion(now, np.zeros(4)), _motion(later, now.state.object_pose[:4])
    n = len(now.state.q)

    def state(t: float) -> State:
        if not now.t <= t <= later.t:
            raise StateError(f"interpolation: t: expected {now.t:.9g} to {later.t:.9g} s, got {t:.9g} s")
        x, rate = _quintic(*ends[0], *ends[1], step, (t - now.t) / step)
        quaternion, turning = x[n : n + 4], rate[n : n + 4]
        length = np.sqrt(quaternion @ quaternion)
        inverse = np.array([1.0, -1.0, -1.0, -1.0]) * quaternion / length**2
        omega = 2.0 * quaternion_product(turning, inverse)[1:]  # the scalar part only changes the length
        pose = np.concatenate([quaternion / length, x[n + 4 :]])
        return State(x[:n], rate[:n], pose, np.concatenate([omega, rate[n + 4 :]]))

    return state


def _motion(at: Knot, near: Array) -> tuple[Array, Array, Array]:
    """Return (q, quaternion, p) of a knot, its rates and accelerations, (n + 7,) each.

    With W = [0; omega] the quaternion's rate is W o quaternion / 2. Of the two quaternions of an
    attitude the one nearest to `near` is taken.
    """
    state, acceleration = at.state, at.object_acceleration
    quaternion = state.object_pose[:4] if state.object_pose[:4] @ near >= 0.0 else -state.object_pose[:4]
    spin, spinning_up = (np.concatenate([[0.0], x[:3]]) for x in (state.object_twist, acceleration))
    turning = 0.5 * quaternion_product(spin, quaternion)
    turning_up = 0.5 * (quaternion_product(spinning_up, quaternion) + quaternion_product(spin, turning))
    return (
        np.concatenate([state.q, quaternion, state.object_pose[4:]]),
        np.concatenate([state.qd, turning, state.object_twist[3:]]),
        np.concatenate([at.qdd, turning_up, acceleration[3:]]),
    )


def _quintic(
    x0: Array, v0: Array, a0: Array, x1: Array, v1: Array, a1: Array, step: float, s: float
) -> tuple[Array, Array]:
    """Return value and rate at the part s of the step, 0 at its start and 1 at its end."""
    gap = x1 - x0 - step * v0 - 0.5 * step**2 * a0  # what is left to the powers 3, 4 and 5 of s
    gap_rate = step * (v1 - v0 - step * a0)
    gap_acceleration = step**2 * (a1 - a0)
    c3 = 10.0 * gap - 4.0 * gap_rate + 0.5 * gap_acceleration
    c4 = -15.0 * gap + 7.0 * gap_rate - gap_acceleration
    c5 = 6.0 * gap - 3.0 * gap_rate + 0.5 * gap_acceleration
    t = s * step
    x = x0 + t * v0 + 0.5 * t**2 * a0 + s**3 * (c3 + s * (c4 + s * c5))
    return x, v0 + t * a0 + s**2 * (3.0 * c3 + s * (4.0 * c4 + 5.0 * s * c5)) / step
