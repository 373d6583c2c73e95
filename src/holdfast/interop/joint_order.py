"""Between our orders and those of other libraries: halves of spatial vectors, joints of flat arrays, quaternions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain, require_own_bases
from holdfast.spatial.scalar import Array


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


class PinocchioOrder(NamedTuple):
    """Where our joints lie in a Pinocchio model's vectors.

    `v[order.v] = qd` puts our rates into its v, `tau[order.v]` takes our torques out of its tau,
    `M[np.ix_(order.v, order.v)]` our block out of its mass matrix; `q[order.q]` is our q.

    Attributes:
        v: (n,) whole numbers, places in v, tau and the like.
        q: (n,) whole numbers, places in q.
    """

    v: Array
    q: Array


def pinocchio_order(chain: ClosedChain, model: Any) -> PinocchioOrder:
    """Return where the chain's joints lie in a Pinocchio model's vectors.

    Args:
        chain: the chain.
        model: a `pinocchio.Model` with our joints, called "arm/joint", or as in the arm where
            no other joint has that name; free flyers and other joints may be there besides.

    Raises:
        ModelError: a joint that is not there, that has not one velocity, or that turns
            without limits (Pinocchio gives it a cosine and a sine for q).
    """
    require_own_bases(chain, "pinocchio_order")
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
    return PinocchioOrder(np.array(v_places), np.array(q_places))
