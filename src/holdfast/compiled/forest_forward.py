"""Forward dynamics of a compiled forest as a function with its derivatives; each is made when it is first asked for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, cast

import numpy as np

from holdfast.compiled.bound import BoundFunction
from holdfast.compiled.derivative_schedule import WITH
from holdfast.compiled.derivatives import CompiledDerivatives
from holdfast.compiled.forest_function import ForestFunction
from holdfast.compiled.forest_request import OF_CLOSURES, ForestRequest, require_unique
from holdfast.compiled.forest_terms import CompiledForestResult, CompiledMechanismResult, of_objects
from holdfast.compiled.function import Function
from holdfast.compiled.result import INDETERMINATE
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.names import called
from holdfast.questions.arrays import Shape
from holdfast.questions.derivatives import Derivatives, require_names
from holdfast.spatial.scalar import Array

Kind = Literal["vjp", "jvp"]


class ForwardFunction:
    """Forward dynamics by machine code, for one system or a batch, and its derivatives.

    Attributes:
        function: what calls the machine code.
    """

    def __init__(self, function: ForestFunction) -> None:
        self.function = function
        self._made: dict[ForestRequest, ForestFunction] = {}

    def arrays(self, *given: Any, **further: Any) -> dict[str, Any]:
        """Return the arrays of a call by name."""
        raise NotImplementedError

    def vjp(
        self,
        *given: Any,
        by: Sequence[str] | None = None,
        out: CompiledDerivatives | None = None,
        threads: int | None = None,
        **cotangents_and_further: Any,
    ) -> CompiledDerivatives:
        """Return the gradients of sum(cotangent . result), with forward dynamics at most twice its cost.

        Where forces are not unique, gradients by q, qd, poses and twists depend off motions on which of the forces are
        found, and differ from those of the reference; products with tangents that keep the closures do not.

        Args:
            *given: the arguments of a call, in order or by name.
            by: the arguments of which gradients are returned, as for the reference; by default q, qd and tau, and of a
                chain also object_pose and object_twist.
            out: earlier derivatives of the same names, to be overwritten.
            threads: as in a call.
            **cotangents_and_further: cotangents by result, and what a call takes by name.

        Returns:
            The gradient by every argument, in the shape of the argument; by poses (.., 6) [turn; shift]. In a batch,
            gradients of a system without an answer are NaN.

        Raises:
            StateError: A name, shape or number is wrong, or a cotangent belongs to forces that are not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        further, results = cotangents_and_further, self.function.terms.outputs
        cotangents = {name: further.pop(name) for name in results if name in further}
        require_names(f"{self.function.name}.vjp: cotangents", tuple(cotangents), [*results])
        by = self.function.terms.by if by is None else by
        return self._with("vjp", tuple(cotangents), by, cotangents, self.arrays(*given, **further), out, threads)

    def jvp(
        self,
        *given: Any,
        along: Mapping[str, Any] | None = None,
        of: Sequence[str] | None = None,
        out: CompiledDerivatives | None = None,
        threads: int | None = None,
        **further: Any,
    ) -> CompiledDerivatives:
        """Return the rates of the results along tangents of the arguments; where forces are not unique, see `vjp`.

        Args:
            *given: the arguments of a call, in order or by name.
            along: the tangents by argument, each in the shape of the argument's gradient; (d, ...) for d directions of
                one system at once, (batch, ...) for a batch.
            of: the results; by default all.
            out: earlier derivatives of the same names, to be overwritten.
            threads: as in a call.
            **further: what a call takes by name.

        Returns:
            The rate of every result, in the shape of the result, with a leading axis if there are several directions
            or a batch.

        Raises:
            StateError: A name, shape or number is wrong, or a requested force is not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        checks.instance(along, Mapping, f"{self.function.name}.jvp: along", StateError)
        assert along is not None
        of = tuple(self.function.terms.outputs) if of is None else of
        return self._with("jvp", of, tuple(along), along, self.arrays(*given, **further), out, threads)

    def jacobian(
        self,
        *given: Any,
        of: Sequence[str] | None = None,
        by: Sequence[str] | None = None,
        threads: int | None = None,
        **further: Any,
    ) -> Derivatives:
        """Return the Jacobian: the rates along all unit tangents as a batch of the machine code of `jvp`.

        Args:
            *given: the arguments of a call, in order or by name.
            of: the results; by default qdd and the wrenches of grasps or closures.
            by: the arguments; by default those of `vjp`.
            threads: as in a call.
            **further: what a call takes by name.

        Returns:
            `found[of, by]`, with the axes of the result and then those of the argument's gradient; a batch comes first.

        Raises:
            StateError: A name, shape or number is wrong, or a requested force is not unique.
            SingularChainError: The configuration of a single system is singular.
        """
        terms = self.function.terms
        of, by = terms.of if of is None else of, terms.by if by is None else by
        made = self.derived("jvp", of, by)
        own = {name: x for name, x in self.arrays(*given, **further).items() if x is not None}
        result = self.function(own, None, threads)
        if result.batch is None and result.array("status") == INDETERMINATE:
            for name in OF_CLOSURES:
                if name in of:
                    require_unique(terms, name)
        shapes = {name: terms.arguments_by[name].shape for name in by}
        units, count = unit_tangents(shapes), 1 if result.batch is None else result.batch
        size = sum(math.prod(shape) for shape in shapes.values())
        tangents = {f"{WITH}{name}": np.concatenate([x] * count) for name, x in units.items()}
        ranks = {name: len(self.function.externals[name].shape) for name in own}
        several = {name: np.repeat(x, size, axis=0) if np.ndim(x) > ranks[name] else x for name, x in own.items()}
        found, parts = made(several | tangents, None, threads), {}
        for name in of:
            columns = np.moveaxis(found[name].reshape(count, size, *terms.outputs[name]), 1, -1)
            blocks = np.split(columns, np.cumsum([math.prod(shape) for shape in shapes.values()])[:-1], axis=-1)
            for (argument, shape), block in zip(shapes.items(), blocks, strict=True):
                part = block.reshape(*block.shape[:-1], *shape)
                parts[name, argument] = part[0] if result.batch is None else part
        return Derivatives(result, parts)

    def bind(
        self,
        kind: Kind | None = None,
        *,
        of: Sequence[str] | None = None,
        by: Sequence[str] | None = None,
        **inputs: Array,
    ) -> BoundFunction:
        """Return the function, or derivatives of it, bound to fixed arrays: a call without arguments.

        Args:
            kind: `vjp` or `jvp`; None for the answer.
            of: the results that are differentiated; by default qdd and the wrenches of grasps or closures.
            by: the arguments by which they are differentiated; by default those of `vjp`.
            **inputs: arrays of the caller for the arguments (float64, C order), which are read at every call; new
                arrays are made for the others.

        Raises:
            StateError: a name or shape is wrong.
        """
        if kind is None:
            return BoundFunction(cast(Function, self.function), inputs)
        if kind not in ("vjp", "jvp"):
            raise StateError(f"{self.function.name}.bind: expected vjp or jvp, got {checks.short(kind)}")
        terms = self.function.terms
        made = self.derived(kind, terms.of if of is None else of, terms.by if by is None else by)
        return BoundFunction(cast(Function, made), inputs)

    def derived(self, kind: Kind, of: Sequence[str], by: Sequence[str]) -> ForestFunction:
        """Return the function of some derivatives; its machine code is made when it is first requested."""
        own, terms = self.function, self.function.terms
        require_names(f"{own.name}.{kind}", of, [*terms.outputs])
        require_names(f"{own.name}.{kind}", by, [*terms.arguments_by])
        results, arguments = ([name for name in known if name in names] for known, names in (
            (terms.outputs, of), (terms.arguments_by, by)
        ))  # fmt: skip
        request = ForestRequest(kind, tuple(results), tuple(arguments))
        if request not in self._made:
            self._made[request] = own.of(request)
        return self._made[request]

    def _with(
        self,
        kind: Kind,
        of: Sequence[str],
        by: Sequence[str],
        vectors: Mapping[str, Any],
        given: Mapping[str, Any],
        out: Any,
        threads: int | None,
    ) -> CompiledDerivatives:
        made = self.derived(kind, of, by)
        return made({**given, **{f"{WITH}{name}": x for name, x in vectors.items()}}, out, threads)


def unit_tangents(shapes: Mapping[str, Shape]) -> dict[str, Array]:
    """Return the unit tangents of some arguments, one after the other, (numbers, *shape) each."""
    sizes = [math.prod(shape) for shape in shapes.values()]
    units = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1], axis=1)
    return {name: x.reshape(sum(sizes), *shape) for (name, shape), x in zip(shapes.items(), units, strict=True)}


@called
class ForestForward(ForwardFunction):
    """Forward dynamics of a compiled forest: `compiled.forward_dynamics(q, qd, tau)`, and its derivatives."""

    def __call__(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        *,
        link_wrench: Any = None,
        out: CompiledForestResult | None = None,
        threads: int | None = None,
    ) -> CompiledForestResult:
        """Return the accelerations and forces of one system or a batch, as `forest_dynamics` does.

        Any argument may have a leading batch axis; those without it are shared. Results do not depend on batch size or
        number of threads, bit for bit. Closures need not be satisfied. In a batch, systems without an answer have a bad
        status, and NaN as results.

        Args:
            q: (n_q,) positions, in the order of the bodies (`Forest`).
            qd: (n_v,) rates.
            tau: (n_v,) torques [N m or N]; for a free body, a wrench about its frame's origin.
            link_wrench: (bodies, 6) external wrenches about the origins of the bodies' frames; only if it was compiled
                with parameters=["link_wrench"], zero by default.
            out: an earlier result, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.

        Raises:
            StateError: a shape or a number is wrong.
            SingularChainError: no accelerations of a single system satisfy the closures, in a singular posture.
            ModelError: a joint of a single system has nothing beyond it that resists its acceleration.
        """
        return self.function(self.arrays(q, qd, tau, link_wrench=link_wrench), out, threads)

    def arrays(self, q: Any, qd: Any, tau: Any, *, link_wrench: Any = None) -> dict[str, Any]:  # type: ignore[override]
        """Return the arrays of a call by name; for arguments see a call."""
        return {"q": q, "qd": qd, "tau": tau, "link_wrench": link_wrench}


@called
class MechanismForward(ForwardFunction):
    """Forward dynamics of a compiled chain with branches: `compiled.forward_dynamics(q, qd, tau, ...)`."""

    def __call__(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        object_pose: Any = None,
        object_twist: Any = None,
        *,
        out: CompiledMechanismResult | None = None,
        threads: int | None = None,
        **further: Any,
    ) -> CompiledMechanismResult:
        """Return the accelerations and forces of one system or a batch, as `forward_dynamics` does.

        Any argument may have a leading batch axis; those without it are shared. Results do not depend on batch size or
        number of threads, bit for bit. Closures need not be satisfied. In a batch, systems without an answer have a bad
        status, and NaN as results.

        Args:
            q: positions of the joints, a trunk's first and then those of the arms in order [rad or m]; four numbers
                (w, x, y, z) of a spherical joint.
            qd: (n,) rates of the joints.
            tau: (n,) torques of the drives; 0 for passive joints [N m or N].
            object_pose: (7,) wxyz_xyz of the object, or (k, 7) of k objects; None without objects.
            object_twist: (6,) its twist, or (k, 6) of k objects.
            out: an earlier result, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **further: object_wrench, (6,) or (k, 6); with a floating base floating_pose (7,) and floating_twist (6,);
                if it was compiled with parameters=["link_wrench"], link_wrench (links of the arms, 6) and with a trunk
                trunk_link_wrench; about the origins of frames, world axes. Wrenches are zero by default.

        Raises:
            StateError: a shape or a number is wrong, or a passive joint has a torque.
            SingularChainError: no accelerations of a single system satisfy the closures, in a singular posture.
            ModelError: a joint of a single system has nothing beyond it that resists its acceleration.
        """
        return self.function(self.arrays(q, qd, tau, object_pose, object_twist, **further), out, threads)

    def arrays(  # type: ignore[override]
        self, q: Any, qd: Any, tau: Any, object_pose: Any = None, object_twist: Any = None, **further: Any
    ) -> dict[str, Any]:
        """Return the arrays of a call by name; for arguments see a call."""
        own = of_objects(self.function.chain, object_pose=object_pose, object_twist=object_twist)
        return {"q": q, "qd": qd, "tau": tau, **own, **further}
