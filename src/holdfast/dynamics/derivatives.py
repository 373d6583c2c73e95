"""Derivatives of forward dynamics, computed on floats; compiled derivatives are compared with them.

At one point they are also a rule for the differentiation of surrounding code (`spatial.differentiation.by_rule`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed.forward_derivatives import VirtualPower, backward, forward
from holdfast.dynamics.closed.forward_jacobian import jacobian, units_needed
from holdfast.dynamics.closed.second_solve import Point, point
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.force_element_rates import force_element_rates, pushforward, pushforward_along, with_pullback
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.minimum_norm_forces import MinimumNormForces, minimum_norm_forces
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.dynamics.touching_derivatives import touching_jacobian, touching_jvp, touching_vjp
from holdfast.dynamics.tree.mechanism_derivatives import mechanism_jacobian, mechanism_jvp, mechanism_vjp
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest, require_unused, serial_chain
from holdfast.questions.arrays import STATE_AND_TORQUES, arguments_of, gradient_shapes, results_of
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import (
    Derivatives,
    directions,
    finite_derivatives,
    require_names,
    with_link_wrenches,
)
from holdfast.questions.linearised_function import LinearisedFunction
from holdfast.spatial.linear import arrays_of
from holdfast.spatial.rotation import quaternion_product
from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.state import Inputs, State


@np.errstate(all="ignore")  # what overflows is refused
def forward_dynamics_vjp(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    inputs: Inputs | None = None,
    by: Sequence[str] = STATE_AND_TORQUES,
    check: bool = True,
    generic_rank: int | None = None,
    **cotangents: ArrayLike,
) -> Derivatives:
    """Return the gradients of sum(cotangent . result) of forward dynamics with respect to some arguments. O(n) + O(l).

    theta_bar = -dL/dtheta with K y = z_bar, where L is the virtual power of the chain's equations. Each argument is
    varied alone, so the grasps may open; along motions of the chain, the result does not depend on how forward dynamics
    is extended to states that violate the grasps. Derivatives by poses refer to R -> exp(turn) R and a shift, (.., 6)
    [turn; shift]; those of the object and the bases are about their origins along world axes, those of grasps along the
    object's axes. Derivatives by inertias are symmetric. If the forces are not unique, the derivatives are those of the
    smallest forces, and are valid along motions. Contacts of the object with the world keep their modes, and closed
    gaps are not distinguished from open ones; their forces are the result `touch_force` (k, 3).

    Args:
        chain: arms, object and grasps.
        state: positions and velocities; must satisfy the grasps.
        tau: (n,) joint torques [N m or N].
        inputs: external wrenches and base motion; zero by default.
        by: the arguments: q, qd, tau, object_pose, object_twist, object_wrench, gravity, object_mass, object_com,
            object_inertia, grasp_pose, base_pose, base_twist, base_acceleration, armature, damping, link_mass,
            link_com, link_inertia, link_wrench; with a trunk also trunk_link_mass, trunk_link_com,
            trunk_link_inertia and trunk_link_wrench of its bodies (a floating base first), and floating_pose and
            floating_twist or trunk_base_twist and trunk_base_acceleration. The base_pose of an arm on a trunk is
            relative to the body on which it is mounted. A chain with branches, loops, couplings or several objects has
            no base_pose, base_twist and base_acceleration; its armature and damping have one entry a joint, grasp_pose
            has a row for each grasp and then for each loop, and what is of objects a leading axis if there are several.
        check: False skips the consistency check.
        generic_rank: rank of the constraint away from singular configurations, if known.
        **cotangents: cotangents of any of qdd (n,), grasp_wrench (arms, 6), object_acceleration (6,),
            contact_acceleration (n_g,), base_wrench (arms, 6); with a trunk also trunk_base_wrench (6,) or
            floating_acceleration (6,). Of a chain with branches, those of its `MechanismResult`: qdd,
            object_acceleration, grasp_wrench, coupling_force and floating_acceleration.

    Returns:
        The gradients by argument, in the shape of the argument.

    Raises:
        StateError: a name, shape or number is wrong, the state violates a grasp, or a contact with the world is about
            to change its mode.
        SingularChainError: the constraint loses rank at this state.
    """
    if answered_as_forest(chain):
        require_unused(generic_rank=generic_rank is not None)
        return mechanism_vjp(chain, state, tau, inputs, by, check, cotangents)
    what = "forward_dynamics_vjp"
    serial_chain(chain, "chain")
    if chain.touching is not None:
        more, of = {"check": check, "generic_rank": generic_rank}, (forward_dynamics_vjp, forward_dynamics_jacobian)
        return touching_vjp(of, chain, state, tau, inputs, by, more, cotangents)
    require_names(what, by, arguments_of(chain))
    require_names(what, cotangents, results_of(chain))
    at, result, least, springs = _point(chain, state, tau, inputs, check, generic_rank, by)
    checked = {
        name: checks.numbers(x, np.shape(result_named(result, name)), name, StateError)
        for name, x in cotangents.items()
    }
    also: tuple[VirtualPower, ...] = ()
    if least is not None:
        checked, also = least.backward(at, checked)
    found = with_pullback(springs, by, lambda names: backward(at, checked, names, also))
    shapes = gradient_shapes(chain)
    return finite_derivatives(result, {name: found[name].reshape(shapes[name]) for name in by})


@np.errstate(all="ignore")  # what overflows is refused
def forward_dynamics_jvp(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    along: Mapping[str, ArrayLike],
    inputs: Inputs | None = None,
    check: bool = True,
    generic_rank: int | None = None,
) -> Derivatives:
    """Return the rates of the results of forward dynamics for given rates of its arguments. O(n) + O(l) per direction.

    K z_dot = -d(dL/dy); see `forward_dynamics_vjp`, also for the names of the arguments and the derivatives by poses.

    Args:
        chain: arms, object and grasps.
        state: positions and velocities; must satisfy the grasps.
        tau: (n,) joint torques [N m or N].
        along: rates of the arguments by name, in the shapes of their gradients, or (d, ...) for d directions.
        inputs: external wrenches and base motion; zero by default.
        check: False skips the consistency check.
        generic_rank: rank of the constraint away from singular configurations, if known.

    Returns:
        The rates by result, in the shape of the result, with a leading axis if there are several directions.

    Raises:
        StateError: a name, shape or number is wrong, or the state violates a grasp.
        SingularChainError: the constraint loses rank at this state.
    """
    what = "forward_dynamics_jvp"
    checks.instance(along, Mapping, f"{what}: along", StateError)
    if answered_as_forest(chain):
        require_unused(generic_rank=generic_rank is not None)
        return mechanism_jvp(chain, state, tau, along, inputs, check)
    serial_chain(chain, "chain")
    if chain.touching is not None:
        more, of = {"check": check, "generic_rank": generic_rank}, (forward_dynamics_jvp, forward_dynamics_jacobian)
        return touching_jvp(of, chain, state, tau, inputs, along, more)
    require_names(what, along, arguments_of(chain))
    at, result, least, springs = _point(chain, state, tau, inputs, check, generic_rank, list(along))
    given = directions(what, along, gradient_shapes(chain))
    if isinstance(given, dict):
        return finite_derivatives(result, _forward(at, given, springs, least))
    each = [_forward(at, one, springs, least) for one in given]
    return finite_derivatives(result, {name: np.array([one[name] for one in each]) for name in results_of(chain)})


@np.errstate(all="ignore")  # what overflows is refused
def forward_dynamics_jacobian(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    of: Sequence[str] = ("qdd", "grasp_wrench"),
    by: Sequence[str] = STATE_AND_TORQUES,
    inputs: Inputs | None = None,
    check: bool = True,
    generic_rank: int | None = None,
) -> Derivatives:
    """Return the Jacobian of forward dynamics, O(n^2); see `forward_dynamics_vjp` for the names.

    Args:
        chain: arms, object and grasps.
        state: positions and velocities; must satisfy the grasps.
        tau: (n,) joint torques [N m or N].
        of: the results: qdd, grasp_wrench, object_acceleration, contact_acceleration, base_wrench.
        by: the arguments.
        inputs: external wrenches and base motion; zero by default.
        check: False skips the consistency check.
        generic_rank: rank of the constraint away from singular configurations, if known.

    Returns:
        `found[of, by]`, (*shape of the result, *shape of the argument's gradient).

    Raises:
        StateError: a name, shape or number is wrong, or the state violates a grasp.
        SingularChainError: the constraint loses rank at this state.
    """
    if answered_as_forest(chain):
        require_unused(generic_rank=generic_rank is not None)
        return mechanism_jacobian(chain, state, tau, of, by, inputs, check)
    what = "forward_dynamics_jacobian"
    serial_chain(chain, "chain")
    if chain.touching is not None:
        more = {"check": check, "generic_rank": generic_rank}
        return touching_jacobian(forward_dynamics_jacobian, chain, state, tau, inputs, of, by, more)
    require_names(what, of, results_of(chain))
    require_names(what, by, arguments_of(chain))
    at, result, least, springs = _point(chain, state, tau, inputs, check, generic_rank, by)
    shapes = gradient_shapes(chain)
    changed = by if least is not None else () if springs is None else springs.names
    rates = dict.fromkeys(changed, lambda at, shapes: _along(at, shapes, springs, least))
    size = max(units_needed(chain, by), *(math.prod(shapes[name]) for name in changed), 0)
    columns = jacobian(at, of, by, np.eye(size), rates)
    return finite_derivatives(
        result, {(o, b): x.T.reshape(*np.shape(result_named(result, o)), *shapes[b]) for (o, b), x in columns.items()}
    )


def _forward(
    at: Point, tangents: Mapping[str, Array], springs: LinearisedFunction | None, least: MinimumNormForces | None
) -> dict[str, Array]:
    """Return the rates of change of all results."""
    return _along(at, {name: np.shape(x) for name, x in tangents.items()}, springs, least)(tangents)


def _along(
    at: Point,
    shapes: Mapping[str, tuple[int, ...]],
    springs: LinearisedFunction | None,
    least: MinimumNormForces | None,
) -> Callable[[Mapping[str, Array]], dict[str, Array]]:
    """Return the rates of change of all results as a function of those of the arguments."""
    along = pushforward_along(at, springs, shapes)
    if least is None:
        return along
    return lambda tangents: least.forward(at, along(tangents), pushforward(springs, tangents))


def _point(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    inputs: Inputs | None,
    check: bool,
    generic_rank: int | None,
    names: Sequence[str],
) -> tuple[Point, ForwardResult, MinimumNormForces | None, LinearisedFunction | None]:
    """Return the point, the result of forward dynamics, the smallest forces, and the springs' wrenches.

    The smallest forces are None if the forces are unique, the springs' wrenches if no named argument changes them.
    """
    result = forward_dynamics(chain, state, tau, inputs=inputs, check=check, generic_rank=generic_rank)
    given = with_link_wrenches(chain, inputs)
    motion: ChainMotion = chain_motion(chain, state, checks.numbers(tau, (chain.joint_count,), "tau"), given)
    with np.errstate(all="ignore"):
        at = point(motion, sequential(motion), "auto")
    rows = dict(zip(chain.arms, result.grasp_wrench, strict=True))
    held = {n: z if n in chain.bushings else z._replace(wrench=rows[n]) for n, z in at.unknowns.items()}
    at = replace(at, unknowns=held)
    least = minimum_norm_forces(at) if result.status is Status.INDETERMINATE_FORCES else None
    return at, result, least, force_element_rates(VariedCase(chain, state, given, {}), names)


def result_named(found: ForwardResult, name: str) -> Array:
    """Return the result with the given name in the derivatives."""
    return getattr(found, "base_acceleration" if name == "floating_acceleration" else name)


class PointRule(NamedTuple):
    """Derivatives of some results at a point with respect to some arguments.

    Attributes:
        at: the point.
        results: shapes of the results by name, as returned by `forward`.
        arguments: names of the arguments, as for `backward`.
        poses: values of the arguments that are poses wxyz_xyz, and not tangents of poses.
    """

    at: Point
    results: Mapping[str, tuple[int, ...]]
    arguments: tuple[str, ...]
    poses: Mapping[str, Array]

    def rates(self, *rates: Array) -> Sequence[Array]:
        """Return the rates of the results for given rates of the arguments."""
        tangents = {}
        for name, rate in zip(self.arguments, rates, strict=True):
            if not vanishes(rate):
                tangents[name] = motion_of(self.poses[name], rate) if name in self.poses else rate
        if not tangents:
            return [np.zeros(shape) for shape in self.results.values()]
        found = forward(self.at, tangents)
        return [found[name] for name in self.results]

    def gradient(self, *cotangents: Array) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . result) with respect to every argument."""
        given = {name: x for name, x in zip(self.results, cotangents, strict=True) if not vanishes(x)}
        shapes = gradient_shapes(self.at.motion.chain)
        if not given:
            found = {name: np.zeros(shapes[name]) for name in self.arguments}
        else:
            found = backward(self.at, given, self.arguments)
        return [
            by_pose(self.poses[name], found[name]) if name in self.poses else found[name].reshape(shapes[name])
            for name in self.arguments
        ]

    def whole(self) -> JacobianRule:
        """Return an equivalent rule that computes the Jacobian once, for many products on floats."""
        shapes = gradient_shapes(self.at.motion.chain)
        units = np.eye(units_needed(self.at.motion.chain, self.arguments)) if self.arguments else np.zeros((0, 0))
        found = jacobian(self.at, list(self.results), self.arguments, units)
        blocks = {}
        for (of, by), rows in found.items():
            block = np.asarray(rows, dtype=float).reshape(-1, math.prod(self.results[of])).T
            if by in self.poses:
                block = np.array([by_pose(self.poses[by], row) for row in block])
            blocks[of, by] = block
        sizes = [self.poses[name].shape if name in self.poses else shapes[name] for name in self.arguments]
        matrix = np.block([[blocks[of, by] for by in self.arguments] for of in self.results])
        return JacobianRule(matrix, tuple(self.results.values()), tuple(sizes))


class JacobianRule(NamedTuple):
    """Derivatives of results with respect to arguments, as a matrix.

    Attributes:
        matrix: rows are the entries of the results, columns those of the arguments.
        results: shapes of the results.
        arguments: shapes of the arguments.
    """

    matrix: Array
    results: tuple[tuple[int, ...], ...]
    arguments: tuple[tuple[int, ...], ...]

    def rates(self, *rates: Array) -> Sequence[Array]:
        """Return the rates of the results for given rates of the arguments."""
        return arrays_of((self.matrix @ np.concatenate([np.ravel(x) for x in rates])).tolist(), self.results)

    def gradient(self, *cotangents: Array) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . result) with respect to every argument."""
        return arrays_of((np.concatenate([np.ravel(x) for x in cotangents]) @ self.matrix).tolist(), self.arguments)


def vanishes(x: Array) -> bool:
    """Return whether an array is known to be zero."""
    return all(isinstance(entry, float | int) and entry == 0.0 for entry in np.asarray(x).ravel().tolist())


def motion_of(pose: Array, rate: Array) -> Array:
    """Return [turn; shift] of a pose wxyz_xyz with the given rate (7,); turn is twice the vector part of q_dot q^-1."""
    w, x, y, z = pose[:4]
    turned = quaternion_product(rate[:4], array([w, -x, -y, -z]))
    return concatenate([2.0 * turned[1:], rate[4:]])


def by_pose(pose: Array, by_motion: Array) -> Array:
    """Return the gradient (7,) with respect to a pose wxyz_xyz from the gradient (6,) by its [turn; shift]."""
    turned = quaternion_product(concatenate([np.zeros(1), by_motion[:3]]), pose[:4])
    return concatenate([2.0 * turned, by_motion[3:]])


# Both names are public: `forward_dynamics.vjp`, as for every question, and `forward_dynamics_vjp`.
for _derivative in (forward_dynamics_vjp, forward_dynamics_jvp, forward_dynamics_jacobian):
    setattr(forward_dynamics, _derivative.__name__.rpartition("_")[2], _derivative)
