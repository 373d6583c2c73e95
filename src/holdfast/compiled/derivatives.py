"""Derivatives of a compiled chain's forward dynamics: products with its Jacobian, and the Jacobian itself."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from holdfast.compiled import arrays, statuses
from holdfast.compiled.arrays import Addresses
from holdfast.compiled.derivative_schedule import FOUND, UNITS, WITH, Request, derivative_shapes
from holdfast.compiled.externals import BASE_MOTION, LINKS, MOVING
from holdfast.compiled.kernels import kernel
from holdfast.compiled.not_compiled import NotCompiledError
from holdfast.compiled.parameters import parameters_of, parse_parameters
from holdfast.compiled.result import INDETERMINATE, UNDECIDED, CompiledResult, ResultLayout
from holdfast.compiled.structure import Options, Structure
from holdfast.compiler.kernel import Bound
from holdfast.dynamics.closed.forward_derivatives import ARGUMENTS, RESULTS
from holdfast.dynamics.derivatives import STATE_AND_TORQUES, without_derivatives
from holdfast.dynamics.result import Status
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain

NOT_UNIQUE = ("grasp_wrench", "base_wrench")  # where forces are not


class Derivatives:
    """Derivatives of forward dynamics: by name, `found.q` or `found["q"]`; of a Jacobian `found["qdd", "q"]`.

    Attributes:
        result: forward dynamics there.
        request: what was asked for.
    """

    result: CompiledResult
    request: Request

    def __init__(self, result: CompiledResult, request: Request) -> None:
        self.__dict__.update(result=result, request=request)

    def __getattr__(self, name: str) -> Array:
        """Return the derivatives of one name."""
        if name.startswith("_") or f"{FOUND}{name}" not in self.result.layout.shapes:
            known = [x.removeprefix(FOUND) for x in self.result.layout.shapes if x.startswith(FOUND)]
            raise AttributeError(f"no derivative '{name}'.{checks.did_you_mean(name, known)}")
        return self.result.array(f"{FOUND}{name}")

    def __getitem__(self, name: str | tuple[str, str]) -> Array:
        """Return the derivatives of one name; or of a result by an argument, (*its shape, *the argument's shape)."""
        if isinstance(name, str):
            return getattr(self, name)
        of, by = name
        columns, shapes = getattr(self, f"{of}.{by}"), derivative_shapes(self.result.chain)
        lead = columns.shape[:-2]
        whole = columns.reshape(*lead, *shapes[by], *shapes[of])
        first, middle = len(lead), len(lead) + len(shapes[by])
        order = [*range(first), *range(middle, whole.ndim), *range(first, middle)]
        return whole.transpose(order)


class CompiledDerivatives:
    """Derivatives of forward dynamics as machine code."""

    def __init__(self, compiled: CompiledChain, request: Request, moving: bool) -> None:
        """Compile, or find what is compiled already.

        Args:
            compiled: the chain whose forward dynamics it is of.
            request: which.
            moving: whether bases move.
        """
        self._compiled, self.request, chain = compiled, request, compiled.chain
        structure = Structure(chain, options_of(compiled.options, request, moving))
        self.externals = request.externals(structure)
        self.kernel = kernel(request.name, structure, self.externals, lambda: request.schedule(structure))
        self._lock = threading.Lock()
        own = parameters_of(chain, compiled.generic_rank)
        if UNITS in self.externals:
            own[UNITS] = np.eye(self.externals[UNITS].shape[0])
        self.own = {name: np.array(x, order="C") for name, x in own.items() if name in self.externals}
        self.layout = ResultLayout(self.externals)
        self._addresses = Addresses(self.externals, self.own)

    def __call__(
        self, given: Mapping[str, Any], parameters: Mapping[str, Any], out: Derivatives | None, threads: int
    ) -> Derivatives:
        """Return the derivatives, and forward dynamics beside them.

        Args:
            given: inputs, and what a product is taken with, by the names of `externals`.
            parameters: of this call, by the users' names.
            out: earlier ones to be written over.
            threads: how many threads share a batch.
        """
        compiled, chain = self._compiled, self._compiled.chain
        found = {
            name: arrays.floats(name.removeprefix(WITH), x, self.externals[name].shape) for name, x in given.items()
        }
        if parameters:
            found |= parse_parameters(parameters, self.externals, chain)
        batch = arrays.batch_of(found, self.externals)
        if not isinstance(threads, int) or threads < 1:
            raise StateError(f"threads: expected an integer >= 1, got {threads!r}")
        if out is None:
            result = CompiledResult(chain, self.layout, batch)
        else:
            checks.instance(out, Derivatives, "out", StateError)
            result = out.result
            if out.request != self.request:
                raise StateError("out: expected earlier derivatives of the same names; leave it out first")
            arrays.require_fit(result, chain, batch, list(found.values()))
        self.own["generic_rank"][...] = -1.0 if compiled.generic_rank is None else float(compiled.generic_rank)
        if batch is not None:
            self.kernel.run_batch(self._addresses.table(found, result), batch, threads)
            sound = not result.array("status").any()
        else:
            sound = self._single(found, result)
        if not sound:
            self._settle(found, result)
        return Derivatives(result, self.request)

    def _single(self, found: Mapping[str, Array], result: CompiledResult) -> bool:
        """Run one system; return whether all is well."""
        with self._lock:
            self._bound.use({name: result.array(name) for name in self.layout.shapes})
            for name, x in (self.own | dict(found)).items():
                self._bound.arrays[name][...] = x
            self._bound.prepare()
            return self._bound.run() == 0

    def _settle(self, found: Mapping[str, Array], result: CompiledResult) -> None:
        """Decide open statuses; refuse derivatives of what is not unique, or leave them not-a-number in a batch."""
        own = self.own | dict(found)
        statuses.settle(self._compiled, own, result)
        if result.batch is None:
            statuses.require_answer(self._compiled, own, result)
        low = np.atleast_1d(result.array("status")) == INDETERMINATE
        choices = [name for name in self.request.results if name in NOT_UNIQUE]
        if not low.any() or not choices:
            return
        if result.batch is None:
            others = ", ".join(name for name in RESULTS if name not in NOT_UNIQUE)
            raise StateError(
                f"{choices[0]}: the forces are not unique here, and machine code finds one choice among them, whose"
                f" derivative means nothing; try those of {others}"
            )
        for name in self.request.found(result.chain):
            if self.request.kind == "vjp" or name.partition(".")[0] in choices:
                result.array(f"{FOUND}{name}")[low] = np.nan

    @cached_property
    def _bound(self) -> Bound:
        return self.kernel.bind()


class BoundDerivatives:
    """Write into the inputs, call, read `found`; for one thread at a time.

    Nothing is checked and nothing is raised: the call returns the `Status`, and where that is SINGULAR or INVALID the
    derivatives are not-a-number.

    Attributes:
        arrays: the inputs by name, those of cotangents or tangents under their results' or arguments' names in
            `given`.
        given: what a product is taken with, by name.
        found: the last call's derivatives.
        run: the bare call without arguments: a number, 0 if the status is OK.
    """

    def __init__(self, compiled: CompiledChain, code: CompiledDerivatives, given: Mapping[str, Any]) -> None:
        self._compiled, self._code, self._bound = compiled, code, code.kernel.bind()
        for name, x in code.own.items():
            self._bound.arrays[name][...] = x
        inputs = [name for name, e in code.externals.items() if e.role == "input"]
        self.arrays = {name: self._bound.arrays[name] for name in inputs if not name.startswith(WITH)}
        self.given = {name: self._bound.arrays[f"{WITH}{name}"] for name in code.request.given}
        result = CompiledResult(compiled.chain, code.layout, None)
        self._bound.use({name: result.array(name) for name in code.layout.shapes})
        self.found = Derivatives(result, code.request)
        self.run = self._bound.run
        for name, x in given.items():
            if name in inputs:
                self._bound.arrays[name][...] = arrays.floats(name.removeprefix(WITH), x, code.externals[name].shape)
        self.set(**{name: x for name, x in given.items() if name not in inputs})

    def __call__(self) -> Status:
        """Compute `found` from the inputs."""
        if self.run() == UNDECIDED:
            statuses.settle(self._compiled, self._bound.arrays, self.found.result)
            self._bound.arrays["generic_rank"][...] = float(self._compiled.generic_rank or 0)
            self._bound.prepare()
            self.run()
        return self.found.result.status

    def set(self, **parameters: Any) -> None:
        """Change run-time parameters, named as in `CompiledChain.forward_dynamics`.

        Raises:
            StateError: an unknown name, a wrong shape, a number that is not finite.
        """
        for name, x in parse_parameters(parameters, self._code.externals, self._compiled.chain).items():
            if x.ndim > len(self._code.externals[name].shape):
                raise StateError(f"set: {name}: expected numbers of one system, got a batch of {len(x)}")
            self._bound.arrays[name][...] = x
        self._bound.prepare()


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
            NotCompiledError: the chain has a trunk, bushings, or springs between bodies.
        """
        cotangents = {n: x for n, x in cotangents_and_parameters.items() if n in RESULTS}
        parameters = {n: x for n, x in cotangents_and_parameters.items() if n not in RESULTS}
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
        of: Sequence[str] = RESULTS,
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
            of: the results whose rates are wanted.
            out: earlier ones of the same names to be written over.
            threads: how many threads share a batch.
            **parameters: as in `forward_dynamics`.

        Returns:
            By result how fast it changes, in its shape, with a leading axis of directions or systems if there is one.

        Raises:
            StateError: wrong names, shapes or numbers; forces are wanted that are not unique.
            SingularChainError: for a single call, the constraint's rank drops here.
            NotCompiledError: the chain has a trunk, bushings, or springs between bodies.
        """
        checks.instance(along, Mapping, "forward_dynamics_jvp: along", StateError)
        code = self._derivatives("jvp", of, tuple(along), parameters)
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
            NotCompiledError: the chain has a trunk, bushings, or springs between bodies.
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
            NotCompiledError: the chain has a trunk, bushings, or springs between bodies.
        """
        if kind not in ("vjp", "jvp", "jacobian"):
            raise StateError(f"bind_derivatives: expected vjp, jvp or jacobian, got {kind!r}")
        code = self._derivatives(kind, of, by, arrays_or_parameters)
        return BoundDerivatives(self, code, arrays_or_parameters)  # type: ignore[arg-type]

    def _derivatives(
        self,
        kind: Literal["vjp", "jvp", "jacobian"],
        of: Sequence[str],
        by: Sequence[str],
        parameters: Mapping[str, Any],
    ) -> CompiledDerivatives:
        """Return the code for some derivatives, compiled when first asked for."""
        what = f"forward_dynamics_{kind}"
        lacking = without_derivatives(self.chain)
        if lacking:
            raise NotCompiledError(f"compile: '{what}' of a chain with {lacking} is not there yet")
        if self.chain.springs:
            raise NotCompiledError(
                f"compile: '{what}' of a chain with springs between bodies runs as reference only, since their wrenches"
                f" are made linear apart; holdfast.{what} computes it from the chain"
            )
        for names, known, side in ((of, RESULTS, "results"), (by, ARGUMENTS, "arguments")):
            checks.instance(names, (list, tuple), f"{what}: {side}", StateError)
            if not names:
                raise StateError(f"{what}: expected some {side} of {', '.join(known)}, got none")
            for name in names:
                if name not in known:
                    raise StateError(f"{what}: {side}: no {name!r}.{checks.did_you_mean(str(name), known)}")
        request = Request(kind, tuple(n for n in RESULTS if n in of), tuple(n for n in ARGUMENTS if n in by))
        key = request, any(name in MOVING for name in parameters)
        made: dict[tuple[Request, bool], CompiledDerivatives] = self.__dict__.setdefault("_derivatives_made", {})
        if key not in made:
            made[key] = CompiledDerivatives(self, *key)  # type: ignore[arg-type]
        return made[key]


def options_of(options: Options, request: Request, moving: bool) -> Options:
    """Return the options of derivatives: what is varied must be a run-time parameter."""
    varied = any(name in BASE_MOTION for name in request.arguments)
    return replace(
        options,
        link_inertia=options.link_inertia or any(name in LINKS for name in request.arguments),
        link_wrenches=options.link_wrenches or "link_wrench" in request.arguments,
        base_motion=options.base_motion or moving or varied,
    )
