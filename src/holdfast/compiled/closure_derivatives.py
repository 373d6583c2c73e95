"""Derivatives of the residuals of a compiled chain's grasps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from holdfast.compiled.derivative_methods import DerivativeMethods
from holdfast.dynamics.closure_derivatives import MOTION, RESIDUALS
from holdfast.dynamics.derivatives import Derivatives


class ClosureDerivatives(DerivativeMethods):
    """The methods of a `CompiledChain` that differentiate `closure`.

    They are those of the reference of the same names, `holdfast.dynamics.closure_vjp` and so on, for one system or a
    batch, and have the conventions of `FunctionDerivatives`. Residuals of all grasps are concatenated.
    """

    def closure_vjp(
        self,
        q: Any,
        qd: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        by: Sequence[str] = MOTION,
        position: Any = None,
        velocity: Any = None,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return gradients of sum(cotangent . residual), O(n) + O(l); see `holdfast.dynamics.closure_vjp`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            by: the arguments; see `holdfast.dynamics.closure_vjp`.
            position: (position rows,) the cotangent of the position residuals.
            velocity: (velocity rows,) the cotangent of the velocity residuals.
            threads: the number of threads for a batch.
            **parameters: parameters as in `closure`.

        Returns:
            The gradient by every argument, in the shape of the argument; `result` is that of `closure`.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        cotangents = {"position": position, "velocity": velocity}
        return self._vjp("closure", (q, qd, object_pose, object_twist), cotangents, by, parameters, threads)

    def closure_jvp(
        self,
        q: Any,
        qd: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        along: Mapping[str, Any],
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return directional derivatives of the residuals, O(n) + O(l); see `holdfast.dynamics.closure_jvp`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            along: the tangents by argument, each in the shape of the argument's gradient; (d, ...) for d directions
                of one system at once, (batch, ...) for a batch.
            threads: the number of threads for a batch.
            **parameters: parameters as in `closure`.

        Returns:
            `found.position`, (position rows,), and `found.velocity`, with a leading axis if there are several
            directions or a batch.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        return self._jvp("closure", (q, qd, object_pose, object_twist), along, parameters, threads)

    def closure_jacobian(
        self,
        q: Any,
        qd: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        of: Sequence[str] = RESIDUALS,
        by: Sequence[str] = MOTION,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return the Jacobian of the residuals, O(n l); see `holdfast.dynamics.closure_jacobian`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            of: the results: position, velocity.
            by: the arguments; see `holdfast.dynamics.closure_vjp`.
            threads: the number of threads for a batch.
            **parameters: parameters as in `closure`.

        Returns:
            `found[of, by]`, (rows, *shape of the argument's gradient), with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        return self._derived("closure", "jacobian", (q, qd, object_pose, object_twist), of, by, {}, parameters, threads)
