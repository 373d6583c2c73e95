"""The largest margin of the grasps over all joint torques with the same motion.

All grasp wrenches with the same effect on the object are f + N z with internal wrenches N z, A^T N z = 0. The torques
tau + J^T N z balance them at the joints without changing any acceleration. The best torques are therefore given by a
cone program in z.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.indeterminate import wrench_directions
from holdfast.dynamics.inverse import inverse_dynamics
from holdfast.dynamics.result import ForwardResult, require_result_of
from holdfast.forces.cone_program import AffineMargin, Largest, largest_within
from holdfast.forces.margin_interval import affine_margins
from holdfast.forces.margins import grasp_margins
from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit, shaped_inputs

LOADING = 1e-9  # loads below this, for wrenches of size 1, are rounding


class LargestMargin(NamedTuple):
    """The largest possible value of the least margin, and the wrenches and torques that attain it.

    Attributes:
        margin: the margin. If it is negative, no joint torques hold every grasp in this motion. It is infinite if
            squeezing harder always increases it, and minus infinity if no torques within the effort limits give this
            motion [N].
        grasp_wrench: (arms, 6) wrenches with this margin, of each arm on the object about the contact point, world
            axes; those of the result if the margin is infinite [N m, N].
        tau: (n,) the corresponding joint torques [N m or N].
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
    """Return the largest value that the least grasp margin can have with any joint torques.

    The accelerations are those of the result; all internal wrenches vary, including those that load joints. In
    `margin_range(...).together` only those that load no joint vary, so its value is never larger. The torques do not
    include joint friction. Margins are accurate to about 1e-9 of the forces and limits. The cost is one cone program in
    the internal wrenches, O(l^3) per iteration.

    Args:
        chain: the chain.
        state: a closed state.
        result: forward dynamics at that state, for any torques that give the motion.
        inputs: the external wrenches and base motion of the result.
        effort_limits: whether the torques must stay within the joints' effort limits.

    Raises:
        StateError: the result belongs to another chain, or contains no forces.
    """
    require_fit(chain, state)
    require_result_of(chain, result)
    now = grasp_margins(chain, state, result.grasp_wrench)
    given = shaped_inputs(chain, inputs)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), given)
    tau = inverse_dynamics(chain, state, result.qdd, result.grasp_wrench, given, result.base_acceleration)
    N = without_base_load(motion, internal_wrenches(motion))
    every = [margin for of_one in affine_margins(motion, result.grasp_wrench, N) for margin in of_one]
    by_joints = joint_loads(motion, N)
    bounds = _effort_bounds(chain, tau, by_joints) if effort_limits else []
    if every:
        best = largest_within(every, bounds)
    else:  # no grasp has a limit
        feasible = not bounds or largest_within(bounds, []).value > 0.0
        best = Largest(float(now.min(initial=math.inf)) if feasible else -math.inf, np.zeros(N.shape[1]))
    f = result.grasp_wrench.copy()
    f[[chain.names.index(name) for name in chain.grasps]] += (N @ best.z).reshape(-1, 6)
    return LargestMargin(best.value, f, tau + by_joints @ best.z)


def internal_wrenches(motion: ChainMotion) -> Array:
    """Return a basis of the transmissible wrenches without effect on the object, (6l, k), stacked by grasps."""
    if not motion.contacts:
        return np.zeros((0, 0))
    directions = wrench_directions(motion, length_scale([c.offset for c in motion.contacts]), by_joints=False)
    return directions.columns[:, directions.rank :]


def without_base_load(motion: ChainMotion, wrenches: Array) -> Array:
    """Return a basis of the stacked wrenches (6l, k) that do not load a floating base, which has no drive."""
    if motion.trunk is None or not motion.trunk.floats or not wrenches.shape[1]:
        return wrenches
    loads = np.zeros((6, wrenches.shape[1]))
    for i, (name, arm) in enumerate(zip(motion.chain.grasps, motion.holding, strict=True)):
        loads += motion.trunk.jacobian(name, arm.base_to_tip)[1].T @ wrenches[6 * i : 6 * i + 6]
    _, sizes, Vt = np.linalg.svd(loads)
    return wrenches @ Vt[int((sizes > LOADING).sum()) :].T


def joint_loads(motion: ChainMotion, wrenches: Array) -> Array:
    """Return J^T f for stacked grasp wrenches, (n, k) for (6l, k)."""
    chain = motion.chain
    loads = np.zeros((chain.joint_count, wrenches.shape[1]))
    for i, (name, arm) in enumerate(zip(chain.grasps, motion.holding, strict=True)):
        f = wrenches[6 * i : 6 * i + 6]
        loads[chain.joints[name]] = jacobian(arm.arm, arm.at).T @ f
        if motion.trunk is not None:
            loads[chain.joints[TRUNK]] += motion.trunk.jacobian(name, arm.base_to_tip)[0].T @ f
    return loads


def _effort_bounds(chain: ClosedChain, tau: Array, loads: Array) -> list[AffineMargin]:
    """Return effort limit - |tau + loads z| for every joint with a limit."""
    joints = chain.all_joints
    return [
        AffineMargin(joint.effort_limit, np.zeros(loads.shape[1]), tau[j : j + 1], loads[j : j + 1])
        for j, joint in enumerate(joints)
        if math.isfinite(joint.effort_limit)
    ]
