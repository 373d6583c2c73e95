"""The range of the grasp margins for given torques, and the largest margin over all torques with the same motion.

Grasp wrenches with the same effect on the object are f + N z, with internal wrenches N z, A^T N z = 0. Those that load
no joint are not determined by the torques, but by how the parts were assembled. A margin is concave in z, so a margin
that depends on such a z has no lower bound (`margin_range`). All others are balanced by torques tau + J^T N z, which
change no acceleration: the best torques follow from a cone program in z (`largest_margin`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest, chain_motion
from holdfast.dynamics.constraint import free_wrenches, length_scale, wrench_directions
from holdfast.dynamics.inverse import inverse_dynamics
from holdfast.dynamics.result import ForwardResult, Status, require_result_of
from holdfast.forces.cone_program import AffineMargin, Largest, largest_least, largest_within, sensitive_directions
from holdfast.forces.margins import conditions, grasp_margins
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import unrotate
from holdfast.state import Inputs, State, require_fit, shaped_inputs

LOADING = 1e-9  # loads below this, for wrenches of size 1, are rounding


class MarginRange(NamedTuple):
    """The range of margins over the internal forces that load no joint, in the order of `chain.grasps` [N].

    Attributes:
        worst: (grasps,) the smallest margin of each grasp; minus infinity if internal forces change it.
        best: (grasps,) the largest margin of each grasp alone; infinite if squeezing harder always increases it.
        together: the largest possible value of the least margin. If it is negative, no internal force holds all grasps
            with the given torques; other torques may, see `largest_margin`.
    """

    worst: Array
    best: Array
    together: float


def margin_range(chain: ClosedChain, state: State, result: ForwardResult) -> MarginRange:
    """Return the worst and best grasp margins over all grasp forces that are possible with the result's torques.

    Only forces without effect on joints and object vary. If the forces are unique, both results are `grasp_margins`.
    `largest_margin` gives the largest margin over other torques for the same motion. The best values are accurate to
    about 1e-9 of the forces and limits. The cost is one cone program per grasp, O(l^3) per iteration.

    Args:
        chain: the chain.
        state: a closed state.
        result: forward dynamics at that state.

    Raises:
        StateError: the result belongs to another chain, or contains no forces.
    """
    require_fit(chain, state)
    require_result_of(chain, result)
    now = grasp_margins(chain, state, result.grasp_wrench)
    if result.status is not Status.INDETERMINATE_FORCES:
        return MarginRange(now, now, float(now.min(initial=math.inf)))
    motion = chain_at_rest(chain, state)
    N = free_wrenches(motion, length_scale([c.offset for c in motion.contacts]), int(result.rank))
    affine = affine_margins(motion, result.grasp_wrench, N)
    touched = np.array([bool(of_one) and sensitive_directions(of_one).shape[1] > 0 for of_one in affine])
    best = [largest_least(of_one) if free else value for of_one, free, value in zip(affine, touched, now, strict=True)]
    every = [margin for of_one in affine for margin in of_one]
    return MarginRange(
        np.where(touched, -math.inf, now), np.array(best), largest_least(every) if touched.any() else float(now.min())
    )


def affine_margins(motion: ChainMotion, grasp_wrench: Array, N: Array) -> list[list[AffineMargin]]:
    """Return for each grasp its conditions as functions of z, without those that always hold.

    Args:
        motion: the chain's motion.
        grasp_wrench: (arms, 6) wrenches at z = 0, about the contacts, world axes.
        N: (6l, k) stacked wrenches of the grasps, one column per entry of z.
    """
    chain, count = motion.chain, len(motion.contacts)
    found = []
    for name, c, free in zip(chain.grasps, motion.contacts, N.reshape(count, 6, N.shape[1]), strict=True):
        f = unrotate(c.R, grasp_wrench[chain.names.index(name)])
        along = np.array([unrotate(c.R, column) for column in free.T]).reshape(-1, 6).T  # contact axes
        found.append(
            [
                AffineMargin(k.constant + k.pressing @ f, k.pressing @ along, k.loading @ f, k.loading @ along)
                for k in conditions(c.grasp)
                if math.isfinite(k.constant)
            ]
        )
    return found


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
    if not motion.trunk.floats or not wrenches.shape[1]:
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
        loads[motion.trunk.joints] += motion.trunk.jacobian(name, arm.base_to_tip)[0].T @ f
    return loads


def _effort_bounds(chain: ClosedChain, tau: Array, loads: Array) -> list[AffineMargin]:
    """Return effort limit - |tau + loads z| for every joint with a limit."""
    joints = chain.all_joints
    return [
        AffineMargin(joint.effort_limit, np.zeros(loads.shape[1]), tau[j : j + 1], loads[j : j + 1])
        for j, joint in enumerate(joints)
        if math.isfinite(joint.effort_limit)
    ]
