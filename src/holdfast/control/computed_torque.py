"""Torques for a given acceleration of the object and given grasp wrenches."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, pseudo_gravity
from holdfast.dynamics.inverse import TrunkTorques, torques, trunk_torques
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.linalg import least_solution
from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import Inputs, State


def computed_torque(
    chain: ClosedChain, state: State, acceleration: Array, wrenches: Array, joint_damping: float = 0.0
) -> Array:
    """Return the torques for the smallest qdd that agrees with the object's acceleration, (n,); see `drive_torques`.

    Arms that cannot follow exactly do so in the least-squares sense. Bases are assumed to stand still. The joints of a
    trunk are damped, while the arms on it follow the object. A floating base, which has no drive, accelerates as the
    wrenches on it require.

    Args:
        chain: the chain.
        state: positions and velocities.
        acceleration: (6,) [omega_dot; v_dot] of C, the true acceleration, world axes.
        wrenches: (arms, 6) f of each arm on the object about its contact, world axes.
        joint_damping: damping of joint motions that do not move the grasps [1/s].
    """
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), Inputs().shaped(chain))
    return following_torques(motion, acceleration, wrenches, -joint_damping * state.qd)


def following_torques(motion: ChainMotion, acceleration: Array, wrenches: Array, wished: Array) -> Array:
    """Return the torques for the qdd nearest to wished ones that agrees with the object's acceleration, (n,).

    Args:
        motion: the chain's motion, without torques.
        acceleration: (6,) true acceleration of C, world axes.
        wrenches: (arms, 6) f of each arm on the object about its contact, world axes.
        wished: (n,) wished joint accelerations.
    """
    alpha = acceleration - pseudo_gravity(motion.chain)

    def with_base(base: Array | None) -> TrunkTorques:
        return trunk_torques(motion, joint_accelerations(motion, alpha, wished, base), wrenches, base)

    if not motion.chain.floats:
        return torques(motion, joint_accelerations(motion, alpha, wished), wrenches)
    still = with_base(np.zeros(6))
    by_base = array([with_base(unit).base - still.base for unit in np.eye(6)]).T  # the wrench is linear
    return with_base(-least_solution(by_base, still.base)).tau


def joint_accelerations(motion: ChainMotion, acceleration: Array, wished: Array, base: Array | None = None) -> Array:
    """Return the joint accelerations nearest to wished ones that agree with the object's, (n,).

    K (J qdd + Jdot qd) = K (A alpha(C) + a(C) - g) is solved arm by arm, in the least-squares sense if an arm cannot
    follow. Joints of a trunk, and of arms without a grasp, accelerate as wished. Arms with bushings follow in all
    directions, K = 1.

    Args:
        motion: the chain's motion.
        acceleration: (6,) alpha(C) minus [0; g], world axes.
        wished: (n,) wished joint accelerations, of which the part counts that does not move the grasps.
        base: (6,) true acceleration of a floating base; None for zero.
    """
    chain, contacts = motion.chain, dict(zip(motion.chain.grasps, motion.contacts, strict=True))
    trunk = motion.trunk
    of_base = (np.zeros(6) if base is None else base) if trunk.floats else None
    qdd, carried = [wished[trunk.joints]], trunk.carried(wished, of_base)
    for name, arm in motion.arms.items():
        own = wished[chain.joints[name]]
        if name in contacts:
            c = contacts[name]
            tip = shift_twist(c.offset, acceleration) + c.a - c.g - arm.bias.tip_acceleration
            if name in carried:
                tip = tip - shift_twist(arm.base_to_tip, carried[name])
            K = np.eye(6) if c.grasp.of_kind.compliant else c.K
            rows = K @ jacobian(arm.arm, arm.at)
            own = own + least_solution(rows, K @ tip - rows @ own)
        qdd.append(own)
    return concatenate(qdd)
