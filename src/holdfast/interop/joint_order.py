"""Between our orders and those of other libraries: halves of spatial vectors, joints of flat arrays, quaternions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.spatial.scalar import Array

FREE_FLYERS = (TRUNK, "root_joint")


def linear_first(spatial: Any, axis: int = -1) -> Array:
    """Return twists [v; omega] or wrenches [force; moment] of ours, [omega; v] or [moment; force].

    Pinocchio, ROS and MuJoCo's free joints put the linear half first. The point and the
    axes of the vector stay as they are.

    Args:
        spatial: an array with six along the axis.
        axis: where; the rows of a Jacobian or of an inertia: 0.

    Raises:
        ModelError: not six along the axis.
    """
    array = np.asarray(spatial)
    if not array.ndim or array.shape[axis] != 6:
        raise ModelError(f"linear_first: expected 6 along axis {axis}, got shape {array.shape}")
    return np.roll(array, 3, axis)


def angular_first(spatial: Any, axis: int = -1) -> Array:
    """Return our twists [omega; v] or wrenches [moment; force] of those with the linear half first.

    Args:
        spatial: an array with six along the axis.
        axis: where; the rows of a Jacobian or of an inertia: 0.

    Raises:
        ModelError: not six along the axis.
    """
    return linear_first(spatial, axis)  # halves swapped twice are back


def xyzw(wxyz: Any) -> Array:
    """Return quaternions (..., 4) with the scalar last, as Pinocchio and ROS have it."""
    return np.roll(np.asarray(wxyz), -1, -1)


def wxyz(xyzw: Any) -> Array:
    """Return quaternions (..., 4) with the scalar first, as we and MuJoCo have it."""
    return np.roll(np.asarray(xyzw), 1, -1)


def free_flyer(pose: Any, twist: Any) -> tuple[Array, Array]:
    """Return what Pinocchio has for the free flyer of a body: q (7,), v (6,).

    Its q is [p, quaternion with the scalar last]; its v is [v; omega] of the body's origin in the body's own axes.

    Args:
        pose: of the body, a Pose or wxyz_xyz.
        twist: (6,) [omega; v] of its origin, world axes.

    Raises:
        ModelError: a pose that is none, or a twist of another shape.
    """
    at = checks.pose(pose, "free_flyer: pose")
    omega, v = np.split(checks.numbers(twist, (6,), "free_flyer: twist") @ np.kron(np.eye(2), at.R), 2)
    return np.concatenate([at.p, xyzw(at.wxyz_xyz[:4])]), np.concatenate([v, omega])


class PinocchioOrder(NamedTuple):
    """Where our joints lie in a Pinocchio model's vectors.

    `v[order.v] = qd` puts our rates into its v, `tau[order.v]` takes our torques out of its tau,
    `M[np.ix_(order.v, order.v)]` our block out of its mass matrix; `q[order.q]` is our q.

    Attributes:
        v: (n,) whole numbers, places in v, tau and the like.
        q: (n,) whole numbers, places in q.
        base_v: (6,) places in v of the free flyer of a floating base, see `free_flyer`; (0,) without one.
        base_q: (7,) its places in q; (0,) without one.
    """

    v: Array
    q: Array
    base_v: Array
    base_q: Array


def pinocchio_order(chain: ClosedChain, model: Any) -> PinocchioOrder:
    """Return where the chain's joints lie in a Pinocchio model's vectors.

    Args:
        chain: the chain.
        model: a `pinocchio.Model` with our joints, called "arm/joint", or as in the arm where
            no other joint has that name; free flyers and other joints may be there besides. A trunk's are called
            "trunk/joint", the free flyer of its floating base "trunk" or "root_joint".

    Raises:
        ModelError: a joint, or a floating base's free flyer, that is not there; a joint that has not one velocity,
            or that turns without limits (Pinocchio gives it a cosine and a sine for q).
    """
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
    """Return where a floating base's free flyer lies in v and q."""
    if not chain.floats:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    for k, name in enumerate(model.names):
        if name in FREE_FLYERS and (model.nvs[k], model.nqs[k]) == (6, 7):
            return model.idx_vs[k] + np.arange(6), model.idx_qs[k] + np.arange(7)
    raise ModelError(f"pinocchio model: expected a free flyer called {' or '.join(map(repr, FREE_FLYERS))}, got none")
