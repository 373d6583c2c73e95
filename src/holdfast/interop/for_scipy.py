"""Functions for SciPy's optimisers: the Jacobian of forward dynamics as an operator, and costs with their gradients."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from holdfast.compiled.chain import CompiledChain
from holdfast.compiled.derivative_schedule import derivative_shapes
from holdfast.dynamics.projection import turned_and_shifted
from holdfast.errors import MethodNotApplicable, SingularChainError, StateError
from holdfast.model import checks
from holdfast.questions.arrays import POSES, STATE_AND_TORQUES
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.spatial.rotation import exp_curve
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator


NamedArrays = Mapping[str, Array]
Cost = Callable[[NamedArrays], tuple[Any, NamedArrays]]  # results -> its value, and its derivatives by some of them
Pullback = Callable[[NamedArrays], Any]  # cotangents of results -> gradients by the unknowns, by name


def jacobian_operator(
    compiled: CompiledChain, *, of: str = "qdd", by: Sequence[str] = ("tau",), **arguments: Any
) -> LinearOperator:
    """Return J = d of / d by of forward dynamics for one system: J x is a JVP, J^T y a VJP, O(n) + O(l) each.

    It can be returned by the function `jac` of `scipy.optimize.least_squares`, or used in `trust-krylov` and other
    solvers of SciPy.

    Args:
        compiled: chain returned by `holdfast.compile`.
        of: the result to which the rows of J belong, as in `forward_dynamics_jvp`.
        by: the arguments to which the columns of J belong, one after the other, as in `forward_dynamics_vjp`; poses
            as [turn; shift].
        **arguments: q, qd, tau, object_pose, object_twist, and parameters, of one system.

    Returns:
        The operator; invalid numbers are refused when it is first used.

    Raises:
        StateError: a name is unknown, or the state is incomplete.
    """
    from scipy.sparse.linalg import LinearOperator

    checks.instance(compiled, CompiledChain, "jacobian_operator: compiled", StateError)
    checks.instance(of, str, "jacobian_operator: of", StateError)
    checks.instance(by, (list, tuple), "jacobian_operator: by", StateError)
    _require_state("jacobian_operator", arguments)
    compiled.forward_dynamics.derived("jvp", [of], by)  # refuses unknown names
    shapes = derivative_shapes(compiled.chain)
    sizes = [math.prod(shapes[name]) for name in by]

    def forward(x: Array) -> Array:
        parts = np.split(np.ravel(x), np.cumsum(sizes)[:-1])
        along = {name: part.reshape(shapes[name]) for name, part in zip(by, parts, strict=True)}
        return compiled.forward_dynamics_jvp(**arguments, along=along, of=[of])[of].ravel()

    def backward(y: Array) -> Array:
        given: dict[str, Any] = arguments | {of: np.reshape(y, shapes[of])}
        found = compiled.forward_dynamics_vjp(**given, by=by)
        return np.concatenate([found[name].ravel() for name in by])

    shape = (math.prod(shapes[of]), sum(sizes))
    return LinearOperator(shape, matvec=forward, rmatvec=backward, dtype=np.float64)  # type: ignore[call-arg]


def value_and_gradient(
    dynamics: Rollout | CompiledChain,
    cost: Cost,
    *,
    of: Sequence[str],
    by: Sequence[str],
    step: Any = None,
    steps: int | None = None,
    schedule: Mapping[str, Any] | None = None,
    threads: int | None = None,
    **arguments: Any,
) -> ValueAndGradient:
    """Return fun(x) = (cost, d cost / dx) for `scipy.optimize.minimize(fun, fun.x0, jac=True)`.

    x holds some arguments of a rollout, or of forward dynamics, one after the other. The gradient is exact, and
    costs as much for a thousand unknowns as for one: it comes back through `Rollout.tape`, or through
    `forward_dynamics_vjp`.

    Args:
        dynamics: what `compile_rollout` or `compile` returned.
        cost: results by name -> (value, the value's derivatives by name, in the results' shapes; by a pose (.., 6)
            [turn; shift]). Those that it leaves out are zero.
        of: which results it is given. Of a rollout: arrays of `RolloutSystems` at the end of every step, (steps,
            systems, ...). Of forward dynamics: qdd, grasp_wrench and so on.
        by: the unknowns: arguments by which `Tape.vjp`, or `forward_dynamics_vjp`, has gradients. Each begins with its
            given value. One that is given once and not for every system or step is shared, and so is its part of x. A
            pose has six unknowns, [rotation vector; shift] from its given value.
        step: of a rollout [s].
        steps: of a rollout, how many.
        schedule: of a rollout: parameters of its law step by step, by name (steps, ...) or (steps, systems, ...).
        threads: of a rollout, as for `Rollout.step`.
        **arguments: of a rollout those of `Rollout.start`, of a compiled chain those of `forward_dynamics`.

    Returns:
        The function. Where a system stands still before the last step, or forward dynamics has no answer, its value is
        infinite and its gradient zero, so that line searches turn back; at `x0` that is refused.

    Raises:
        MethodNotApplicable: the positions of spherical joints are unknowns.
        StateError: names that are not there, an unknown without a value; of its calls: what the cost returns is no
            such pair, or there is no answer at `x0`.
    """
    checks.instance(dynamics, (Rollout, CompiledChain), "value_and_gradient: dynamics", StateError)
    for what, names in (("of", of), ("by", by)):
        checks.instance(names, (list, tuple), f"value_and_gradient: {what}", StateError)
        if not names:
            raise StateError(f"value_and_gradient: {what}: expected some names, got none")
    rolls = isinstance(dynamics, Rollout)
    rows = dict(schedule or {})
    if rolls and (step is None or steps is None):
        raise StateError("value_and_gradient: expected step and steps of a rollout, got none")
    if not rolls and (rows or step is not None or steps is not None):
        raise StateError("value_and_gradient: expected neither step, steps nor schedule of forward dynamics")
    if not rolls:
        _require_state("value_and_gradient", arguments)
    given = arguments | rows | ({"step": step} if rolls else {})
    if rolls and "q" in by and dynamics.chain.position_count != dynamics.chain.joint_count:
        raise MethodNotApplicable(
            "value_and_gradient: by: q: expected joints with one coordinate each, got a spherical one, whose quaternion"
            " is not free; try other unknowns, or Tape.vjp, whose gradient is by its rotation"
        )
    for name in by:
        if name not in given:
            raise StateError(f"value_and_gradient: by: {name}: expected a value to begin with, got none")

    def roll(rollout: Rollout, values: Mapping[str, Any]) -> Outcome:
        assert steps is not None
        taken = {name: values[name] for name in rows}
        first = {name: x[0] for name, x in taken.items()}
        systems = rollout.start(**{name: values[name] for name in arguments} | first, threads=threads)
        tape = rollout.tape(systems, values["step"], steps=steps, record=of, schedule=taken, threads=threads)
        records = tape.records if tape.systems.running.all() else None
        return Outcome(records, lambda cotangents: tape.vjp(along=cotangents, by=by, threads=threads))

    def solve(fast: CompiledChain, values: Mapping[str, Any]) -> Outcome:
        try:
            found = fast.forward_dynamics(**values)
        except SingularChainError:
            return Outcome(None, dict)
        results = {name: np.asarray(getattr(found, name)) for name in of}
        sound = all(np.isfinite(x).all() for x in results.values())
        return Outcome(
            results if sound else None, lambda cotangents: fast.forward_dynamics_vjp(**{**values, **cotangents}, by=by)
        )

    run = partial(roll, dynamics) if isinstance(dynamics, Rollout) else partial(solve, dynamics)
    return ValueAndGradient(run, cost, given, tuple(by), tuple(rows))


def _require_state(what: str, arguments: Mapping[str, Any]) -> None:
    """Refuse arguments of forward dynamics without the state or the torques."""
    if lacking := [name for name in STATE_AND_TORQUES if name not in arguments]:
        raise StateError(f"{what}: expected {', '.join(STATE_AND_TORQUES)}, got no {lacking[0]}")


class Outcome(NamedTuple):
    """What came of some values of the unknowns.

    Attributes:
        results: by name; None where there are none.
        pullback: returns the gradients.
    """

    results: NamedArrays | None
    pullback: Pullback


class ValueAndGradient:
    """A cost and its gradient as a function of one vector; made by `value_and_gradient`.

    Attributes:
        x0: (m,) the unknowns as they were given.
        by: their names, in order.
    """

    def __init__(
        self,
        run: Callable[[Mapping[str, Any]], Outcome],
        cost: Cost,
        given: Mapping[str, Any],
        by: tuple[str, ...],
        rows: tuple[str, ...],
    ) -> None:
        self.by, self._run, self._cost, self._rows = by, run, cost, rows
        self._given = {name: np.array(x, dtype=float) if name in by else x for name, x in given.items()}
        starts = [np.zeros(_unknowns(name, self._given[name])) if name in POSES else self._given[name] for name in by]
        self._shapes = [x.shape for x in starts]
        self.x0: Array = np.concatenate([x.ravel() for x in starts])

    def values(self, x: Any) -> dict[str, Array]:
        """Return the unknowns of a vector by name, as rollouts and forward dynamics take them.

        Args:
            x: (m,) the vector.
        """
        named = self._named(x)
        return {name: _moved(self._given[name], part) if name in POSES else part for name, part in named.items()}

    def __call__(self, x: Any) -> tuple[float, Array]:
        """Return the cost and its gradient (m,).

        Args:
            x: (m,) the unknowns, in the order of `by`.

        Raises:
            StateError: the cost returns no value and derivatives, or there is no answer at `x0`.
        """
        named = self._named(x)
        run = self._run(self._given | self.values(x))
        if run.results is None:
            if np.array_equal(x, self.x0):
                raise StateError(
                    "value_and_gradient: expected values to begin with that have an answer, got systems that stand"
                    " still before the last step or a singular configuration; try a shorter step, or other values"
                )
            return np.inf, np.zeros(len(self.x0))
        returned = self._cost(run.results)
        try:
            number, cotangents = returned
            value, cotangents = float(number), dict(cotangents)
        except (TypeError, ValueError) as cause:
            raise StateError(
                "value_and_gradient: cost: expected a number and derivatives of it by name, (number, {name: array}),"
                f" got {checks.short(returned)}"
            ) from cause
        if not cotangents:
            return value, np.zeros(len(self.x0))
        found = run.pullback(cotangents)
        return value, np.concatenate([self._own(name, found[name], part).ravel() for name, part in named.items()])

    def _named(self, x: Any) -> dict[str, Array]:
        """Return the parts of a vector by name."""
        whole = checks.numbers(x, self.x0.shape, "value_and_gradient: x", StateError)
        ends = np.cumsum([int(np.prod(shape)) for shape in self._shapes])
        parts = np.split(whole, ends[:-1])
        return {name: part.reshape(s) for name, part, s in zip(self.by, parts, self._shapes, strict=True)}

    def _own(self, name: str, gradient: Array, part: Array) -> Array:
        """Return the gradient by an unknown's own numbers: summed over those that share it."""
        if gradient.ndim > part.ndim:
            gradient = gradient.sum(axis=1 if name in self._rows else 0)
        return _by_vectors(part, gradient) if name in POSES else gradient


def _unknowns(name: str, pose: Array) -> tuple[int, ...]:
    if pose.shape[-1:] != (7,):
        raise StateError(f"value_and_gradient: {name}: expected wxyz_xyz, (.., 7), got shape {pose.shape}")
    return (*pose.shape[:-1], 6)


def _moved(pose: Array, moved: Array) -> Array:
    """Return poses (.., 7) turned by rotation vectors and shifted, (.., 6)."""
    rows = zip(pose.reshape(-1, 7), moved.reshape(-1, 6), strict=True)
    return np.reshape([turned_and_shifted(x, by) for x, by in rows], pose.shape)


def _by_vectors(moved: Array, gradient: Array) -> Array:
    """Return gradients by [rotation vector; shift] of those by [turn; shift]: omega = J d(rotation vector)/dt, J^T."""

    def one(by: Array, cotangent: Array) -> Array:
        turns = np.array([exp_curve(by[:3], unit, np.zeros(3))[1] for unit in np.eye(3)])  # J^T
        return np.concatenate([turns @ cotangent[:3], cotangent[3:]])

    rows = zip(moved.reshape(-1, 6), gradient.reshape(-1, 6), strict=True)
    return np.reshape([one(by, cotangent) for by, cotangent in rows], moved.shape)
