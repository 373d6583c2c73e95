"""The largest margin that any joint torques can give the grasps, the motion being as it is.

All grasp wrenches that move the object alike are f + N z with A^T N z = 0, N z an internal wrench. The joints
bear it by tau + J^T N z, which changes no acceleration; so the best of all torques is a cone program in z.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.indeterminate import felt_wrenches
from holdfast.dynamics.inverse import inverse_dynamics
from holdfast.dynamics.result import ForwardResult, require_result_of
from holdfast.forces.cone_program import AffineMargin, Largest, largest_within
from holdfast.forces.margin_interval import affine_margins
from holdfast.forces.margins import grasp_margins
from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit, shaped_inputs

LOADING = 1e-9  # of wrenches of size 1: less is rounding


class LargestMargin(NamedTuple):
    """The largest least margin, and how it is reached.

    Attributes:
        margin: below 0 no joint torques hold every grasp in this motion; infinite where squeezing harder always
            helps; minus infinity where no torques within the effort limits give this motion [N].
        grasp_wrench: (arms, 6) wrenches that have it, of each arm on the object about the contact point, world
            axes; where it is infinite, those of the result [N m, N].
        tau: (n,) the joint torques that go with them [N m or N].
    """

    margin: float
    grasp_wrench: Array
    tau: Array


@np.errstate(all="ignore")  # what overflows is refused
def largest_margin(
    chain: ClosedChain,
    state: State,
    result: ForwardResult,
    *,
    inputs: Inputs | None = None,
    effort_limits: bool = False,
) -> LargestMargin:
    """Return the largest value that the smallest grasp margin can have with any joint torques.

    Accelerations stay as in the result; all internal wrenches vary, those that joints have to bear included.
    `margin_range(...).together` varies only those that load no joint, and is never larger. Friction in the
    joints is not among the torques. Margins are good to about 1e-9 of the forces and limits.
    A cone program in the internal wrenches: O(l^3) an iteration.

    Args:
        chain: the chain.
        state: a closed state.
        result: forward dynamics at that state, of whatever torques give the motion in question.
        inputs: the external wrenches and base motion of the result.
        effort_limits: whether the torques must stay within the joints' effort limits.

    Raises:
        StateError: a result of another chain, or one without forces.
    """
    require_fit(chain, state)
    require_result_of(chain, result)
    now = grasp_margins(chain, state, result.grasp_wrench)
    given = shaped_inputs(chain, inputs)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), given)
    tau = inverse_dynamics(chain, state, result.qdd, result.grasp_wrench, given, result.base_acceleration)
    N = undriven(motion, internal_wrenches(motion))
    every = [margin for of_one in affine_margins(motion, result.grasp_wrench, N) for margin in of_one]
    by_joints = joint_loads(motion, N)
    bounds = _effort_bounds(chain, tau, by_joints) if effort_limits else []
    if every:
        best = largest_within(every, bounds)
    else:  # nothing can give way
        feasible = not bounds or largest_within(bounds, []).value > 0.0
        best = Largest(float(now.min(initial=math.inf)) if feasible else -math.inf, np.zeros(N.shape[1]))
    f = result.grasp_wrench.copy()
    f[[chain.names.index(name) for name in chain.grasps]] += (N @ best.z).reshape(-1, 6)
    return LargestMargin(best.value, f, tau + by_joints @ best.z)


def internal_wrenches(motion: ChainMotion) -> Array:
    """Return a basis of the transmissible wrenches without effect on the object, (6l, k), stacked by grasps."""
    if not motion.contacts:
        return np.zeros((0, 0))
    felt = felt_wrenches(motion, length_scale([c.offset for c in motion.contacts]), by_joints=False)
    return felt.columns[:, felt.rank :]


def undriven(motion: ChainMotion, wrenches: Array) -> Array:
    """Return a basis of those stacked wrenches (6l, k) that do not load a floating base, which nothing drives."""
    if motion.trunk is None or not motion.trunk.floats or not wrenches.shape[1]:
        return wrenches
    loads = np.zeros((6, wrenches.shape[1]))
    for i, (name, arm) in enumerate(zip(motion.chain.grasps, motion.holding, strict=True)):
        loads += motion.trunk.jacobian(name, arm.base_to_tip)[1].T @ wrenches[6 * i : 6 * i + 6]
    _, sizes, Vt = np.linalg.svd(loads)
    return wrenches @ Vt[int((sizes > LOADING).sum()) :].T


def joint_loads(motion: ChainMotion, wrenches: Array) -> Array:
    """Return J^T f of stacked grasp wrenches, (n, k) for (6l, k)."""
    chain = motion.chain
    loads = np.zeros((chain.joint_count, wrenches.shape[1]))
    for i, (name, arm) in enumerate(zip(chain.grasps, motion.holding, strict=True)):
        f = wrenches[6 * i : 6 * i + 6]
        loads[chain.joints[name]] = jacobian(arm.arm, arm.at).T @ f
        if motion.trunk is not None:
            loads[chain.joints[TRUNK]] += motion.trunk.jacobian(name, arm.base_to_tip)[0].T @ f
    return loads


def _effort_bounds(chain: ClosedChain, tau: Array, loads: Array) -> list[AffineMargin]:
    """Return effort limit - |tau + loads z| of every limited joint."""
    joints = chain.all_joints
    return [
        AffineMargin(joint.effort_limit, np.zeros(loads.shape[1]), tau[j : j + 1], loads[j : j + 1])
        for j, joint in enumerate(joints)
        if math.isfinite(joint.effort_limit)
    ]
