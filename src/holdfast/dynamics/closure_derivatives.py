"""Derivatives of how far grasps are from holding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.consistency import GraspResidual, closure, residuals_at
from holdfast.dynamics.derivatives import Derivatives
from holdfast.dynamics.linear_text import Text
from holdfast.dynamics.text_derivatives import case_of, text_jacobian, text_jvp, text_vjp
from holdfast.dynamics.varied_case import VariedCase
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
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
    """Return gradients of sum(cotangent . residual) of the grasps by some arguments. O(n) + O(l).

    theta_bar = (d residual / d theta)^T residual_bar, residuals as in `closure`, those of all grasps one after the
    other; names, and what poses turn by, as in `forward_dynamics_vjp`. A rotation vector has no derivative at half a
    turn; given there is that of the axis taken.

    Args:
        chain: the chain.
        state: any state, closed or not.
        inputs: base motion, if the bases move.
        by: the arguments: q, qd, object_pose, object_twist, grasp_pose, base_pose, base_twist; with a trunk
            floating_pose and floating_twist, or trunk_base_twist.
        position: (position rows,) the cotangent of what positions leave open.
        velocity: (velocity rows,) that of what velocities do.

    Returns:
        By argument its gradient, in its shape; `result` is what `closure` returns.

    Raises:
        StateError: wrong names, shapes or numbers.
    """
    case, found = _case(chain, state, inputs)
    given = {name: x for name, x in zip(RESIDUALS, (position, velocity), strict=True) if x is not None}
    return text_vjp(CLOSURE, case, found, by, given)


def closure_jvp(
    chain: ClosedChain, state: State, inputs: Inputs | None = None, *, along: Mapping[str, ArrayLike]
) -> Derivatives:
    """Return how fast the residuals of the grasps change while arguments do. O(n) + O(l) a direction.

    residual_dot = (d residual / d theta) theta_dot; see `closure_vjp`. Along its own velocities a closed chain's
    position residuals change by its velocity residuals, row by row where a grasp has both.

    Args:
        chain: the chain.
        state: any state, closed or not.
        inputs: base motion, if the bases move.
        along: by argument, how fast it changes, of its gradient's shape; or (d, ...) for d directions.

    Returns:
        `found.position`, (position rows,) or (d, position rows), and `found.velocity` likewise.

    Raises:
        StateError: wrong names, shapes or numbers.
    """
    case, found = _case(chain, state, inputs)
    return text_jvp(CLOSURE, case, found, along)


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
        StateError: wrong names, shapes or numbers.
    """
    case, found = _case(chain, state, inputs)
    return text_jacobian(CLOSURE, case, found, of, by)


def _case(chain: ClosedChain, state: State, inputs: Inputs | None) -> tuple[VariedCase, dict[str, GraspResidual]]:
    """Return what the text is given, and the residuals there."""
    checks.instance(chain, ClosedChain, "chain")
    with np.errstate(all="ignore"):
        return case_of(chain, state, inputs, {}), closure(chain, state, inputs)


def _closure(case: VariedCase) -> tuple[Array, Array]:
    gaps, none = residuals_at(case.chain, case.state, case.inputs).values(), np.zeros(0)
    return concatenate([none, *(gap.position for gap in gaps)]), concatenate([none, *(gap.velocity for gap in gaps)])


CLOSURE = Text(
    "closure",
    (*MOTION, "grasp_pose", "base_pose", "base_twist", "floating_pose", "floating_twist", "trunk_base_twist"),
    RESIDUALS,
    _closure,
)
