"""A solved system a moment later, on dual numbers: exact rates of energy and momentum."""

from __future__ import annotations

import numpy as np

from holdfast import ClosedChain, Inputs, Pose, State
from holdfast.dynamics import ForwardResult
from holdfast.spatial.vector import skew
from tests.spatial.dual import duals
from tests.systems.as_chain import Problem


def moving(p: Problem, result: ForwardResult) -> tuple[ClosedChain, State, Inputs]:
    """Return chain, state and inputs as x + x' e: rates from the state, accelerations from the result."""
    state, given = p.state, p.inputs.shaped(p.chain)
    bases = {
        name: Pose(duals(arm.base.R, skew(V[:3]) @ arm.base.R), duals(arm.base.p, V[3:]))
        for (name, arm), V in zip(p.chain.arms.items(), given.base_twists, strict=True)
    }
    (w, x, y, z), (a, b, c) = state.object_pose[:4], state.object_twist[:3]
    turning = 0.5 * np.array(
        [-a * x - b * y - c * z, a * w + b * z - c * y, b * w + c * x - a * z, c * w + a * y - b * x]
    )
    later = State(
        duals(state.q, state.qd),
        duals(state.qd, result.qdd),
        duals(state.object_pose, np.r_[turning, state.object_twist[3:]]),
        duals(state.object_twist, result.object_acceleration),
    )
    inputs = Inputs(
        given.object_wrench,
        given.link_wrenches,
        duals(given.base_twists, given.base_accelerations),
        given.base_accelerations,
    )
    return p.chain.with_bases(bases), later, inputs
