"""Conversion between our order and that of other libraries, for spatial vectors, joints and quaternions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import serial_chain
from holdfast.model.trunk import TRUNK
from holdfast.spatial.scalar import Array

FREE_FLYERS = (TRUNK, "root_joint")


def linear_first(spatial: Any, axis: int = -1) -> Array:
    """Return twists [v; omega] or wrenches [force; moment] from our [omega; v] or [moment; force].

    Pinocchio, ROS and MuJoCo's free joints put the linear half first. The reference point and the axes are not changed.

    Args:
        spatial: an array of size six along the axis.
        axis: axis of the spatial vectors; 0 for the rows of a Jacobian or of an inertia.

    Raises:
        ModelError: the size along the axis is not six.
    """
    array = np.asarray(spatial)
    if not array.ndim or array.shape[axis] != 6:
        raise ModelError(f"linear_first: expected 6 along axis {axis}, got shape {array.shape}")
    return np.roll(array, 3, axis)


def angular_first(spatial: Any, axis: int = -1) -> Array:
    """Return our twists [omega; v] or wrenches [moment; force] from vectors with the linear half first.

    Args:
        spatial: an array of size six along the axis.
        axis: axis of the spatial vectors; 0 for the rows of a Jacobian or of an inertia.

    Raises:
        ModelError: the size along the axis is not six.
    """
    return linear_first(spatial, axis)  # the swap is its own inverse


def xyzw(wxyz: Any) -> Array:
    """Return quaternions (..., 4) with the scalar part last, as in Pinocchio and ROS."""
    return np.roll(np.asarray(wxyz), -1, -1)


def wxyz(xyzw: Any) -> Array:
    """Return quaternions (..., 4) with the scalar part first, as in holdfast and MuJoCo."""
    return np.roll(np.asarray(xyzw), 1, -1)


def free_flyer(pose: Any, twist: Any) -> tuple[Array, Array]:
    """Return q (7,) and v (6,) of Pinocchio's free-flyer joint for the pose and twist of a body.

    q is [p, quaternion with the scalar part last]; v is [v; omega] of the body's origin in the body's own axes.

    Args:
        pose: pose of the body, a Pose or wxyz_xyz.
        twist: (6,) [omega; v] of its origin, world axes.

    Raises:
        ModelError: `pose` is not a pose, or the twist has another shape.
    """
    at = checks.pose(pose, "free_flyer: pose")
    omega, v = np.split(checks.numbers(twist, (6,), "free_flyer: twist") @ np.kron(np.eye(2), at.R), 2)
    return np.concatenate([at.p, xyzw(at.wxyz_xyz[:4])]), np.concatenate([v, omega])


class PinocchioOrder(NamedTuple):
    """Indices of our joints in the vectors of a Pinocchio model.

    `v[order.v] = qd` writes our rates to its v, `tau[order.v]` are our torques in its tau,
    `M[np.ix_(order.v, order.v)]` is our block of its mass matrix, and `q[order.q]` is our q.

    Attributes:
        v: (n,) indices into v, tau and other vectors of that size.
        q: (n,) indices into q.
        base_v: (6,) indices into v of the free flyer of a floating base, see `free_flyer`; (0,) without one.
        base_q: (7,) its indices into q; (0,) without one.
    """

    v: Array
    q: Array
    base_v: Array
    base_q: Array


def pinocchio_order(chain: ClosedChain, model: Any) -> PinocchioOrder:
    """Return the indices of the chain's joints in the vectors of a Pinocchio model.

    Args:
        chain: the chain.
        model: a `pinocchio.Model` with our joints, which must be called "arm/joint", or as in the arm if this name is
            unique. It may have free flyers and other joints too. The joints of a trunk are called "trunk/joint", and
            the free flyer of its floating base "trunk" or "root_joint".

    Raises:
        ModelError: a joint, or the free flyer of a floating base, does not exist in the model; or a joint does not have
            one position and one velocity, such as a continuous joint (for which q has a cosine and a sine).
    """
    serial_chain(chain, "pinocchio_order: chain")
    known = list(model.names)
    v_places, q_places = [], []
    for full in chain.joint_names():
        short = full.split("/", 1)[1]
        found = [name for name in (full, short) if known.count(name) == 1]
        if not found:
            raise ModelError(f"pinocchio model: no joint '{full}'.{checks.did_you_mean(full, known)}")
        k = known.index(found[0])
        if model.nvs[k] != 1 or model.nqs[k] != 1:
            raise ModelError(
                f"pinocchio model: joint '{found[0]}': expected one position and one velocity, got {model.nqs[k]} and"
                f" {model.nvs[k]}; try a revolute joint with limits in place of a continuous one"
            )
        v_places.append(int(model.idx_vs[k]))
        q_places.append(int(model.idx_qs[k]))
    if len(set(v_places)) < len(v_places):
        raise ModelError("pinocchio model: two of our joints are one of its; try calling its joints 'arm/joint'")
    return PinocchioOrder(np.array(v_places), np.array(q_places), *_base_places(chain, model))


def _base_places(chain: ClosedChain, model: Any) -> tuple[Array, Array]:
    """Return the indices of a floating base's free flyer in v and q."""
    if not chain.floats:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    for k, name in enumerate(model.names):
        if name in FREE_FLYERS and (model.nvs[k], model.nqs[k]) == (6, 7):
            return model.idx_vs[k] + np.arange(6), model.idx_qs[k] + np.arange(7)
    raise ModelError(f"pinocchio model: expected a free flyer called {' or '.join(map(repr, FREE_FLYERS))}, got none")
