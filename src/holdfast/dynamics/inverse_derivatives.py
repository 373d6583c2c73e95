"""Derivatives of inverse dynamics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.forward_derivatives import ARGUMENTS
from holdfast.dynamics.derivatives import Derivatives
from holdfast.dynamics.function_derivatives import case_of, function_jacobian, function_jvp, function_vjp
from holdfast.dynamics.inverse import inverse_dynamics, torques_and_deciding
from holdfast.dynamics.linearised_function import Differentiable, by_joints
from holdfast.dynamics.possible_motion import deciding
from holdfast.dynamics.trunk.trunk_derivatives import FLOATING_RESULT, OF_TRUNK
from holdfast.dynamics.varied_case import VariedCase
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, array
from holdfast.state import Inputs, State

MOTION_AND_FORCES = ("q", "qd", "qdd", "grasp_wrench")


def inverse_dynamics_vjp(
    chain: ClosedChain,
    state: State,
    qdd: ArrayLike,
    grasp_wrench: ArrayLike,
    inputs: Inputs | None = None,
    base_acceleration: ArrayLike | None = None,
    *,
    by: Sequence[str] = MOTION_AND_FORCES,
    tau: ArrayLike,
) -> Derivatives:
    """Return the gradients of cotangent . tau of inverse dynamics with respect to some arguments. O(n) + O(l).

    theta_bar = (d tau / d theta)^T tau_bar. Names and the derivatives by poses and inertias are as in
    `forward_dynamics_vjp`. Arguments on which tau does not depend have a gradient of exactly 0: for example the
    object's mass, because the grasp wrenches are given, and the wrenches of bushings and of arms without a grasp.

    Args:
        chain: the chain.
        state: positions and velocities.
        qdd: (n,) joint accelerations.
        grasp_wrench: (arms, 6) of each arm on the object, about the contact, world axes.
        inputs: external wrenches and base motion.
        base_acceleration: (6,) true acceleration of a trunk's floating base, world axes; it is needed with one.
        by: the arguments: those of `forward_dynamics_vjp`, with qdd and grasp_wrench instead of tau; with a floating
            base also floating_acceleration. For changes for which that base would need a wrench, tau contains the
            torques of the drives only.
        tau: (n,) the cotangent.

    Returns:
        The gradients by argument, in the shape of the argument; `result` contains tau.

    Raises:
        StateError: a name, shape or number is wrong; see `inverse_dynamics`.
    """
    return function_vjp(TORQUES, *_case(chain, state, qdd, grasp_wrench, inputs, base_acceleration), by, {"tau": tau})


def inverse_dynamics_jvp(
    chain: ClosedChain,
    state: State,
    qdd: ArrayLike,
    grasp_wrench: ArrayLike,
    inputs: Inputs | None = None,
    base_acceleration: ArrayLike | None = None,
    *,
    along: Mapping[str, ArrayLike],
) -> Derivatives:
    """Return the rates of the torques of inverse dynamics for given rates of its arguments. O(n) + O(l) per direction.

    tau_dot = (d tau / d theta) theta_dot; see `inverse_dynamics_vjp`.

    Args:
        chain: the chain.
        state: positions and velocities.
        qdd: (n,) joint accelerations.
        grasp_wrench: (arms, 6) of each arm on the object, about the contact, world axes.
        inputs: external wrenches and base motion.
        base_acceleration: (6,) true acceleration of a trunk's floating base, world axes; it is needed with one.
        along: rates of the arguments by name, in the shapes of their gradients, or (d, ...) for d directions.

    Returns:
        `found.tau`, (n,) or (d, n).

    Raises:
        StateError: a name, shape or number is wrong; see `inverse_dynamics`.
    """
    return function_jvp(TORQUES, *_case(chain, state, qdd, grasp_wrench, inputs, base_acceleration), along)


def inverse_dynamics_jacobian(
    chain: ClosedChain,
    state: State,
    qdd: ArrayLike,
    grasp_wrench: ArrayLike,
    inputs: Inputs | None = None,
    base_acceleration: ArrayLike | None = None,
    *,
    of: Sequence[str] = ("tau",),
    by: Sequence[str] = MOTION_AND_FORCES,
) -> Derivatives:
    """Return the Jacobian d tau / d theta of inverse dynamics, O(n^2); see `inverse_dynamics_vjp`.

    Args:
        chain: the chain.
        state: positions and velocities.
        qdd: (n,) joint accelerations.
        grasp_wrench: (arms, 6) of each arm on the object, about the contact, world axes.
        inputs: external wrenches and base motion.
        base_acceleration: (6,) true acceleration of a trunk's floating base, world axes; it is needed with one.
        of: the results; there is one, tau.
        by: the arguments.

    Returns:
        `found["tau", by]`, (n, *shape of the argument's gradient).

    Raises:
        StateError: a name, shape or number is wrong; see `inverse_dynamics`.
    """
    return function_jacobian(TORQUES, *_case(chain, state, qdd, grasp_wrench, inputs, base_acceleration), of, by)


def _case(
    chain: ClosedChain,
    state: State,
    qdd: ArrayLike,
    grasp_wrench: ArrayLike,
    inputs: Inputs | None,
    base_acceleration: ArrayLike | None,
) -> tuple[VariedCase, Array]:
    """Return the arguments of the differentiated function, and the torques there."""
    found = inverse_dynamics(chain, state, qdd, grasp_wrench, inputs, base_acceleration)
    own = {
        "qdd": checks.numbers(qdd, (chain.joint_count,), "qdd", StateError),
        "grasp_wrench": checks.numbers(grasp_wrench, (len(chain.arms), 6), "grasp_wrench", StateError),
    }
    if base_acceleration is not None:
        own |= {FLOATING_RESULT: checks.numbers(base_acceleration, (6,), "base_acceleration", StateError)}
    return case_of(chain, state, inputs, own), found


def _torques(case: VariedCase) -> tuple[Array, ...]:
    """Return tau, with the wrenches of arms without a grasp replaced by zero, and the numbers of `deciding`."""
    chain = case.chain
    motion = chain_motion(chain, case.state, np.zeros(chain.joint_count), case.inputs)
    rows = zip(chain.arms, case.own["grasp_wrench"], strict=True)
    f = array([row if name in chain.grasps else np.zeros(6) for name, row in rows])
    return torques_and_deciding(motion, case.own["qdd"], f, case.own.get(FLOATING_RESULT))


TORQUES = Differentiable(
    "inverse_dynamics",
    (
        *(name for name in ARGUMENTS if name != "tau"),
        "qdd",
        "grasp_wrench",
        FLOATING_RESULT,
        *OF_TRUNK,
        "floating_pose",
    ),
    ("tau",),
    _torques,
    shape=lambda chain, result: (chain.joint_count,),
    parts=by_joints,
    deciding=deciding,
)
