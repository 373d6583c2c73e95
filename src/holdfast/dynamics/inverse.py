"""Inverse dynamics of a closed chain: the torques for given accelerations and grasp forces."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.newton_euler import drive_torques
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.trunk.trunk_inverse import require_undriven, trunk_torques
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, concatenate, each
from holdfast.state import Inputs, State, require_fit, shaped_inputs

SAME = 1e-9  # largest relative difference between a given wrench and the one that a bushing exerts


@np.errstate(all="ignore")  # what overflows is refused below
def inverse_dynamics(
    chain: ClosedChain,
    state: State,
    qdd: ArrayLike,
    grasp_wrench: ArrayLike,
    inputs: Inputs | None = None,
    base_acceleration: ArrayLike | None = None,
) -> Array:
    """Return tau = M qdd + C + J^T f + damping qd + stiffness (q - rest), arm by arm (2.1a). O(n).

    The caller must provide accelerations that satisfy the grasps, and wrenches that move the object accordingly;
    `forward_dynamics` with the returned torques then reproduces them.

    Args:
        chain: the chain.
        state: positions and velocities.
        qdd: (n,) joint accelerations.
        grasp_wrench: (arms, 6) wrench of each arm on the object, about the contact, world axes. Rows of arms without a
            grasp must be zero; rows of bushings must be the wrenches that these exert, or zero, which stands for them.
        inputs: external wrenches and base motion.
        base_acceleration: (6,) true acceleration of a trunk's floating base, world axes; required if there is one.

    Returns:
        (n,) joint torques [N m or N].

    Raises:
        StateError: a shape is wrong, a wrench is given for an arm without a grasp, a wrench differs from that of a
            bushing, or a floating base would need a drive.
    """
    require_fit(chain, state)
    qdd = checks.numbers(qdd, (chain.joint_count,), "qdd", StateError)
    f = checks.numbers(grasp_wrench, (len(chain.arms), 6), "grasp_wrench", StateError)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), shaped_inputs(chain, inputs))
    for i, name in enumerate(chain.names):
        if name not in chain.grasps and f[i].any():
            raise StateError(f"grasp_wrench: arm '{name}' holds nothing, expected zeros, got {f[i]}")
    f = _without_known(motion, f)
    of_base = acceleration_of_base(chain, base_acceleration)
    if of_base is not None:
        found = trunk_torques(motion, qdd, f, of_base)
        require_undriven(found)
        return checks.finite(found.tau, "inverse dynamics")
    return checks.finite(torques(motion, qdd, f), "inverse dynamics")


def acceleration_of_base(chain: ClosedChain, given: ArrayLike | None) -> Array | None:
    """Return the checked acceleration of a chain's floating base, (6,); None without one.

    Raises:
        StateError: the acceleration is missing, or is given although no base floats.
    """
    if chain.floats != (given is not None):
        wanted = "the acceleration of the floating base" if chain.floats else "none, as no base floats"
        raise StateError(f"base_acceleration: expected {wanted}, got {checks.short(given)}")
    return None if given is None else checks.numbers(given, (6,), "base_acceleration", StateError)


def _without_known(motion: ChainMotion, f: Array) -> Array:
    """Return the grasp wrenches without those of bushings, which are already part of the arms' bias.

    Raises:
        StateError: a wrench differs from that of a bushing.
    """
    left = np.array(f)
    for i, (name, arm) in enumerate(motion.arms.items()):
        if arm.known is None:
            continue
        off = np.abs(f[i] - arm.known).max()
        if f[i].any() and off > SAME * max(1.0, float(np.abs(arm.known).max())):
            raise StateError(
                f"grasp_wrench: arm '{name}' holds by a bushing, which exerts {checks.place(arm.known)} in this state,"
                f" got {checks.place(f[i])};"
                " try zeros, which stand for that"
            )
        left[i] = 0.0
    return left


def torques(motion: ChainMotion, qdd: Array, f: Array, base: Array | None = None) -> Array:
    """Return the torques of the drives of trunk and arms, (n,), for grasp wrenches from which bushings are excluded.

    A floating base has the acceleration `base`, (6,), or zero; the wrench that this requires is ignored. See
    `inverse_dynamics`.
    """
    if motion.trunk is not None:
        return trunk_torques(motion, qdd, f, np.zeros(6) if base is None and motion.trunk.floats else base).tau
    return concatenate(each(drive_torques, motion.arms.values(), [qdd[part] for part in motion.chain.arm_joints], f))
