"""Derivatives of the kinetic and the potential energy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.derivatives import Derivatives
from holdfast.dynamics.energy import total_kinetic_energy, total_potential_energy
from holdfast.dynamics.function_derivatives import case_of, function_jacobian, function_jvp, function_vjp
from holdfast.dynamics.linearised_function import Differentiable
from holdfast.dynamics.varied_case import VariedCase
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Scalar
from holdfast.state import Inputs, State, require_fit

OF_INERTIAS = (
    *("object_mass", "object_com", "object_inertia", "link_mass", "link_com", "link_inertia"),
    *("trunk_link_mass", "trunk_link_com", "trunk_link_inertia"),
)
PLACES = ("q", "object_pose")
MOTION = (*PLACES, "qd", "object_twist")


def kinetic_energy_vjp(
    chain: ClosedChain,
    state: State,
    inputs: Inputs | None = None,
    *,
    by: Sequence[str] = MOTION,
    kinetic_energy: ArrayLike = 1.0,
) -> Derivatives:
    """Return the gradients of the kinetic energy with respect to some arguments. O(n) + O(l).

    theta_bar = T_bar dT/dtheta, with T as in `kinetic_energy`. The names of the arguments and the derivatives by poses
    are as in `forward_dynamics_vjp`.

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: base motion, if the bases move.
        by: the arguments: q, qd, object_pose, object_twist, base_pose, base_twist, armature, and mass, com
            and inertia of object_ and link_; with a trunk those of trunk_link_, and floating_pose and
            floating_twist, or trunk_base_twist.
        kinetic_energy: the cotangent T_bar; 1 gives the gradients of T itself.

    Returns:
        The gradients by argument, in the shape of the argument; `result` holds the energy [J].

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_vjp(KINETIC, *_case(KINETIC, chain, state, inputs), by, {"kinetic_energy": kinetic_energy})


def kinetic_energy_jvp(
    chain: ClosedChain,
    state: State,
    inputs: Inputs | None = None,
    *,
    along: Mapping[str, ArrayLike],
) -> Derivatives:
    """Return the rate of the kinetic energy for given rates of its arguments. O(n) + O(l) per direction.

    T_dot = dT/dtheta theta_dot; see `kinetic_energy_vjp`.

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: base motion, if the bases move.
        along: rates of the arguments by name, in the shapes of their gradients, or (d, ...) for d directions.

    Returns:
        `found.kinetic_energy` [W], a number or (d,).

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_jvp(KINETIC, *_case(KINETIC, chain, state, inputs), along)


def kinetic_energy_jacobian(
    chain: ClosedChain,
    state: State,
    inputs: Inputs | None = None,
    *,
    of: Sequence[str] = ("kinetic_energy",),
    by: Sequence[str] = MOTION,
) -> Derivatives:
    """Return dT/dtheta, the gradients of `kinetic_energy_vjp` in the form of a Jacobian. O(n) + O(l).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: base motion, if the bases move.
        of: the results; there is one, kinetic_energy.
        by: the arguments.

    Returns:
        `found["kinetic_energy", by]`, of the shape of the argument's gradient.

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_jacobian(KINETIC, *_case(KINETIC, chain, state, inputs), of, by)


def potential_energy_vjp(
    chain: ClosedChain,
    state: State,
    *,
    by: Sequence[str] = PLACES,
    potential_energy: ArrayLike = 1.0,
) -> Derivatives:
    """Return the gradients of the potential energy with respect to some arguments. O(n) + O(l).

    theta_bar = U_bar dU/dtheta, with U as in `potential_energy`, which includes springs and bushings. The names of the
    arguments and the derivatives by poses are as in `forward_dynamics_vjp`. U depends on grasp_pose through bushings.

    Args:
        chain: the chain.
        state: positions; velocities are ignored.
        by: the arguments: q, object_pose, gravity, base_pose, grasp_pose, and mass, com and inertia of object_
            and link_; with a trunk those of trunk_link_, with a floating base also floating_pose.
        potential_energy: the cotangent U_bar; 1 gives the gradients of U itself.

    Returns:
        The gradients by argument, in the shape of the argument; `result` holds the energy [J].

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_vjp(POTENTIAL, *_case(POTENTIAL, chain, state, None), by, {"potential_energy": potential_energy})


def potential_energy_jvp(
    chain: ClosedChain,
    state: State,
    *,
    along: Mapping[str, ArrayLike],
) -> Derivatives:
    """Return the rate of the potential energy for given rates of its arguments. O(n) + O(l) per direction.

    U_dot = dU/dtheta theta_dot; see `potential_energy_vjp`.

    Args:
        chain: the chain.
        state: positions; velocities are ignored.
        along: rates of the arguments by name, in the shapes of their gradients, or (d, ...) for d directions.

    Returns:
        `found.potential_energy` [W], a number or (d,).

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_jvp(POTENTIAL, *_case(POTENTIAL, chain, state, None), along)


def potential_energy_jacobian(
    chain: ClosedChain,
    state: State,
    *,
    of: Sequence[str] = ("potential_energy",),
    by: Sequence[str] = PLACES,
) -> Derivatives:
    """Return dU/dtheta, the gradients of `potential_energy_vjp` in the form of a Jacobian. O(n) + O(l).

    Args:
        chain: the chain.
        state: positions; velocities are ignored.
        of: the results; there is one, potential_energy.
        by: the arguments.

    Returns:
        `found["potential_energy", by]`, of the shape of the argument's gradient.

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_jacobian(POTENTIAL, *_case(POTENTIAL, chain, state, None), of, by)


def _case(
    function: Differentiable, chain: ClosedChain, state: State, inputs: Inputs | None
) -> tuple[VariedCase, float]:
    """Return the arguments of the differentiated energy, and its value."""
    require_fit(chain, state)
    case = case_of(chain, state, inputs, {})
    with np.errstate(all="ignore"):
        return case, float(function.compute(case)[0])


def _kinetic(case: VariedCase) -> tuple[Scalar]:
    return (total_kinetic_energy(case.chain, case.state, case.inputs),)


def _potential(case: VariedCase) -> tuple[Scalar]:
    return (total_potential_energy(case.chain, case.state),)


OF_BASES = ("base_pose", "floating_pose")
KINETIC = Differentiable(
    "kinetic_energy",
    (*MOTION, *OF_BASES, "base_twist", "floating_twist", "trunk_base_twist", "armature", *OF_INERTIAS),
    ("kinetic_energy",),
    _kinetic,
)
POTENTIAL = Differentiable(
    "potential_energy",
    (*PLACES, "gravity", *OF_BASES, "grasp_pose", *OF_INERTIAS),
    ("potential_energy",),
    _potential,
)
