"""Derivatives of the forward dynamics of a forest, by one virtual power of its bodies (`virtual_power`).

A cotangent z_bar of the results S(theta, z) gives K y = S_z^T z_bar and the gradient of z_bar . S - L for constant z
and y. Rates are z_dot = -K^-1 R_theta theta_dot and S_theta theta_dot + S_z z_dot, with R = dL/dy. K z = r is the
forest at rest, solved by the same elimination (docs/theory/tree.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.result import Status
from holdfast.dynamics.tree.forest_diagnosis import require_regular
from holdfast.dynamics.tree.forest_dynamics import ForestResult, forest_arguments, solved_forest
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.least_force_rates import LeastForceRates, least_force_rates
from holdfast.dynamics.tree.limb_power import limbs_in_motion
from holdfast.dynamics.tree.varied_forest import FOREST_ARGUMENTS, ForestArguments
from holdfast.dynamics.tree.virtual_power import (
    ForestOutputs,
    ForestUnknowns,
    carried,
    outputs,
    residual,
    solved_at_rest,
    unknowns_from,
    unknowns_of,
    virtual_power,
)
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.forest import Forest
from holdfast.questions.derivatives import Derivatives, directions, finite_derivatives, require_names
from holdfast.spatial.differentiation import gradient, linearised
from holdfast.spatial.scalar import Array, Scalar
from holdfast.spatial.symmetric import symmetric_part

FOREST_RESULTS = ForestOutputs._fields
POSITIONS_RATES_TORQUES = ("q", "qd", "tau")


class ForestPoint(NamedTuple):
    """Forward dynamics of a forest at one state.

    Attributes:
        given: its arguments.
        motion: its motion.
        z: its accelerations and forces.
        least: how the smallest forces change; None if forces are unique.
        at_rest: returns the solution of K z = r, `solved_at_rest` or what solves it with factors at hand.
    """

    given: ForestArguments
    motion: ForestMotion
    z: ForestUnknowns
    least: LeastForceRates | None
    at_rest: Callable[[ForestMotion, ForestUnknowns], ForestUnknowns] = solved_at_rest


@np.errstate(all="ignore")  # what overflows is refused
def forest_dynamics_vjp(
    forest: Forest,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    wrenches: ArrayLike | None = None,
    *,
    by: Sequence[str] = POSITIONS_RATES_TORQUES,
    check: bool = True,
    **cotangents: ArrayLike,
) -> Derivatives:
    """Return the gradients of sum(cotangent . result) of `forest_dynamics` with respect to some arguments. O(n).

    theta_bar = d/dtheta (z_bar . S - L) with K y = S_z^T z_bar. Each argument is varied alone, so that closures may
    open; along motions of the forest the result does not depend on how forward dynamics is extended to such states. q
    is varied in the coordinates of qd, (n_v,): quaternions turn from the left. Poses are varied by R -> exp(turn) R and
    a shift, (.., 6) [turn; shift]. Derivatives by inertias are symmetric. If forces are not unique, derivatives are
    those of the smallest, and are valid along motions.

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions.
        qd: (n_v,) rates.
        tau: (n_v,) torques [N m or N].
        wrenches: (bodies, 6) external wrenches about the origins of the bodies' frames; zero by default.
        by: the arguments: q, qd, tau, link_wrench, gravity, armature, damping, link_mass, link_com, link_inertia of the
            bodies, joint_pose (placements), tip_pose and grasp_pose (frames of closures on bodies a and b).
        check: False skips the consistency check.
        **cotangents: cotangents of any of qdd (n_v,), acceleration (bodies, 6), closure_wrench (closures, 6),
            coupling_force (couplings,).

    Returns:
        The gradients by argument, in the shape of the argument.

    Raises:
        StateError: a name, shape or number is wrong, or the state violates a closure.
        SingularChainError: no accelerations satisfy the closures.
    """
    what = "forest_dynamics_vjp"
    require_names(what, by, FOREST_ARGUMENTS)
    require_names(what, cotangents, FOREST_RESULTS)
    at, result = forest_point(forest_arguments(forest, q, qd, tau, wrenches), check)
    checked = {name: checks.numbers(x, getattr(result, name).shape, name, StateError) for name, x in cotangents.items()}
    return finite_derivatives(result, backward(at, checked, by))


@np.errstate(all="ignore")  # what overflows is refused
def forest_dynamics_jvp(
    forest: Forest,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    wrenches: ArrayLike | None = None,
    *,
    along: Mapping[str, ArrayLike],
    check: bool = True,
) -> Derivatives:
    """Return the rates of the results of `forest_dynamics` for given rates of its arguments. O(n) per direction.

    K z_dot = -R_theta theta_dot; see `forest_dynamics_vjp`, also for the names of the arguments.

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions.
        qd: (n_v,) rates.
        tau: (n_v,) torques [N m or N].
        wrenches: (bodies, 6) external wrenches about the origins of the bodies' frames; zero by default.
        along: rates of the arguments by name, in the shapes of their gradients, or (d, ...) for d directions.
        check: False skips the consistency check.

    Returns:
        The rates by result, in the shape of the result, with a leading axis if there are several directions.

    Raises:
        StateError: a name, shape or number is wrong, or the state violates a closure.
        SingularChainError: no accelerations satisfy the closures.
    """
    what = "forest_dynamics_jvp"
    checks.instance(along, Mapping, f"{what}: along", StateError)
    require_names(what, along, FOREST_ARGUMENTS)
    at, result = forest_point(forest_arguments(forest, q, qd, tau, wrenches), check)
    shapes = {name: x.shape for name, x in at.given.values(list(along)).items()}
    given = directions(what, along, shapes)
    every = [given] if isinstance(given, dict) else given
    found = forward(at, {name: np.stack([one[name] for one in every], axis=-1) for name in along})
    if isinstance(given, dict):
        return finite_derivatives(result, {name: x[..., 0] for name, x in found.items()})
    return finite_derivatives(result, {name: np.moveaxis(x, -1, 0) for name, x in found.items()})


@np.errstate(all="ignore")  # what overflows is refused
def forest_dynamics_jacobian(
    forest: Forest,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    wrenches: ArrayLike | None = None,
    *,
    of: Sequence[str] = ("qdd", "closure_wrench"),
    by: Sequence[str] = POSITIONS_RATES_TORQUES,
    check: bool = True,
) -> Derivatives:
    """Return the Jacobian of `forest_dynamics`, O(n^2); see `forest_dynamics_vjp` for the names.

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions.
        qd: (n_v,) rates.
        tau: (n_v,) torques [N m or N].
        wrenches: (bodies, 6) external wrenches about the origins of the bodies' frames; zero by default.
        of: the results: qdd, acceleration, closure_wrench, coupling_force.
        by: the arguments.
        check: False skips the consistency check.

    Returns:
        `found[of, by]`, (*shape of the result, *shape of the argument's gradient).

    Raises:
        StateError: a name, shape or number is wrong, or the state violates a closure.
        SingularChainError: no accelerations satisfy the closures.
    """
    what = "forest_dynamics_jacobian"
    require_names(what, of, FOREST_RESULTS)
    require_names(what, by, FOREST_ARGUMENTS)
    return jacobian_of(forest_arguments(forest, q, qd, tau, wrenches), of, by, check)


def jacobian_of(given: ForestArguments, of: Sequence[str], by: Sequence[str], check: bool) -> Derivatives:
    """Return the Jacobian of some results by some arguments; see `forest_dynamics_jacobian`."""
    at, result = forest_point(given, check)
    values = at.given.values(by)
    ends = np.cumsum([0, *(x.size for x in values.values())]).tolist()
    units = np.split(np.eye(ends[-1]), ends[1:-1])
    columns = forward(at, {name: unit.reshape(*values[name].shape, -1) for name, unit in zip(by, units, strict=True)})
    parts = {}
    for name, x in columns.items():
        for argument, start, end in zip(by, ends, ends[1:], strict=False):
            if name in of:
                parts[name, argument] = x[..., start:end].reshape(*x.shape[:-1], *values[argument].shape)
    return finite_derivatives(result, parts)


def forest_point(given: ForestArguments, check: bool) -> tuple[ForestPoint, ForestResult]:
    """Return forward dynamics at one state with what its derivatives need, and its result."""
    motion, found, result = solved_forest(given, check=check)
    if check and result.status is not Status.OK:
        require_regular(given.forest, given.q)
    z = unknowns_of(motion, list(found.qdd), result.closure_wrench, result.coupling_force)
    least = None if result.status is Status.OK else least_force_rates(motion, z, result.rank)
    return ForestPoint(given, motion, z, least), result


def backward(at: ForestPoint, cotangents: Mapping[str, Array], by: Sequence[str]) -> dict[str, Array]:
    """Return the gradients of sum(cotangent . result) with respect to some arguments. O(n).

    Args:
        at: the point.
        cotangents: by result, in its shape.
        by: some of `FOREST_ARGUMENTS`.
    """

    def shown(motion: ForestMotion, z: ForestUnknowns, beta: list[Array]) -> Scalar:
        found = outputs(motion, z, beta)._asdict()
        return sum((x * found[name]).sum() for name, x in cotangents.items())

    def of_unknowns(flat: Array) -> Scalar:
        z = unknowns_from(at.motion, flat)
        return shown(at.motion, z, carried(at.motion, z.rates))

    def power(*numbers: Array) -> Scalar:
        motion = at.given.motion(dict(zip(by, numbers, strict=True)))
        beta, virtual = carried(motion, at.z.rates), carried(motion, y.rates)
        whole = limbs_in_motion(motion, at.z.rates, beta, y.rates, virtual)
        found = shown(whole.motion, at.z, beta) - virtual_power(whole, at.z, beta, y)
        return found if at.least is None else found + free @ at.least.residual(motion, at.z)

    z_bar = gradient(of_unknowns, at.z.flat)[0]
    free = np.zeros(0)
    if at.least is not None:
        free, z_bar = at.least.split(z_bar)
    y = at.at_rest(at.motion, unknowns_from(at.motion, z_bar))
    found = dict(zip(by, gradient(power, *at.given.values(by).values()), strict=True))
    return found | {name: symmetric_part(x) for name, x in found.items() if name == "link_inertia"}


def forward(at: ForestPoint, rates: Mapping[str, Array]) -> dict[str, Array]:
    """Return the rates of the results along several directions, (*shape, d).

    Args:
        at: the point.
        rates: by argument, (*shape of its gradient, d).
    """
    names = list(rates)
    given = {name: 0.5 * (x + np.swapaxes(x, -3, -2)) if name == "link_inertia" else x for name, x in rates.items()}

    def equations(*numbers: Array) -> tuple[Array, ...]:
        motion = at.given.motion(dict(zip(names, numbers, strict=True)))
        weighed = () if at.least is None else (at.least.residual(motion, at.z),)
        return (residual(motion, at.z), *weighed)

    def results(z: Array, *numbers: Array) -> tuple[Array, ...]:
        motion = at.given.motion(dict(zip(names, numbers, strict=True)))
        found = unknowns_from(motion, z)
        return outputs(motion, found, carried(motion, found.rates))

    def solved(r: Array) -> tuple[Array]:
        return (at.at_rest(at.motion, unknowns_from(at.motion, r)).flat,)

    values = list(at.given.values(names).values())
    changed, *weighed = linearised(equations, *values).along(*given.values())
    if changed.shape[-1] == 1:
        moved = solved(-changed[:, 0])[0][:, None]
    else:
        (moved,) = linearised(solved, 0.0 * at.z.flat).along(-changed)
    if at.least is not None:
        moved = at.least.smallest(moved, weighed[0])
    return dict(zip(FOREST_RESULTS, linearised(results, at.z.flat, *values).along(moved, *given.values()), strict=True))
