"""Compile the dynamics of one chain to machine code (`holdfast.compile`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from holdfast import outer
from holdfast.compiled import arrays, statuses
from holdfast.compiled.bound_dynamics import BoundDynamics
from holdfast.compiled.calls import Calls
from holdfast.compiled.closure_derivatives import ClosureDerivatives
from holdfast.compiled.derivatives import ChainDerivatives
from holdfast.compiled.externals import FLOATING, MOVING
from holdfast.compiled.force_derivatives import ForceDerivatives
from holdfast.compiled.forward_schedule import forward_externals, forward_schedule
from holdfast.compiled.function_derivatives import FunctionDerivatives
from holdfast.compiled.functions import ChainFunctions
from holdfast.compiled.kernels import compile_batch, compiling, kernel
from holdfast.compiled.parameters import parameters_of, parse_parameters, require_inputs
from holdfast.compiled.result import CompiledResult
from holdfast.compiled.structure import Options, Structure, optional_parameters, require_rank
from holdfast.compiler.kernel import Bound
from holdfast.compiler.targets import Builtin
from holdfast.dynamics.closed.tip_response import Route
from holdfast.dynamics.methods import method_named
from holdfast.errors import MethodNotApplicable
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.codegen.export import ExportedCode

_INPUTS = ("q", "qd", "tau", "object_pose", "object_twist")
_DOC = "Return accelerations and grasp forces; see `CompiledChain.forward_dynamics`."


def compile(
    chain: ClosedChain,
    *,
    dtype: str = "float64",
    method: str = "auto",
    parameters: Sequence[str] = (),
    generic_rank: int | None = None,
    progress: bool = False,
) -> CompiledChain:
    """Compile the dynamics of a chain to machine code.

    Joints, link inertias and tip frames become constants of the code. Bases, grasp frames, the object's inertia and
    gravity are run-time parameters, so chains that differ only in these share their code. Code is cached on disk
    (`HOLDFAST_CACHE` is a folder, or `off`). It is made for this processor, or for the one that `HOLDFAST_CPU` names.

    Args:
        chain: arms, object and grasps.
        dtype: the number type; only `float64` is supported.
        method: how the inverse inertia at each arm's tip is computed: `recursive` (articulated-body recursion),
            `mass_matrix` (by factorisation), or `auto`, which chooses one for each arm.
        parameters: further run-time parameters: `link_inertia` (adds link_mass, link_com and link_inertia, and
            with a trunk trunk_link_mass, trunk_link_com and trunk_link_inertia of its bodies, a floating base first)
            and `link_wrench` (external wrenches on the links).
        generic_rank: the rank of the grasp constraint away from singular configurations. If it is None, it is
            determined when it first matters.
        progress: whether to show, in a notebook or on a terminal, that machine code is made and how long it took; also
            that of derivatives and of other functions, which is made when they are first called.

    Returns:
        The chain's dynamics as functions of arrays, for one system or a batch.

    Raises:
        MethodNotApplicable: `method` or `dtype` is not available in machine code.
        CompileError: The machine code cannot be made on this computer.
    """
    checks.instance(chain, ClosedChain, "compile: chain")
    require_rank(generic_rank, chain, "compile")
    checks.instance(method, str, "compile: method", MethodNotApplicable)
    if dtype != "float64":
        raise MethodNotApplicable(f"compile: dtype: expected float64, got {checks.short(dtype)}")
    if method not in ("sequential", *get_args(Route)):
        name = method_named(method).name
        raise MethodNotApplicable(
            f"compile: '{name}' runs as reference only; machine code is made of `sequential` (same answers). Try"
            " method='auto', 'recursive' or 'mass_matrix'"
        )
    route: Route = "auto" if method == "sequential" else method  # type: ignore[assignment]
    options = optional_parameters(parameters, "compile", route)
    with compiling(chain, "the dynamics", progress):
        return CompiledChain(chain, options, generic_rank, progress)


class CompiledChain(ChainFunctions, ChainDerivatives, FunctionDerivatives, ClosureDerivatives, ForceDerivatives):
    """The dynamics of one chain as machine code; made by `holdfast.compile`.

    Attributes:
        chain: the chain.
        options: the options with which it was compiled.
        generic_rank: the rank of the grasp constraint away from singular configurations, or None while unknown.
        externals: the arrays that forward dynamics reads and writes, by name.
        calls: the calls of the machine code of forward dynamics.
        progress: whether to show that machine code is made.
    """

    def __init__(self, chain: ClosedChain, options: Options, generic_rank: int | None, progress: bool = False) -> None:
        self.chain, self.options, self.generic_rank, self.progress = chain, options, generic_rank, progress
        structure = Structure(chain, options)
        self.externals = forward_externals(structure)
        code = kernel("forward", structure, self.externals, lambda: forward_schedule(structure))
        self.calls = Calls(code, parameters_of(chain, generic_rank))
        by_name = FLOATING if chain.floats else ()
        inputs = *_INPUTS, *by_name  # these come first among the external arrays
        self._shapes = [(name, self.externals[name].shape) for name in inputs]
        self._builtin = Builtin(
            code.single_address,
            self.calls.own_table(),
            [shape for _, shape in self._shapes],
            self.forward_dynamics,
            "forward_dynamics",
            "(q, qd, tau, object_pose, object_twist, *, out=None, threads=1, **parameters)",
            _DOC,
            inputs,
            len(by_name),
        )
        # The builtin runs calls that repeat `out` in machine code and passes all others to the method.
        self.forward_dynamics = self._builtin.function  # type: ignore[method-assign]

    def forward_dynamics(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        out: CompiledResult | None = None,
        threads: int = 1,
        **parameters: Any,
    ) -> CompiledResult:
        """Return joint accelerations, the wrench at every grasp and the object's acceleration.

        The results are those of `holdfast.forward_dynamics`, for one system or a batch. Any argument may have a
        leading batch axis; arguments without it are shared by all systems. The state is used as given, whether or not
        it satisfies the grasps (see `closure`). Results do not depend on batch size or number of threads, bit for bit.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            tau: (n,) joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            out: an earlier result to be overwritten; single calls that reuse it are the fastest.
            threads: the number of threads for a batch.
            **parameters: values for this call of object_wrench (6,), gravity (3,), object_mass (), object_com (3,),
                object_inertia (3, 3), base_pose (arms, 7), base_twist and base_acceleration (arms, 6), grasp_pose
                (grasps, 7), and the parameters added in `compile`. A trunk adds trunk_base_twist and
                trunk_base_acceleration (6,). A floating base requires floating_pose (7,) and floating_twist (6,)
                instead. An object_mass requires an object_inertia; "scale" scales the chain's own with the mass.

        Returns:
            A `ForwardResult`. In a batch every system has its own `status`; all other results of systems that are
            SINGULAR or INVALID are NaN, and no error is raised for them.

        Raises:
            StateError: A shape is wrong; for a single system, also if a number is not finite.
            SingularChainError: The configuration of a single system is singular.
        """
        if not self.options.base_motion and any(name in parameters for name in MOVING):
            result = self.moving.forward_dynamics(
                q, qd, tau, object_pose, object_twist, out=out, threads=threads, **parameters
            )
            if self.generic_rank is None and self.moving.generic_rank is not None:
                self.set_generic_rank(self.moving.generic_rank)
            return result
        given = [q, qd, tau, object_pose, object_twist]
        if self.chain.floats:
            require_inputs(FLOATING, parameters)
            given += [parameters.pop(name) for name in FLOATING]
        found = {name: arrays.floats(name, x, shape) for (name, shape), x in zip(self._shapes, given, strict=True)}
        if parameters:
            found |= parse_parameters(parameters, self.externals, self.chain)
        batch = arrays.batch_of(found, self.externals)
        arrays.require_threads(threads)
        result = CompiledResult(self.chain, self.calls.layout, batch) if out is None else out
        if out is not None:
            arrays.require_fit(out, self.chain, batch)
            if batch is None and len(found) == len(self._shapes):
                self._builtin.expect(out, out.memory, self.calls.row(found, result)[len(found) :])
        if batch is not None:
            compile_batch(self.calls.kernel, self.chain, "the dynamics", self.progress)
        if not self.calls(found, result, threads):
            found = self.calls.own | found | _origins(parameters)
            statuses.resolve_undecided(self, found, result)
            if batch is None:
                statuses.require_answer(self, found, result)
        return result

    def bind(self, **arrays_or_parameters: Any) -> BoundDynamics:
        """Return forward dynamics bound to fixed arrays: a call without arguments, for control loops.

        Args:
            **arrays_or_parameters: arrays of the caller for q, qd, tau, object_pose, object_twist or object_wrench,
                which are read at every call (float64, C order); new arrays are made for the others. Parameters are
                given as in `forward_dynamics`.
        """
        if not self.options.base_motion and any(name in arrays_or_parameters for name in MOVING):
            return self.moving.bind(**arrays_or_parameters)
        return BoundDynamics(self, self.calls, arrays_or_parameters)

    def export(self, folder: str | PathLike[str], **options: Any) -> ExportedCode:
        """Write computations of the chain as C or object files that run without Python.

        Args:
            folder: the folder to which the files are written.
            **options: the keyword arguments of `holdfast.codegen.export_c`, such as name, functions and target;
                progress is by default that of `holdfast.compile`.

        Raises:
            HoldfastError: `holdfast.codegen.export_c` raised it.
        """
        return outer.export_c(self, folder, **{"progress": self.progress, **options})

    @cached_property
    def moving(self) -> CompiledChain:
        """The same chain compiled for moving bases; it is made when the motion of a base is first given."""
        return CompiledChain(self.chain, replace(self.options, base_motion=True), self.generic_rank, self.progress)

    def __repr__(self) -> str:
        """Return a short description that names the chain."""
        return f"<CompiledChain of {self.chain!r}>"

    @property
    def operation_count(self) -> int:
        """The number of arithmetic operations of forward dynamics for one system, including its parameters'."""
        return self.calls.kernel.operation_count

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to unpickle the object: its machine code is loaded from the cache or compiled again."""
        return CompiledChain, (self.chain, self.options, self.generic_rank, self.progress)

    def bound(self) -> Bound:
        """Return the kernel bound to new arrays, with the chain's own parameters."""
        return self.calls.bind()

    def set_generic_rank(self, generic_rank: int) -> None:
        """Store the generic rank, so that later calls can decide every status by themselves."""
        self.generic_rank = generic_rank
        self.calls.set_rank(generic_rank)


def _origins(parameters: Mapping[str, Any]) -> dict[str, Array]:
    """Return the positions of given bases, which only the search for the generic rank needs."""
    given = parameters.get("base_pose")
    return {} if given is None else {"base_p": np.array(given, dtype=float)[..., 4:]}
