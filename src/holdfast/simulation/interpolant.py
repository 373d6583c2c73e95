"""Interpolation of a motion between two instants by quintics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import StateError
from holdfast.spatial.rotation import quaternion_product
from holdfast.spatial.scalar import Array
from holdfast.state import State


class Knot(NamedTuple):
    """An end point of an interpolating quintic.

    Attributes:
        t: time [s].
        state: positions and velocities.
        accelerations: (n + 6,) accelerations of the joints [rad/s^2 or m/s^2] and of the object [omega_dot; v_dot of
            C], world axes; a floating base adds six entries.
    """

    t: float
    state: State
    accelerations: Array


def interpolant(now: Knot, later: Knot) -> Callable[[float], State]:
    """Return the state as a function of time between two knots.

    Joint positions and the position and quaternion of the object, and of a floating base, follow quintics; velocities
    are their derivatives. Over a step h the error is O(h^6) for positions and O(h^5) for velocities, and both are exact
    at the ends. The interpolated state is not projected, so its grasps are open by O(h^6) and O(h^5), too. If torques
    jump at `later` (for example with a controller that holds them during a step), the accelerations there do not belong
    to the step, and the orders are 2 and 1.

    Args:
        now: the earlier knot.
        later: the later knot.

    Raises:
        StateError: raised by the returned function if the time is not between the two knots.
    """
    step = later.t - now.t
    ends = [_motion(at, now.state) for at in (now, later)]
    n, floats = len(now.state.q), now.state.base_pose is not None

    def state(t: float) -> State:
        if not now.t <= t <= later.t:
            raise StateError(f"interpolation: t: expected {now.t:.9g} to {later.t:.9g} s, got {t:.9g} s")
        x, rate = quintic(*ends[0], *ends[1], step, (t - now.t) / step)
        held, *base = [_pose_and_twist(x[k : k + 7], rate[k : k + 7]) for k in range(n, len(x), 7)]
        return State(x[:n], rate[:n], *held, *(base[0] if floats else ()))

    return state


def _motion(at: Knot, near: State) -> tuple[Array, Array, Array]:
    """Return q and (quaternion, p) of the free bodies at a knot, their rates and accelerations, (n + 7 bodies,) each.

    Of the two quaternions that represent an attitude, the one nearer to that in `near` is used.
    """
    state, n = at.state, len(at.state.q)
    bodies = [_free_body(state.object_pose, state.object_twist, at.accelerations[n : n + 6], near.object_pose)]
    if state.base_pose is not None and state.base_twist is not None and near.base_pose is not None:
        bodies.append(_free_body(state.base_pose, state.base_twist, at.accelerations[n + 6 :], near.base_pose))
    joints = (state.q, state.qd, at.accelerations[:n])
    x, v, a = (np.concatenate(parts) for parts in zip(joints, *bodies, strict=True))
    return x, v, a


def _free_body(pose: Array, twist: Array, acceleration: Array, near: Array) -> tuple[Array, Array, Array]:
    """Return (quaternion, p) of a free body, its rate and acceleration, (7,) each.

    With W = [0; omega] the quaternion's rate is W o quaternion / 2.
    """
    quaternion = pose[:4] if pose[:4] @ near[:4] >= 0.0 else -pose[:4]
    spin, spinning_up = (np.concatenate([[0.0], x[:3]]) for x in (twist, acceleration))
    turning = 0.5 * quaternion_product(spin, quaternion)
    turning_up = 0.5 * (quaternion_product(spinning_up, quaternion) + quaternion_product(spin, turning))
    return (
        np.concatenate([quaternion, pose[4:]]),
        np.concatenate([turning, twist[3:]]),
        np.concatenate([turning_up, acceleration[3:]]),
    )


def _pose_and_twist(x: Array, rate: Array) -> tuple[Array, Array]:
    """Return the pose wxyz_xyz and the twist of a free body from a quaternion that need not be normalised."""
    quaternion, length = x[:4], np.sqrt(x[:4] @ x[:4])
    inverse = np.array([1.0, -1.0, -1.0, -1.0]) * quaternion / length**2
    omega = 2.0 * quaternion_product(rate[:4], inverse)[1:]  # the scalar part only changes the length
    return np.concatenate([quaternion / length, x[4:]]), np.concatenate([omega, rate[4:]])


def quintic(
    x0: Array, v0: Array, a0: Array, x1: Array, v1: Array, a1: Array, step: float, s: float | Array
) -> tuple[Array, Array]:
    """Return value and rate at fractions s of the step, (1) or (k, 1), 0 at its start and 1 at its end."""
    gap = x1 - x0 - step * v0 - 0.5 * step**2 * a0  # remainder for the powers 3, 4 and 5 of s
    gap_rate = step * (v1 - v0 - step * a0)
    gap_acceleration = step**2 * (a1 - a0)
    c3 = 10.0 * gap - 4.0 * gap_rate + 0.5 * gap_acceleration
    c4 = -15.0 * gap + 7.0 * gap_rate - gap_acceleration
    c5 = 6.0 * gap - 3.0 * gap_rate + 0.5 * gap_acceleration
    t = s * step
    x = x0 + t * v0 + 0.5 * t**2 * a0 + s**3 * (c3 + s * (c4 + s * c5))
    return x, v0 + t * a0 + s**2 * (3.0 * c3 + s * (4.0 * c4 + 5.0 * s * c5)) / step


def quadratic(first: Any, half: Any, last: Any, s: float | Array) -> Array:
    """Return the values at fractions s of the step, as of `quintic`, from those at its start, middle and end."""
    return (1.0 - s) * (1.0 - 2.0 * s) * first + 4.0 * s * (1.0 - s) * half + s * (2.0 * s - 1.0) * last
