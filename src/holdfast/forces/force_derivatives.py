"""Derivatives of the margins of grasps and joints, and of wrist wrenches.

The grasp wrenches are arguments. Gradients with respect to torques or the payload, for example, follow in one more
step: pass the gradient by `grasp_wrench` to `forward_dynamics_vjp` as the cotangent of that name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.derivatives import Derivatives
from holdfast.dynamics.function_derivatives import case_of, function_jacobian, function_jvp, function_vjp
from holdfast.dynamics.linearised_function import Differentiable, Part, by_joints
from holdfast.dynamics.result import ForwardResult
from holdfast.dynamics.varied_case import VariedCase
from holdfast.errors import StateError
from holdfast.forces.margins import (
    JointLimits,
    JointMargins,
    contacts_of,
    grasp_margins,
    joint_limits,
    joint_margins,
    limited_margins,
    margins_of_joints,
)
from holdfast.forces.wrist import across_tips, wrist_wrenches
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, where
from holdfast.state import State

OF_MARGINS = ("object_pose", "grasp_wrench")
OF_WRISTS = ("q", "grasp_wrench")
OF_JOINTS = ("q", "qd", "tau")
LIMITS = "joint_limits"  # (4, n) `JointLimits`
CONTACTS = "contact"  # (grasps, 6) `contacts_of`


def grasp_margins_vjp(
    chain: ClosedChain,
    state: State,
    grasp_wrench: ArrayLike,
    *,
    by: Sequence[str] = OF_MARGINS,
    grasp_margins: ArrayLike,
) -> Derivatives:
    """Return the gradients of cotangent . margins of the grasps with respect to some arguments. O(l).

    theta_bar = (d margin / d theta)^T margin_bar. For each grasp, the derivative is that of the condition with the
    least margin, or of one of them if several are equal. The derivative of a norm |B f| is 0 where the norm is 0.
    Margins without a limit are infinite, and their derivatives are 0. Names and the derivatives by poses are as in
    `forward_dynamics_vjp`.

    Args:
        chain: the chain.
        state: state with the object's attitude; nothing else is used.
        grasp_wrench: (arms, 6) wrench of each arm on the object about the contact point, world axes.
        by: the arguments: object_pose, grasp_pose, grasp_wrench.
        grasp_margins: (grasps,) the cotangent.

    Returns:
        The gradients by argument, in the shape of the argument; `result` holds the margins [N].

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_vjp(MARGINS, *_margins_case(chain, state, grasp_wrench), by, {"grasp_margins": grasp_margins})


