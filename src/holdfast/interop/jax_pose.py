"""Poses in JAX programs: from seven numbers (w, x, y, z, x, y, z) to rotations, with gradients and tangents."""

from __future__ import annotations

from typing import Any

from holdfast.interop.jax_arguments import jax_numpy
from holdfast.spatial.real_numbers import ROTATION_TOLERANCE


def rotation_and_origin(pose: Any) -> tuple[Any, Any]:
    """Return rotation matrices (.., 3, 3) and origins (.., 3); NaN for quaternions that do not have unit length.

    Args:
        pose: (.., 7) wxyz_xyz.
    """
    jnp = jax_numpy()
    length = jnp.linalg.norm(pose[..., :4], axis=-1, keepdims=True)
    sound = jnp.abs(length - 1.0) <= ROTATION_TOLERANCE
    w, v = jnp.split(jnp.where(sound, pose[..., :4] / length, jnp.nan), [1], axis=-1)
    # R x = x + 2 w v x x + 2 v x (v x x), column by column
    columns = [x + 2.0 * w * _cross(v, x) + 2.0 * _cross(v, _cross(v, x)) for x in jnp.eye(3)]
    return jnp.stack(columns, axis=-1), pose[..., 4:]


def pose_gradient(pose: Any, turn_and_shift: Any) -> Any:
    """Return the gradient by a pose's seven numbers, with 2 (0, turn_bar) q / |q|^2 for the quaternion q.

    Args:
        pose: (.., 7) wxyz_xyz.
        turn_and_shift: (.., 6) the gradient as [turn; shift].
    """
    jnp = jax_numpy()
    q, turn = pose[..., :4], turn_and_shift[..., :3]
    w, v = q[..., :1], q[..., 1:]
    product = jnp.concatenate([-jnp.sum(turn * v, -1, keepdims=True), w * turn + _cross(turn, v)], -1)
    return jnp.concatenate([2.0 * product / jnp.sum(q * q, -1, keepdims=True), turn_and_shift[..., 3:]], -1)


def pose_tangent(pose: Any, rate: Any) -> Any:
    """Return (.., 6) [turn; shift] for given rates of a pose's seven numbers: turn = 2 vec(dq q*) / |q|^2.

    Args:
        pose: (.., 7) wxyz_xyz.
        rate: (.., 7) rates of these numbers.
    """
    jnp = jax_numpy()
    q, dq = pose[..., :4], rate[..., :4]
    w, v, dw, dv = q[..., :1], q[..., 1:], dq[..., :1], dq[..., 1:]
    turn = w * dv - dw * v - _cross(dv, v)
    return jnp.concatenate([2.0 * turn / jnp.sum(q * q, -1, keepdims=True), rate[..., 4:]], -1)


def pose_cotangent(pose: Any, cotangent: Any) -> Any:
    """Return the gradient by [turn; shift], (.., 6), of one by the seven numbers of a pose: dq = (0, turn) q / 2.

    Args:
        pose: (.., 7) wxyz_xyz.
        cotangent: (.., 7) the gradient by them; none along q counts.
    """
    jnp = jax_numpy()
    moved = pose_tangent(pose, cotangent)
    return jnp.concatenate([moved[..., :3] * jnp.sum(pose[..., :4] ** 2, -1, keepdims=True) / 4.0, moved[..., 3:]], -1)


def _cross(a: Any, b: Any) -> Any:
    """Return a x b (.., 3)."""
    jnp = jax_numpy()
    return jnp.cross(*jnp.broadcast_arrays(a, b))
