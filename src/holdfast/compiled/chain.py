"""`holdfast.compile`: the dynamics of one chain as machine code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from holdfast.compiled import arrays, statuses
from holdfast.compiled.bound_dynamics import BoundDynamics
from holdfast.compiled.calls import Calls
from holdfast.compiled.derivatives import ChainDerivatives
from holdfast.compiled.externals import FLOATING, MOVING
from holdfast.compiled.forward_schedule import forward_externals, forward_schedule
from holdfast.compiled.functions import ChainFunctions
from holdfast.compiled.kernels import kernel
from holdfast.compiled.parameters import parameters_of, parse_parameters, require_floating
from holdfast.compiled.result import CompiledResult
from holdfast.compiled.structure import Options, Structure, optional_parameters
from holdfast.compiler.kernel import Bound
from holdfast.compiler.schedule import External
from holdfast.compiler.targets import Builtin
from holdfast.dynamics.closed.tip_response import Route
from holdfast.dynamics.methods import method_named
from holdfast.errors import MethodNotApplicable, StateError
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
) -> CompiledChain:
    """Compile the dynamics of a chain to machine code.

    Joints, link inertias and tips are folded into the code. Bases, grasp frames, the object's
    inertia and gravity are run-time parameters: a chain that differs in nothing else has its code
    at once. Code is kept on disk (`HOLDFAST_CACHE=off` or a folder). It is made for this processor, or for
    the one that `HOLDFAST_CPU` names.

    Args:
        chain: arms, object and grasps.
        dtype: float64.
        method: `auto`, or `recursive` or `mass_matrix`: how each arm answers at its tip.
        parameters: what else shall be a run-time parameter: `link_inertia` (link_mass, link_com,
            link_inertia), `link_wrench` (external wrenches on the links).
        generic_rank: rank of the grasp constraint away from singular configurations; found when
            it first matters if not given.

    Returns:
        The chain's dynamics as functions of arrays, for one system or a batch.

    Raises:
        MethodNotApplicable: another algorithm, or another number type.
        CompileError: this computer cannot.
    """
    checks.instance(chain, ClosedChain, "compile: chain")
    if generic_rank is not None:
        whole = isinstance(generic_rank, int | np.integer) and not isinstance(generic_rank, bool)
        if not whole or not 0 <= generic_rank <= chain.constraint_row_count:
            raise StateError(
                f"compile: generic_rank: expected an integer from 0 to {chain.constraint_row_count}, the rows of the"
                f" grasps, or None, got {checks.short(generic_rank)}"
            )
    checks.instance(method, str, "compile: method", MethodNotApplicable)
    if dtype != "float64":
        raise MethodNotApplicable(f"compile: dtype: expected float64, got {dtype!r}")
    if method not in ("sequential", *get_args(Route)):
        name = method_named(method).name
        raise MethodNotApplicable(
            f"compile: '{name}' runs as reference only; machine code is made of `sequential` (same answers). Try"
            " method='auto', 'recursive' or 'mass_matrix'"
        )
    route: Route = "auto" if method == "sequential" else method  # type: ignore[assignment]
    return CompiledChain(chain, optional_parameters(parameters, "compile", route), generic_rank)


class CompiledChain(ChainFunctions, ChainDerivatives):
    """The dynamics of one chain as machine code; made by `holdfast.compile`.

    Attributes:
        chain: the chain.
        options: what was chosen when it was compiled.
        generic_rank: rank of the grasp constraint in general, or None while it is not known.
        calls: of forward dynamics.
    """

    def __init__(self, chain: ClosedChain, options: Options, generic_rank: int | None) -> None:
        self.chain, self.options, self.generic_rank = chain, options, generic_rank
        structure = Structure(chain, options)
        self._externals = forward_externals(structure)
        code = kernel("forward", structure, self._externals, lambda: forward_schedule(structure))
        self.calls = Calls(code, parameters_of(chain, generic_rank))
        by_name = FLOATING if chain.floats else ()
        self._inputs = *_INPUTS, *by_name  # the first of the externals
        self._builtin = Builtin(
            code.single_address,
            self.calls.own_table(),
            [self._externals[name].size for name in self._inputs],
            self._forward,
            "forward_dynamics",
            "(q, qd, tau, object_pose, object_twist, *, out=None, threads=1, **parameters)",
            _DOC,
            by_name,
        )
        # the builtin takes the calls that repeat `out`; all others come back to `_forward`
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
        """Return joint accelerations, the force at every grasp and the object's acceleration.

        The same answers as `holdfast.forward_dynamics`, for one system or a batch (a leading axis
        on any argument; those without it are shared). The state is taken as it is: `closure` tells
        how well it satisfies the grasps. Bits do not depend on batch size or threads.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: joint rates.
            tau: joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            out: an earlier result to be written over; a single call with it costs least.
            threads: how many threads share a batch.
            **parameters: for this call, any of object_wrench (6,), gravity (3,), object_mass (),
                object_com (3,), object_inertia (3, 3), base_pose (arms, 7), base_twist and
                base_acceleration (arms, 6), grasp_pose (grasps, 7), and those asked for in `compile`; with a
                trunk also trunk_base_twist and trunk_base_acceleration (6,), or floating_pose (7,) and
                floating_twist (6,) of its floating base, which are needed then. With an object_mass
                goes an object_inertia, or "scale" for it: the chain's own, in proportion to the mass.

        Returns:
            A `ForwardResult`. In a batch every system has its `status`, and those that are SINGULAR
            or INVALID have not-a-number for all else; nothing is raised on their account.

        Raises:
            StateError: wrong shapes; for a single call also numbers that are not finite.
            SingularChainError: for a single call, the constraint's rank drops here.
        """
        return self._forward(q, qd, tau, object_pose, object_twist, out=out, threads=threads, **parameters)

    def bind(self, **arrays_or_parameters: Any) -> BoundDynamics:
        """Return forward dynamics tied to arrays that stay: a call without arguments, for control loops.

        Args:
            **arrays_or_parameters: q, qd, tau, object_pose, object_twist, object_wrench: arrays of the
                caller's to read at every call (float64, C order), for those not given there are new
                ones; parameters as in `forward_dynamics`.
        """
        if not self.options.base_motion and any(name in arrays_or_parameters for name in MOVING):
            return self.moving.bind(**arrays_or_parameters)
        return BoundDynamics(self, self.calls, arrays_or_parameters)

    def export(self, folder: str | PathLike[str], **options: Any) -> ExportedCode:
        """Write computations of the chain as C or object files that run without Python.

        Args:
            folder: where to.
            **options: as for `holdfast.codegen.export_c`: name, functions, laws, target, source, state and others.

        Raises:
            HoldfastError: as there.
        """
        from holdfast.codegen.export import export_c

        return export_c(self, folder, **options)

    @cached_property
    def moving(self) -> CompiledChain:
        """The same chain on bases that move: other code, made when a base's motion is first given."""
        return CompiledChain(self.chain, replace(self.options, base_motion=True), self.generic_rank)

    def __repr__(self) -> str:
        """Return the chain that it is the machine code of."""
        return f"<CompiledChain of {self.chain!r}>"

    @property
    def operation_count(self) -> int:
        """Arithmetic operations of one system's forward dynamics, all run-time parameters in."""
        return self.calls.kernel.operation_count

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes the object again: machine code is compiled, or found on disk."""
        return CompiledChain, (self.chain, self.options, self.generic_rank)

    def _forward(
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
        """Take the calls that the builtin does not; see `forward_dynamics`."""
        if not self.options.base_motion and any(name in parameters for name in MOVING):
            result = self.moving._forward(q, qd, tau, object_pose, object_twist, out=out, threads=threads, **parameters)
            if self.generic_rank is None and self.moving.generic_rank is not None:
                self.know_rank(self.moving.generic_rank)
            return result
        inputs = zip(_INPUTS, (q, qd, tau, object_pose, object_twist), strict=True)
        found = {name: arrays.floats(name, x, self._externals[name].shape) for name, x in inputs}
        of_base = FLOATING if self.chain.floats else ()
        require_floating(of_base, parameters)
        for name in of_base:
            found[name] = arrays.floats(name, parameters.pop(name), self._externals[name].shape)
        if parameters:
            found |= parse_parameters(parameters, self._externals, self.chain)
        batch = arrays.batch_of(found, self._externals)
        arrays.require_threads(threads)
        result = CompiledResult(self.chain, self.calls.layout, batch) if out is None else out
        if out is not None:
            arrays.require_fit(out, self.chain, batch, list(found.values()))
            if batch is None and len(found) == len(self._inputs):
                addresses = self.calls.table(found, result)
                self._builtin.expect(out, out.memory, addresses[len(self._inputs) :].tolist())
        if not self.calls(found, result, threads):
            found = self.calls.own | found | _origins(parameters)
            statuses.settle(self, found, result)
            if batch is None:
                statuses.require_answer(self, found, result)
        return result

    @property
    def externals(self) -> dict[str, External]:
        """The arrays that forward dynamics takes and returns."""
        return self._externals

    def bound(self) -> Bound:
        """Return the machine code tied to arrays of its own, parameters those of the chain."""
        return self.calls.bind()

    def know_rank(self, generic_rank: int) -> None:
        """Take a generic rank that was found; later calls decide by it at once."""
        self.generic_rank = generic_rank
        self.calls.own["generic_rank"][...] = float(generic_rank)
        self.calls.prepare()


def _origins(parameters: Mapping[str, Any]) -> dict[str, Array]:
    """Return where given bases stand, which matters only to who seeks the generic rank."""
    given = parameters.get("base_pose")
    return {} if given is None else {"base_p": np.array(given, dtype=float)[..., 4:]}
