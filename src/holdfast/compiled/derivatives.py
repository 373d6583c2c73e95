"""Derivatives of a compiled chain's forward dynamics: products with its Jacobian, and the Jacobian itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, get_args

from holdfast.compiled.bound_derivatives import BoundDerivatives
from holdfast.compiled.compiled_derivatives import CompiledDerivatives, Derivatives
from holdfast.compiled.derivative_schedule import ForwardRequest, Kind
from holdfast.compiled.externals import MOVING
from holdfast.compiled.methods import ChainMethods
from holdfast.dynamics.closed.forward_derivatives import arguments_of, results_of
from holdfast.dynamics.derivatives import STATE_AND_TORQUES
from holdfast.errors import StateError
from holdfast.model import checks


class ChainDerivatives(ChainMethods):
    """The methods of a `CompiledChain` that compute derivatives; their machine code is made when first needed.

    They are the partial derivatives of the map (q, qd, tau, object_pose, object_twist, ...) -> results, in which each
    argument varies independently of the others, so the state may leave the grasp constraint. Along motions that
    satisfy the constraint, derivatives do not depend on how the map is continued off it. Derivatives by a pose are
    (.., 6) [rotation vector; shift]: R -> exp(rotation vector) R about the pose's own origin, along world axes for
    the object and the bases and along the object's axes for grasps. Inertias vary as symmetric matrices. Every method
    also returns forward dynamics, as `result`.
    """

    def forward_dynamics_vjp(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        by: Sequence[str] = STATE_AND_TORQUES,
        out: Derivatives | None = None,
        threads: int = 1,
        **cotangents_and_parameters: Any,
    ) -> Derivatives:
        """Return gradients of sum(cotangent . result) of forward dynamics: one more solve, O(n) + O(l).

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            tau: (n,) joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            by: the arguments whose gradients are wanted: q, qd, tau, object_pose, object_twist, object_wrench,
                gravity, object_mass, object_com, object_inertia, grasp_pose, base_pose, base_twist,
                base_acceleration, armature, damping, link_mass, link_com, link_inertia, link_wrench; with a trunk
                also those that `holdfast.forward_dynamics_vjp` lists.
            out: earlier derivatives of the same request, to be overwritten.
            threads: the number of threads for a batch.
            **cotangents_and_parameters: cotangents of any of qdd (n,), grasp_wrench (arms, 6), object_acceleration
                (6,), contact_acceleration (n_g,), base_wrench (arms, 6), and parameters as in `forward_dynamics`.

        Returns:
            The gradient by every argument, in the shape of the argument. In a batch, gradients of a system without
            a solution are NaN.

        Raises:
            StateError: A name, shape or number is wrong, or a cotangent belongs to forces that are not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        parameters, results = cotangents_and_parameters, self._results
        names = tuple([name for name in parameters if name in results])
        code = self._derivatives("vjp", names, by, parameters)
        cotangents = [parameters.pop(name) for name in code.request.given]
        return code((q, qd, tau, object_pose, object_twist, *cotangents), parameters, out, threads)

    def forward_dynamics_jvp(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        along: Mapping[str, Any],
        of: Sequence[str] | None = None,
        out: Derivatives | None = None,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return directional derivatives of forward dynamics along tangents of its arguments: O(n) + O(l).

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            tau: (n,) joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            along: the tangents by argument, each in the shape of the argument's gradient; (d, ...) for d directions
                of one system at once, (batch, ...) for a batch.
            of: the results whose derivatives are wanted; by default all.
            out: earlier derivatives of the same request, to be overwritten.
            threads: the number of threads for a batch.
            **parameters: parameters as in `forward_dynamics`.

        Returns:
            The derivative of every result, in the shape of the result, with a leading axis if there are several
            directions or a batch.

        Raises:
            StateError: A name, shape or number is wrong, or a requested force is not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        checks.instance(along, Mapping, "forward_dynamics_jvp: along", StateError)
        code = self._derivatives("jvp", self._results if of is None else of, tuple(along), parameters)
        tangents = [along[name] for name in code.request.given]
        return code((q, qd, tau, object_pose, object_twist, *tangents), parameters, out, threads)

    def forward_dynamics_jacobian(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        of: Sequence[str] = ("qdd", "grasp_wrench"),
        by: Sequence[str] = STATE_AND_TORQUES,
        out: Derivatives | None = None,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivatives:
        """Return the Jacobian of forward dynamics.

        It takes O(n^2), as it has O(n^2) entries; for many arms prefer the products `_vjp` and `_jvp`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            tau: (n,) joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            of: the results to differentiate.
            by: the arguments; see `forward_dynamics_vjp`.
            out: earlier derivatives of the same request, to be overwritten.
            threads: the number of threads for a batch.
            **parameters: parameters as in `forward_dynamics`.

        Returns:
            `found[of, by]` of shape (*result's shape, *shape of the argument's gradient), with a leading axis for a
            batch. Each is a view of an array that is stored column by column.

        Raises:
            StateError: A name, shape or number is wrong, or a requested force is not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        code = self._derivatives("jacobian", of, by, parameters)
        return code((q, qd, tau, object_pose, object_twist), parameters, out, threads)

    def bind_derivatives(
        self,
        kind: Kind,
        *,
        of: Sequence[str] = ("qdd", "grasp_wrench"),
        by: Sequence[str] = STATE_AND_TORQUES,
        **arrays_or_parameters: Any,
    ) -> BoundDerivatives:
        """Return derivatives bound to fixed arrays: a call without arguments, for control loops.

        Args:
            kind: `vjp`, `jvp` or `jacobian`, as in the methods `forward_dynamics_vjp` and so on.
            of: the results to differentiate.
            by: the arguments by which they are differentiated.
            **arrays_or_parameters: initial values of q, qd, tau, object_pose, object_twist, and parameters.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        if kind not in get_args(Kind):
            raise StateError(f"bind_derivatives: expected vjp, jvp or jacobian, got {checks.short(kind)}")
        code = self._derivatives(kind, of, by, arrays_or_parameters)
        return BoundDerivatives(self, code, arrays_or_parameters)  # type: ignore[arg-type]

    def derivative_request(self, kind: Kind, of: Sequence[str], by: Sequence[str]) -> ForwardRequest:
        """Return the request for some derivatives, after checking the names.

        Raises:
            StateError: A name is unknown.
        """
        what = f"forward_dynamics_{kind}"
        results, arguments = results_of(self.chain), arguments_of(self.chain)
        for names, known, side in ((of, results, "results"), (by, arguments, "arguments")):
            checks.instance(names, (list, tuple), f"{what}: {side}", StateError)
            if not names:
                raise StateError(f"{what}: expected some {side} of {', '.join(known)}, got none")
            for name in names:
                if name not in known:
                    raise StateError(f"{what}: {side}: no {checks.short(name)}.{checks.did_you_mean(str(name), known)}")
        return ForwardRequest(kind, tuple(n for n in results if n in of), tuple(n for n in arguments if n in by))

    def _derivatives(
        self, kind: Kind, of: Sequence[str], by: Sequence[str], parameters: Mapping[str, Any]
    ) -> CompiledDerivatives:
        """Return the compiled derivatives; they are compiled when first requested."""
        moving = not parameters.keys().isdisjoint(MOVING)
        known: dict[Any, CompiledDerivatives] = self._asked
        try:
            asked = (
                kind,
                type(of),
                tuple(of),
                type(by),
                tuple(by),
                moving,
            )  # types: a string is not a list of names
            return known[asked]
        except (KeyError, TypeError):  # asked for the first time, or no names
            request = self.derivative_request(kind, of, by)
            asked = kind, type(of), tuple(of), type(by), tuple(by), moving

        def make() -> CompiledDerivatives:
            return CompiledDerivatives(self, request, moving)  # type: ignore[arg-type]

        found = known[asked] = self._code((request, moving), f"forward_dynamics_{kind}", make)
        return found

    @cached_property
    def _asked(self) -> dict[Any, CompiledDerivatives]:
        return {}

    @cached_property
    def _results(self) -> tuple[str, ...]:
        """The names of the results that can be differentiated."""
        return results_of(self.chain)
