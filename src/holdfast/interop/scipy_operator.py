"""The Jacobian of forward dynamics as a SciPy linear operator, for optimisers with many unknowns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.compiled.chain import CompiledChain
from holdfast.compiled.derivative_schedule import derivative_shapes
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator


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
    lacking = [name for name in ("q", "qd", "tau", "object_pose", "object_twist") if name not in arguments]
    if lacking:
        raise StateError(f"jacobian_operator: expected q, qd, tau, object_pose, object_twist, got no {lacking[0]}")
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
