"""The grasp forces that controllers command: the smallest forces for the motion, and an internal force."""

from __future__ import annotations

import numpy as np

from holdfast.control.balanced_torques import bearing_wrenches, pushes
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


def commanded_wrenches(chain: ClosedChain, state: State, acceleration: Array, internal_force: float = 0.0) -> Array:
    """Return grasp wrenches that accelerate the object with a chosen internal force, (arms, 6).

    Every arm pushes along its contact's normal z. The smallest transmissible wrenches (in the metric of the force
    split) are added so that the sum agrees with the motion,
        A^T f = M(C) (alpha - [0; g]) + b(C) - w,  with the wrench w of springs and bushings on the object.
    Of the pushes, only the internal part therefore remains; for contacts that face each other, that is all of them.

    Args:
        chain: the chain.
        state: positions and velocities.
        acceleration: (6,) [omega_dot; v_dot] of C, the true acceleration, world axes.
        internal_force: push of every arm into the object [N].

    Returns:
        [moment; force] of each arm on the object about its contact, world axes; zero for an arm without a grasp, and
        for a bushing, whose wrench follows from the state.
    """
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), Inputs().shaped(chain))
    return bearing_wrenches(motion, acceleration, pushes(motion, internal_force))[0]
