"""Derivatives of a compiled chain's forward dynamics: products with its Jacobian, and the Jacobian itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from holdfast.compiled.bound_derivatives import BoundDerivatives
from holdfast.compiled.compiled_derivatives import CompiledDerivatives, Derivatives
from holdfast.compiled.derivative_schedule import WITH, Request
from holdfast.compiled.externals import MOVING
from holdfast.compiled.not_compiled import NotCompiledError
from holdfast.compiled.structure import Options
from holdfast.dynamics.closed.forward_derivatives import arguments_of, results_of
from holdfast.dynamics.derivatives import STATE_AND_TORQUES
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain

if TYPE_CHECKING:
    pass


class ChainDerivatives:
    """The methods of a `CompiledChain` that are derivatives; machine code is made when first needed.

    They are those of the map (q, qd, tau, object_pose, object_twist, ...) -> results as it stands, each argument
    varied by itself; along motions of the chain they do not depend on how it is continued beside the grasps. Poses
    turn by R -> exp(turn) R and shift, those of the object and the bases about their origins along world axes, those
    of grasps along the object's axes: wherever a pose is differentiated by, its part is (.., 6) [turn; shift].
    Inertias are varied as symmetric matrices. `result` of what is returned is forward dynamics.

    Attributes:
        chain: the chain.
        options: what was chosen when it was compiled.
    """

    chain: ClosedChain
    options: Options

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
            qd: joint rates.
            tau: joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            by: the arguments whose gradients are wanted: q, qd, tau, object_pose, object_twist, object_wrench,
                gravity, object_mass, object_com, object_inertia, grasp_pose, base_pose, base_twist,
                base_acceleration, armature, damping, link_mass, link_com, link_inertia, link_wrench.
            out: earlier ones of the same names to be written over.
            threads: how many threads share a batch.
            **cotangents_and_parameters: cotangents of any of qdd (n,), grasp_wrench (arms, 6), object_acceleration
                (6,), contact_acceleration (n_g,), base_wrench (arms, 6), and parameters as in `forward_dynamics`.

        Returns:
            By argument its gradient, in its shape. In a batch, a system without an answer has not-a-number.

        Raises:
            StateError: wrong names, shapes or numbers; a cotangent of forces that are not unique.
            SingularChainError: for a single call, the constraint's rank drops here.
            NotCompiledError: the chain has springs between bodies.
        """
        results = results_of(self.chain)
        cotangents = {n: x for n, x in cotangents_and_parameters.items() if n in results}
        parameters = {n: x for n, x in cotangents_and_parameters.items() if n not in results}
        code = self._derivatives("vjp", tuple(cotangents), by, parameters)
        given = dict(zip(STATE_AND_TORQUES, (q, qd, tau, object_pose, object_twist), strict=True))
        return code(given | {f"{WITH}{n}": x for n, x in cotangents.items()}, parameters, out, threads)

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
        """Return how fast the results of forward dynamics change while arguments do: one more solve, O(n) + O(l).

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: joint rates.
            tau: joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            along: by argument, how fast it changes, of the shape of its gradient; of one system (d, ...) for d
                directions at once, of a batch (batch, ...).
            of: the results whose rates are wanted; all by default.
            out: earlier ones of the same names to be written over.
            threads: how many threads share a batch.
            **parameters: as in `forward_dynamics`.

        Returns:
            By result how fast it changes, in its shape, with a leading axis of directions or systems if there is one.

        Raises:
            StateError: wrong names, shapes or numbers; forces are wanted that are not unique.
            SingularChainError: for a single call, the constraint's rank drops here.
            NotCompiledError: the chain has springs between bodies.
        """
        checks.instance(along, Mapping, "forward_dynamics_jvp: along", StateError)
        code = self._derivatives("jvp", results_of(self.chain) if of is None else of, tuple(along), parameters)
        given = dict(zip(STATE_AND_TORQUES, (q, qd, tau, object_pose, object_twist), strict=True))
        return code(given | {f"{WITH}{n}": x for n, x in along.items()}, parameters, out, threads)

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
        """Return the Jacobian of forward dynamics. O(n^2), as its entries are; many arms want products instead.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: joint rates.
            tau: joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            of: the results.
            by: the arguments; see `forward_dynamics_vjp`.
            out: earlier ones of the same names to be written over.
            threads: how many threads share a batch.
            **parameters: as in `forward_dynamics`.

        Returns:
            `found[of, by]`, (*shape of the result, *shape of the argument's gradient), a leading axis for a batch;
            each is a view of an array that holds one column after the other.

        Raises:
            StateError: wrong names, shapes or numbers; forces are wanted that are not unique.
            SingularChainError: for a single call, the constraint's rank drops here.
            NotCompiledError: the chain has springs between bodies.
        """
        code = self._derivatives("jacobian", of, by, parameters)
        given: dict[str, Any] = dict(zip(STATE_AND_TORQUES, (q, qd, tau, object_pose, object_twist), strict=True))
        return code(given, parameters, out, threads)

    def bind_derivatives(
        self,
        kind: Literal["vjp", "jvp", "jacobian"],
        *,
        of: Sequence[str] = ("qdd", "grasp_wrench"),
        by: Sequence[str] = STATE_AND_TORQUES,
        **arrays_or_parameters: Any,
    ) -> BoundDerivatives:
        """Return derivatives tied to arrays that stay: a call without arguments, for control loops.

        Args:
            kind: of `forward_dynamics_vjp`, `forward_dynamics_jvp` or `forward_dynamics_jacobian`.
            of: the results.
            by: the arguments.
            **arrays_or_parameters: first values of q, qd, tau, object_pose, object_twist, and parameters.

        Raises:
            StateError: wrong names, shapes or numbers.
            NotCompiledError: the chain has springs between bodies.
        """
        if kind not in ("vjp", "jvp", "jacobian"):
            raise StateError(f"bind_derivatives: expected vjp, jvp or jacobian, got {kind!r}")
        code = self._derivatives(kind, of, by, arrays_or_parameters)
        return BoundDerivatives(self, code, arrays_or_parameters)  # type: ignore[arg-type]

    def derivative_request(
        self, kind: Literal["vjp", "jvp", "jacobian"], of: Sequence[str], by: Sequence[str]
    ) -> Request:
        """Return which derivatives are asked for.

        Raises:
            StateError: unknown names.
            NotCompiledError: machine code has none of this chain.
        """
        what = f"forward_dynamics_{kind}"
        if self.chain.springs:
            raise NotCompiledError(
                f"compile: '{what}' of a chain with springs between bodies runs as reference only, since their wrenches"
                f" are made linear apart; holdfast.{what} computes it from the chain"
            )
        results, arguments = results_of(self.chain), arguments_of(self.chain)
        for names, known, side in ((of, results, "results"), (by, arguments, "arguments")):
            checks.instance(names, (list, tuple), f"{what}: {side}", StateError)
            if not names:
                raise StateError(f"{what}: expected some {side} of {', '.join(known)}, got none")
            for name in names:
                if name not in known:
                    raise StateError(f"{what}: {side}: no {name!r}.{checks.did_you_mean(str(name), known)}")
        return Request(kind, tuple(n for n in results if n in of), tuple(n for n in arguments if n in by))

    def _derivatives(
        self,
        kind: Literal["vjp", "jvp", "jacobian"],
        of: Sequence[str],
        by: Sequence[str],
        parameters: Mapping[str, Any],
    ) -> CompiledDerivatives:
        """Return the code for some derivatives, compiled when first asked for."""
        request = self.derivative_request(kind, of, by)
        key = request, any(name in MOVING for name in parameters)
        made: dict[tuple[Request, bool], CompiledDerivatives] = self.__dict__.setdefault("_derivatives_made", {})
        if key not in made:
            made[key] = CompiledDerivatives(self, *key)  # type: ignore[arg-type]
        return made[key]
