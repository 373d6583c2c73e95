"""Derivatives of a compiled chain's inverse dynamics and energies: products with their Jacobians, and these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from holdfast.compiled.derivative_methods import DerivativeMethods
from holdfast.dynamics.derivatives import Derivatives
from holdfast.dynamics.energy_derivatives import MOTION, PLACES
from holdfast.dynamics.inverse_derivatives import MOTION_AND_FORCES


class FunctionDerivatives(DerivativeMethods):
    """The methods of a `CompiledChain` that differentiate functions besides forward dynamics.

    They are those of the reference of the same names, `holdfast.inverse_dynamics_vjp` and so on, for one system or a
    batch: any argument, cotangent, tangent or parameter may have a leading batch axis. Derivatives by a pose are
    (.., 6) [rotation vector; shift], as in `ChainDerivatives`. Every method also returns the function, as `result`.
    Invalid inputs are treated as in `ChainFunctions`.
    """

    def inverse_dynamics_vjp(
        self,
        q: Any,
        qd: Any,
        qdd: Any,
        grasp_wrench: Any,
        *,
        tau: Any,
        by: Sequence[str] = MOTION_AND_FORCES,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return gradients of cotangent . tau, O(n) + O(l); see `holdfast.inverse_dynamics_vjp`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            qdd: (n,) joint accelerations [rad/s^2 or m/s^2].
            grasp_wrench: (arms, 6) wrench of each arm on the object, as in `inverse_dynamics`.
            tau: (n,) the cotangent.
            by: the arguments: those of `forward_dynamics_vjp`, with qdd and grasp_wrench instead of tau, and with a
                floating base floating_acceleration.
            threads: the number of threads for a batch.
            **parameters: parameters as in `inverse_dynamics`.

        Returns:
            The gradient by every argument, in the shape of the argument.

        Raises:
            StateError: A name, shape or number is wrong, or a wrench or acceleration is not possible, as in
                `inverse_dynamics`.
        """
        return self._vjp("inverse_dynamics", (q, qd, qdd, grasp_wrench), {"tau": tau}, by, parameters, threads)

    def inverse_dynamics_jvp(
        self,
        q: Any,
        qd: Any,
        qdd: Any,
        grasp_wrench: Any,
        *,
        along: Mapping[str, Any],
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return the directional derivative of joint torques, O(n) + O(l); see `holdfast.inverse_dynamics_jvp`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            qdd: (n,) joint accelerations [rad/s^2 or m/s^2].
            grasp_wrench: (arms, 6) wrench of each arm on the object, as in `inverse_dynamics`.
            along: the tangents by argument, each in the shape of the argument's gradient; (d, ...) for d directions
                of one system at once, (batch, ...) for a batch.
            threads: the number of threads for a batch.
            **parameters: parameters as in `inverse_dynamics`.

        Returns:
            `found.tau`, (n,), with a leading axis if there are several directions or a batch.

        Raises:
            StateError: A name, shape or number is wrong, or a wrench or acceleration is not possible, as in
                `inverse_dynamics`.
        """
        return self._jvp("inverse_dynamics", (q, qd, qdd, grasp_wrench), along, parameters, threads)

    def inverse_dynamics_jacobian(
        self,
        q: Any,
        qd: Any,
        qdd: Any,
        grasp_wrench: Any,
        *,
        of: Sequence[str] = ("tau",),
        by: Sequence[str] = MOTION_AND_FORCES,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return the Jacobian of joint torques, O(n^2); see `holdfast.inverse_dynamics_jacobian`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            qdd: (n,) joint accelerations [rad/s^2 or m/s^2].
            grasp_wrench: (arms, 6) wrench of each arm on the object, as in `inverse_dynamics`.
            of: the results; there is one, tau.
            by: the arguments: those of `forward_dynamics_vjp`, with qdd and grasp_wrench instead of tau, and with a
                floating base floating_acceleration.
            threads: the number of threads for a batch.
            **parameters: parameters as in `inverse_dynamics`.

        Returns:
            `found["tau", by]` of shape (n, *shape of the argument's gradient), with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or a wrench or acceleration is not possible, as in
                `inverse_dynamics`.
        """
        return self._derived(
            "inverse_dynamics", "jacobian", (q, qd, qdd, grasp_wrench), of, by, {}, parameters, threads
        )

    def kinetic_energy_vjp(
        self,
        q: Any,
        qd: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        kinetic_energy: Any = 1.0,
        by: Sequence[str] = MOTION,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return gradients of cotangent . kinetic_energy, O(n) + O(l); see `holdfast.dynamics.kinetic_energy_vjp`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            kinetic_energy: () the cotangent; with 1 the gradients are the energy's own.
            by: the arguments; see `holdfast.dynamics.kinetic_energy_vjp`.
            threads: the number of threads for a batch.
            **parameters: parameters as in `kinetic_energy`.

        Returns:
            The gradient by every argument, in the shape of the argument.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        cotangents = {"kinetic_energy": kinetic_energy}
        return self._vjp("kinetic_energy", (q, qd, object_pose, object_twist), cotangents, by, parameters, threads)

    def kinetic_energy_jvp(
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
        """Return the directional derivative of the energy, O(n) + O(l); see `holdfast.dynamics.kinetic_energy_jvp`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            along: the tangents by argument, each in the shape of the argument's gradient; (d, ...) for d directions
                of one system at once, (batch, ...) for a batch.
            threads: the number of threads for a batch.
            **parameters: parameters as in `kinetic_energy`.

        Returns:
            `found.kinetic_energy`, (), with a leading axis if there are several directions or a batch.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        return self._jvp("kinetic_energy", (q, qd, object_pose, object_twist), along, parameters, threads)

    def kinetic_energy_jacobian(
        self,
        q: Any,
        qd: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        of: Sequence[str] = ("kinetic_energy",),
        by: Sequence[str] = MOTION,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return the Jacobian of the energy, O(n) + O(l); see `holdfast.dynamics.kinetic_energy_jacobian`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            of: the results; there is one, kinetic_energy.
            by: the arguments; see `holdfast.dynamics.kinetic_energy_vjp`.
            threads: the number of threads for a batch.
            **parameters: parameters as in `kinetic_energy`.

        Returns:
            `found["kinetic_energy", by]` of shape of the argument's gradient, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        return self._derived(
            "kinetic_energy", "jacobian", (q, qd, object_pose, object_twist), of, by, {}, parameters, threads
        )

    def potential_energy_vjp(
        self,
        q: Any,
        object_pose: Any,
        *,
        potential_energy: Any = 1.0,
        by: Sequence[str] = PLACES,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return gradients of cotangent . potential_energy, O(n) + O(l); see `holdfast.dynamics.potential_energy_vjp`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            object_pose: (7,) wxyz_xyz of the object frame.
            potential_energy: () the cotangent; with 1 the gradients are the energy's own.
            by: the arguments; see `holdfast.dynamics.potential_energy_vjp`.
            threads: the number of threads for a batch.
            **parameters: parameters as in `potential_energy`.

        Returns:
            The gradient by every argument, in the shape of the argument.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        cotangents = {"potential_energy": potential_energy}
        return self._vjp("potential_energy", (q, object_pose), cotangents, by, parameters, threads)

    def potential_energy_jvp(
        self,
        q: Any,
        object_pose: Any,
        *,
        along: Mapping[str, Any],
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return the directional derivative of the energy, O(n) + O(l); see `holdfast.dynamics.potential_energy_jvp`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            object_pose: (7,) wxyz_xyz of the object frame.
            along: the tangents by argument, each in the shape of the argument's gradient; (d, ...) for d directions
                of one system at once, (batch, ...) for a batch.
            threads: the number of threads for a batch.
            **parameters: parameters as in `potential_energy`.

        Returns:
            `found.potential_energy`, (), with a leading axis if there are several directions or a batch.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        return self._jvp("potential_energy", (q, object_pose), along, parameters, threads)

    def potential_energy_jacobian(
        self,
        q: Any,
        object_pose: Any,
        *,
        of: Sequence[str] = ("potential_energy",),
        by: Sequence[str] = PLACES,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return the Jacobian of the energy, O(n) + O(l); see `holdfast.dynamics.potential_energy_jacobian`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            object_pose: (7,) wxyz_xyz of the object frame.
            of: the results; there is one, potential_energy.
            by: the arguments; see `holdfast.dynamics.potential_energy_vjp`.
            threads: the number of threads for a batch.
            **parameters: parameters as in `potential_energy`.

        Returns:
            `found["potential_energy", by]` of shape of the argument's gradient, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        return self._derived("potential_energy", "jacobian", (q, object_pose), of, by, {}, parameters, threads)
