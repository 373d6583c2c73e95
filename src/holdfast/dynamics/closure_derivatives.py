"""Derivatives of the residuals of the grasp constraints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.consistency import GraspResidual, closure, residuals_at
from holdfast.dynamics.derivatives import Derivatives
from holdfast.dynamics.function_derivatives import case_of, function_jacobian, function_jvp, function_vjp
from holdfast.dynamics.linearised_function import Differentiable, Part
from holdfast.dynamics.varied_case import VariedCase
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_kinds import GraspKind
from holdfast.spatial.scalar import Array, concatenate
from holdfast.state import Inputs, State

RESIDUALS = GraspResidual._fields
MOTION = ("q", "object_pose", "qd", "object_twist")


def closure_vjp(
    chain: ClosedChain,
    state: State,
    inputs: Inputs | None = None,
    *,
    by: Sequence[str] = MOTION,
    position: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
) -> Derivatives:
    """Return the gradients of sum(cotangent . residual) of the grasps with respect to some arguments. O(n) + O(l).

    theta_bar = (d residual / d theta)^T residual_bar, with the residuals of `closure`, concatenated over the grasps.
    The names of the arguments and the derivatives by poses are as in `forward_dynamics_vjp`. A rotation vector has no
    derivative at half a turn; the derivative for the chosen axis is then returned.

    Args:
        chain: the chain.
        state: any state, closed or not.
        inputs: base motion, if the bases move.
        by: the arguments: q, qd, object_pose, object_twist, grasp_pose, base_pose, base_twist; with a trunk
            floating_pose and floating_twist, or trunk_base_twist.
        position: (position rows,) the cotangent of the position residuals.
        velocity: (velocity rows,) the cotangent of the velocity residuals.

    Returns:
        The gradients by argument, in the shape of the argument; `result` is the result of `closure`.

    Raises:
        StateError: a name, shape or number is wrong.
    """
    given = {name: x for name, x in zip(RESIDUALS, (position, velocity), strict=True) if x is not None}
    return function_vjp(CLOSURE, *_case(chain, state, inputs), by, given)


def closure_jvp(
    chain: ClosedChain, state: State, inputs: Inputs | None = None, *, along: Mapping[str, ArrayLike]
) -> Derivatives:
    """Return the rates of the grasps' residuals for given rates of the arguments. O(n) + O(l) per direction.

    residual_dot = (d residual / d theta) theta_dot; see `closure_vjp`. For the chain's own velocities, the rates of the
    position residuals of a closed chain are its velocity residuals, in all rows that a grasp has of both kinds.

    Args:
        chain: the chain.
        state: any state, closed or not.
        inputs: base motion, if the bases move.
        along: rates of the arguments by name, in the shapes of their gradients, or (d, ...) for d directions.

    Returns:
        `found.position`, (position rows,) or (d, position rows), and `found.velocity` likewise.

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_jvp(CLOSURE, *_case(chain, state, inputs), along)


def closure_jacobian(
    chain: ClosedChain,
    state: State,
    inputs: Inputs | None = None,
    *,
    of: Sequence[str] = RESIDUALS,
    by: Sequence[str] = MOTION,
) -> Derivatives:
    """Return the Jacobian d residual / d theta of the grasps' residuals, O(n l); see `closure_vjp`.

    Args:
        chain: the chain.
        state: any state, closed or not.
        inputs: base motion, if the bases move.
        of: the results: position, velocity.
        by: the arguments.

    Returns:
        `found[of, by]`, (rows, *shape of the argument's gradient).

    Raises:
        StateError: a name, shape or number is wrong.
    """
    return function_jacobian(CLOSURE, *_case(chain, state, inputs), of, by)


def _case(chain: ClosedChain, state: State, inputs: Inputs | None) -> tuple[VariedCase, dict[str, GraspResidual]]:
    """Return the arguments of the differentiated function, and the residuals there."""
    found = closure(chain, state, inputs)
    return case_of(chain, state, inputs, {}), found


def _closure(case: VariedCase) -> tuple[Array, Array]:
    gaps, none = residuals_at(case.chain, case.state, case.inputs).values(), np.zeros(0)
    return concatenate([none, *(gap.position for gap in gaps)]), concatenate([none, *(gap.velocity for gap in gaps)])


def _by_grasps(chain: ClosedChain, result: str) -> list[Part]:
    found, end = [], 0
    for name, grasp in chain.grasps.items():
        begin, end = end, end + rows_of(grasp.of_kind, result)
        found.append(Part(slice(begin, end), chain.names.index(name)))
    return found


def by_grasps(chain: ClosedChain, position: Array, velocity: Array) -> dict[str, GraspResidual]:
    """Return the residuals of every grasp, by arm name, of those of all grasps, (..., rows) each."""
    parts = [[part.entries for part in _by_grasps(chain, result)] for result in RESIDUALS]
    return {
        name: GraspResidual(position[..., rows], velocity[..., rates])
        for name, rows, rates in zip(chain.grasps, *parts, strict=True)
    }


def rows_of(kind: GraspKind, result: str) -> int:
    """Return how many rows of a residual, `position` or `velocity`, grasps of a kind have."""
    return len(kind.position_rows if result == "position" else kind.transmitted)


CLOSURE = Differentiable(
    "closure",
    (*MOTION, "grasp_pose", "base_pose", "base_twist", "floating_pose", "floating_twist", "trunk_base_twist"),
    RESIDUALS,
    _closure,
    shape=lambda chain, result: (_by_grasps(chain, result)[-1].entries.stop if chain.grasps else 0,),
    parts=_by_grasps,
    of_object=True,
)
