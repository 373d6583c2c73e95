"""Derivatives of a compiled chain's margins of grasps and joints, and wrenches at wrists."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from holdfast.compiled.derivative_methods import DerivativeMethods
from holdfast.dynamics.derivatives import Derivatives
from holdfast.forces.force_derivatives import OF_JOINTS, OF_MARGINS, OF_WRISTS
from holdfast.forces.margins import JointMargins


class ForceDerivatives(DerivativeMethods):
    """The methods of a `CompiledChain` that differentiate the margins of grasps and joints, and wrenches at wrists.

    They are those of the reference of the same names, `holdfast.forces.joint_margins_vjp` and so on, for one system or
    a batch, and have the conventions of `FunctionDerivatives`.
    """

    def grasp_margins_vjp(
        self,
        object_pose: Any,
        grasp_wrench: Any,
        *,
        grasp_margins: Any,
        by: Sequence[str] = OF_MARGINS,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return gradients of cotangent . margins of the grasps, O(l); see `holdfast.forces.grasp_margins_vjp`.

        Args:
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            grasp_wrench: (arms, 6) wrench of each arm on the object, as in `grasp_margins`.
            grasp_margins: (grasps,) the cotangent.
            by: the arguments: object_pose, grasp_pose, grasp_wrench.
            threads: the number of threads for a batch.
            **parameters: parameters as in `grasp_margins`.

        Returns:
            The gradient by every argument, in the shape of the argument; `result` holds the margins [N].

        Raises:
            StateError: A name, shape or number is wrong.
        """
        cotangents = {"grasp_margins": grasp_margins}
        return self._vjp("grasp_margins", (object_pose, grasp_wrench), cotangents, by, parameters, threads)

    def grasp_margins_jvp(
        self, object_pose: Any, grasp_wrench: Any, *, along: Mapping[str, Any], threads: int = 1, **parameters: Any
    ) -> Derivatives:
        """Return directional derivatives of the grasps' margins, O(l); see `holdfast.forces.grasp_margins_jvp`.

        Args:
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            grasp_wrench: (arms, 6) wrench of each arm on the object, as in `grasp_margins`.
            along: the tangents by argument, each in the shape of the argument's gradient; (d, ...) for d directions
                of one system at once, (batch, ...) for a batch.
            threads: the number of threads for a batch.
            **parameters: parameters as in `grasp_margins`.

        Returns:
            `found.grasp_margins`, (grasps,), with a leading axis if there are several directions or a batch.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        return self._jvp("grasp_margins", (object_pose, grasp_wrench), along, parameters, threads)

    def grasp_margins_jacobian(
        self,
        object_pose: Any,
        grasp_wrench: Any,
        *,
        of: Sequence[str] = ("grasp_margins",),
        by: Sequence[str] = OF_MARGINS,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return the Jacobian of the grasps' margins, O(l^2); see `holdfast.forces.grasp_margins_jacobian`.

        Args:
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            grasp_wrench: (arms, 6) wrench of each arm on the object, as in `grasp_margins`.
            of: the results; there is one, grasp_margins.
            by: the arguments.
            threads: the number of threads for a batch.
            **parameters: parameters as in `grasp_margins`.

        Returns:
            `found["grasp_margins", by]`, (grasps, *shape of the argument's gradient), with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        return self._derived("grasp_margins", "jacobian", (object_pose, grasp_wrench), of, by, {}, parameters, threads)

    def joint_margins_vjp(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        *,
        by: Sequence[str] = OF_JOINTS,
        position: Any = None,
        rate: Any = None,
        effort: Any = None,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return gradients of sum(cotangent . margin) of the joints, O(n); see `holdfast.forces.joint_margins_vjp`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            tau: (n,) drive torques [N m or N].
            by: the arguments: q, qd, tau.
            position: (n,) the cotangent of the position margins.
            rate: (n,) the cotangent of the rate margins.
            effort: (n,) the cotangent of the effort margins.
            threads: the number of threads for a batch.
            **parameters: none; limits are the chain's.

        Returns:
            The gradient by every argument, (n,); `result` holds the `JointMargins`.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        cotangents = {"position": position, "rate": rate, "effort": effort}
        return self._vjp("joint_margins", (q, qd, tau), cotangents, by, parameters, threads)

    def joint_margins_jvp(
        self, q: Any, qd: Any, tau: Any, *, along: Mapping[str, Any], threads: int = 1, **parameters: Any
    ) -> Derivatives:
        """Return directional derivatives of the margins, O(n); see `holdfast.forces.joint_margins_jvp`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            tau: (n,) drive torques [N m or N].
            along: the tangents by argument, (n,) each; (d, n) for d directions of one system at once, (batch, n) for a
                batch.
            threads: the number of threads for a batch.
            **parameters: none; limits are the chain's.

        Returns:
            `found.position`, `found.rate` and `found.effort`, (n,), with a leading axis if there are several directions
            or a batch.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        return self._jvp("joint_margins", (q, qd, tau), along, parameters, threads)

    def joint_margins_jacobian(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        *,
        of: Sequence[str] = JointMargins._fields,
        by: Sequence[str] = OF_JOINTS,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return the Jacobian of the margins, O(n^2); see `holdfast.forces.joint_margins_jacobian`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            tau: (n,) drive torques [N m or N].
            of: the results: position, rate, effort.
            by: the arguments.
            threads: the number of threads for a batch.
            **parameters: none; limits are the chain's.

        Returns:
            `found[of, by]`, (n, n), with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        return self._derived("joint_margins", "jacobian", (q, qd, tau), of, by, {}, parameters, threads)

    def wrist_wrenches_vjp(
        self,
        q: Any,
        grasp_wrench: Any,
        *,
        wrist_wrenches: Any,
        by: Sequence[str] = OF_WRISTS,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return gradients of cotangent . wrist wrenches, O(n); see `holdfast.forces.wrist_wrenches_vjp`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            grasp_wrench: (arms, 6) wrench of each arm on the object, as in `wrist_wrenches`.
            wrist_wrenches: (arms, 6) the cotangent.
            by: the arguments: q, base_pose, grasp_wrench; with a floating base also floating_pose.
            threads: the number of threads for a batch.
            **parameters: parameters as in `wrist_wrenches`.

        Returns:
            The gradient by every argument, in the shape of the argument; `result` holds the wrist wrenches [N m, N].

        Raises:
            StateError: A name, shape or number is wrong, or an arm that holds nothing has a wrench.
        """
        cotangents = {"wrist_wrenches": wrist_wrenches}
        return self._vjp("wrist_wrenches", (q, grasp_wrench), cotangents, by, parameters, threads)

    def wrist_wrenches_jvp(
        self, q: Any, grasp_wrench: Any, *, along: Mapping[str, Any], threads: int = 1, **parameters: Any
    ) -> Derivatives:
        """Return the directional derivative of the wrist wrenches, O(n); see `holdfast.forces.wrist_wrenches_jvp`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            grasp_wrench: (arms, 6) wrench of each arm on the object, as in `wrist_wrenches`.
            along: the tangents by argument, each in the shape of the argument's gradient; (d, ...) for d directions
                of one system at once, (batch, ...) for a batch.
            threads: the number of threads for a batch.
            **parameters: parameters as in `wrist_wrenches`.

        Returns:
            `found.wrist_wrenches`, (arms, 6), with a leading axis if there are several directions or a batch.

        Raises:
            StateError: A name, shape or number is wrong, or an arm that holds nothing has a wrench.
        """
        return self._jvp("wrist_wrenches", (q, grasp_wrench), along, parameters, threads)

    def wrist_wrenches_jacobian(
        self,
        q: Any,
        grasp_wrench: Any,
        *,
        of: Sequence[str] = ("wrist_wrenches",),
        by: Sequence[str] = OF_WRISTS,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return the Jacobian of the wrist wrenches, O(n l); see `holdfast.forces.wrist_wrenches_jacobian`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            grasp_wrench: (arms, 6) wrench of each arm on the object, as in `wrist_wrenches`.
            of: the results; there is one, wrist_wrenches.
            by: the arguments.
            threads: the number of threads for a batch.
            **parameters: parameters as in `wrist_wrenches`.

        Returns:
            `found["wrist_wrenches", by]`, (arms, 6, *shape of the argument's gradient), with a leading axis for a
            batch.

        Raises:
            StateError: A name, shape or number is wrong, or an arm that holds nothing has a wrench.
        """
        return self._derived("wrist_wrenches", "jacobian", (q, grasp_wrench), of, by, {}, parameters, threads)
