"""Inverse dynamics of a closed chain: the torques of known accelerations and grasp forces."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.newton_euler import drive_torques
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, concatenate, each
from holdfast.state import Inputs, State


def inverse_dynamics(
    chain: ClosedChain, state: State, qdd: ArrayLike, grasp_wrench: ArrayLike, inputs: Inputs | None = None
) -> Array:
    """Return tau = M qdd + C + J^T f + damping qd, arm by arm (2.1a). O(n).

    Accelerations that keep the grasps and wrenches that move the object accordingly are
    the caller's part (`forward_dynamics` of the result returns them if they do).

    Args:
        chain: the chain.
        state: positions and velocities.
        qdd: (n,) joint accelerations.
        grasp_wrench: (arms, 6) of each arm on the object, about the contact, world axes;
            rows of arms without a grasp must be zero.
        inputs: external wrenches and base motion.

    Returns:
        (n,) joint torques [N m or N].

    Raises:
        StateError: wrong shapes, or a wrench on an arm that holds nothing.
    """
    state.fits(chain)
    qdd = checks.numbers(qdd, (chain.joint_count,), "qdd", StateError)
    f = checks.numbers(grasp_wrench, (len(chain.arms), 6), "grasp_wrench", StateError)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), (inputs or Inputs()).shaped(chain))
    for i, name in enumerate(chain.names):
        if name not in chain.grasps and f[i].any():
            raise StateError(f"grasp_wrench: arm '{name}' holds nothing, expected zeros, got {f[i]}")
    return torques(motion, state.qd, qdd, f)


def torques(motion: ChainMotion, qd: Array, qdd: Array, f: Array) -> Array:
    """Return the drives' torques of all arms, (n,); see `inverse_dynamics`."""
    parts = list(motion.chain.joints.values())
    return concatenate(
        each(drive_torques, motion.arms.values(), [qd[part] for part in parts], [qdd[part] for part in parts], f)
    )