def grasp_margins_jvp(
    chain: ClosedChain, state: State, grasp_wrench: ArrayLike, *, along: Mapping[str, ArrayLike]
) -> Derivatives:
    """Return the rates of the margins of the grasps for given rates of their arguments. O(l) per direction.

    margin_dot = (d margin / d theta) theta_dot; see `grasp_margins_vjp`, also for points without a derivative.

    Args:
        chain: the chain.
        state: state with the object's attitude; nothing else is used.
        grasp_wrench: (arms, 6) wrench of each arm on the object about the contact point, world axes.
        along: rates of the arguments by name, in the shapes of their gradients, or (d, ...) for d directions.

    Returns:
        `found.grasp_margins`, (grasps,) or (d, grasps).

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_jvp(MARGINS, *_margins_case(chain, state, grasp_wrench), along)


def grasp_margins_jacobian(
    chain: ClosedChain,
    state: State,
    grasp_wrench: ArrayLike,
    *,
    of: Sequence[str] = ("grasp_margins",),
    by: Sequence[str] = OF_MARGINS,
) -> Derivatives:
    """Return the Jacobian d margin / d theta of the grasps' margins, O(l^2); see `grasp_margins_vjp`.

    Args:
        chain: the chain.
        state: state with the object's attitude; nothing else is used.
        grasp_wrench: (arms, 6) wrench of each arm on the object about the contact point, world axes.
        of: the results; there is one, grasp_margins.
        by: the arguments.

    Returns:
        `found["grasp_margins", by]`, (grasps, *shape of the argument's gradient).

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_jacobian(MARGINS, *_margins_case(chain, state, grasp_wrench), of, by)


def joint_margins_vjp(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    by: Sequence[str] = OF_JOINTS,
    position: ArrayLike | None = None,
    rate: ArrayLike | None = None,
    effort: ArrayLike | None = None,
) -> Derivatives:
    """Return the gradients of sum(cotangent . margin) of the joints with respect to some arguments. O(n).

    theta_bar = (d margin / d theta)^T margin_bar, with the margins of `joint_margins`. For positions, the derivative is
    that for the nearer end of the range. Half way between both ends, and at qd = 0 and tau = 0, it is that of one side.
    The derivatives of infinite margins are 0.

    Args:
        chain: the chain.
        state: joint positions and rates.
        tau: (n,) drive torques [N m or N].
        by: the arguments: q, qd, tau.
        position: (n,) the cotangent of the position margins.
        rate: (n,) the cotangent of the rate margins.
        effort: (n,) the cotangent of the effort margins.

    Returns:
        The gradients by argument, in the shape of the argument; `result` holds the `JointMargins`.

    Raises:
        StateError: a name, shape or number is wrong.
    """
    given = zip(JointMargins._fields, (position, rate, effort), strict=True)
    cotangents = {name: x for name, x in given if x is not None}
    return function_vjp(OF_LIMITS, *_joints_case(chain, state, tau), by, cotangents)


def joint_margins_jvp(
    chain: ClosedChain, state: State, tau: ArrayLike, *, along: Mapping[str, ArrayLike]
) -> Derivatives:
    """Return the rates of the margins of the joints for given rates of their arguments. O(n) per direction.

    margin_dot = (d margin / d theta) theta_dot; see `joint_margins_vjp`, also for points without a derivative.

    Args:
        chain: the chain.
        state: joint positions and rates.
        tau: (n,) drive torques [N m or N].
        along: rates of the arguments by name, in the shapes of their gradients, or (d, ...) for d directions.

    Returns:
        `found.position`, `found.rate` and `found.effort`, (n,) or (d, n).

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_jvp(OF_LIMITS, *_joints_case(chain, state, tau), along)


def joint_margins_jacobian(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    of: Sequence[str] = JointMargins._fields,
    by: Sequence[str] = OF_JOINTS,
) -> Derivatives:
    """Return the Jacobian d margin / d theta of the joints' margins, O(n^2); see `joint_margins_vjp`.

    Args:
        chain: the chain.
        state: joint positions and rates.
        tau: (n,) drive torques [N m or N].
        of: the results: position, rate, effort.
        by: the arguments.

    Returns:
        `found[of, by]`, (n, n).

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_jacobian(OF_LIMITS, *_joints_case(chain, state, tau), of, by)


def wrist_wrenches_vjp(
    chain: ClosedChain,
    state: State,
    result: ForwardResult,
    *,
    by: Sequence[str] = OF_WRISTS,
    wrist_wrenches: ArrayLike,
) -> Derivatives:
    """Return the gradients of cotangent . wrist wrenches with respect to some arguments. O(n).

    theta_bar = (d w / d theta)^T w_bar, with w as in `wrist_wrenches`. Names and the derivatives by poses are as in
    `forward_dynamics_vjp`.

    Args:
        chain: the chain.
        state: a closed state.
        result: forward dynamics at that state, of which only the grasp wrenches are used.
        by: the arguments: q, base_pose, grasp_wrench; with a floating base also floating_pose.
        wrist_wrenches: (arms, 6) the cotangent.

    Returns:
        The gradients by argument, in the shape of the argument; `result` holds the wrist wrenches [N m, N].

    Raises:
        StateError: a name, shape or number is wrong, or the result belongs to another chain.
    """
    return function_vjp(WRISTS, *_wrists_case(chain, state, result), by, {"wrist_wrenches": wrist_wrenches})


def wrist_wrenches_jvp(
    chain: ClosedChain, state: State, result: ForwardResult, *, along: Mapping[str, ArrayLike]
) -> Derivatives:
    """Return the rates of the wrist wrenches for given rates of their arguments. O(n) per direction.

    w_dot = (d w / d theta) theta_dot; see `wrist_wrenches_vjp`.

    Args:
        chain: the chain.
        state: a closed state.
        result: forward dynamics at that state, of which only the grasp wrenches are used.
        along: rates of the arguments by name, in the shapes of their gradients, or (d, ...) for d directions.

    Returns:
        `found.wrist_wrenches`, (arms, 6) or (d, arms, 6).

    Raises:
        StateError: a name, shape or number is wrong, or the result belongs to another chain.
    """
    return function_jvp(WRISTS, *_wrists_case(chain, state, result), along)


def wrist_wrenches_jacobian(
    chain: ClosedChain,
    state: State,
    result: ForwardResult,
    *,
    of: Sequence[str] = ("wrist_wrenches",),
    by: Sequence[str] = OF_WRISTS,
) -> Derivatives:
    """Return the Jacobian d w / d theta of the wrist wrenches, O(n l); see `wrist_wrenches_vjp`.

    Args:
        chain: the chain.
        state: a closed state.
        result: forward dynamics at that state, of which only the grasp wrenches are used.
        of: the results; there is one, wrist_wrenches.
        by: the arguments.

    Returns:
        `found["wrist_wrenches", by]`, (arms, 6, *shape of the argument's gradient).

    Raises:
        StateError: a name, shape or number is wrong, or the result belongs to another chain.
    """
    return function_jacobian(WRISTS, *_wrists_case(chain, state, result), of, by)


def _margins_case(chain: ClosedChain, state: State, grasp_wrench: ArrayLike) -> tuple[VariedCase, Array]:
    """Return the arguments of the differentiated margins, and their values."""
    found = grasp_margins(chain, state, grasp_wrench)
    return _with_wrenches(chain, state, grasp_wrench, {CONTACTS: contacts_of(chain)}), found


def _joints_case(chain: ClosedChain, state: State, tau: ArrayLike) -> tuple[VariedCase, JointMargins]:
    """Return the arguments of the differentiated joint margins, and their values."""
    with np.errstate(all="ignore"):
        found = joint_margins(chain, state, tau)
    own = {"tau": checks.numbers(tau, (chain.joint_count,), "tau", StateError), LIMITS: np.array(joint_limits(chain))}
    return case_of(chain, state, None, own), found


def _wrists_case(chain: ClosedChain, state: State, result: ForwardResult) -> tuple[VariedCase, Array]:
    """Return the arguments of the differentiated wrist wrenches, and their values."""
    with np.errstate(all="ignore"):
        found = wrist_wrenches(chain, state, result)
    return _with_wrenches(chain, state, result.grasp_wrench), found


def _with_wrenches(
    chain: ClosedChain, state: State, grasp_wrench: ArrayLike, further: Mapping[str, Array] | None = None
) -> VariedCase:
    f = checks.numbers(grasp_wrench, (len(chain.arms), 6), "grasp_wrench", StateError)
    return case_of(chain, state, None, {"grasp_wrench": f, **(further or {})})


def _margins(case: VariedCase) -> tuple[Array]:
    return (limited_margins(case.chain, case.own[CONTACTS], case.state.object_frame.R, case.own["grasp_wrench"]),)


def _limits(case: VariedCase) -> tuple[Array, ...]:
    limits = JointLimits(*case.own[LIMITS])
    found = margins_of_joints(limits, case.state.q, case.state.qd, case.own["tau"])
    return tuple(where(limited, margin, math.inf) for limited, margin in zip(limits.limited, found, strict=True))


def _wrists(case: VariedCase) -> tuple[Array]:
    return (across_tips(case.chain, case.state, case.own["grasp_wrench"]),)


def _grasps(chain: ClosedChain, result: str) -> list[Part]:
    return [Part(slice(k, k + 1), chain.names.index(name)) for k, name in enumerate(chain.grasps)]


MARGINS = Differentiable(
    "grasp_margins",
    ("object_pose", "grasp_pose", "grasp_wrench"),
    ("grasp_margins",),
    _margins,
    unlimited=True,
    shape=lambda chain, result: (len(chain.grasps),),
    parts=_grasps,
    of_object=True,
)


def _arms(chain: ClosedChain, result: str) -> list[Part]:
    return [Part(slice(6 * row, 6 * row + 6), row) for row in range(len(chain.arms))]


OF_LIMITS = Differentiable(
    "joint_margins",
    OF_JOINTS,
    JointMargins._fields,
    _limits,
    unlimited=True,
    shape=lambda chain, result: (chain.joint_count,),
    parts=by_joints,
)
WRISTS = Differentiable(
    "wrist_wrenches",
    ("q", "base_pose", "floating_pose", "grasp_wrench"),
    ("wrist_wrenches",),
    _wrists,
    shape=lambda chain, result: (len(chain.arms), 6),
    parts=_arms,
)
