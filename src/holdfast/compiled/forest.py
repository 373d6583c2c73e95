"""Forward dynamics of a forest as machine code (`holdfast.compile` of a `Forest`)."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from holdfast.compiled import arrays
from holdfast.compiled.bound import BoundFunction
from holdfast.compiled.calls import Calls
from holdfast.compiled.computation import Computation
from holdfast.compiled.kernels import kernel
from holdfast.compiled.result import INDETERMINATE, OK, SINGULAR, SolvedResults
from holdfast.compiled.traced_chain import (
    Given,
    constant_arm,
    constant_link,
    constant_pose,
    externals,
    quaternion_length,
    traced,
)
from holdfast.compiler.constant import Constant, constants
from holdfast.compiler.schedule import FIRST_BAD, Schedule
from holdfast.dynamics.closed.tip_response import if_regular
from holdfast.dynamics.tree.forest_dynamics import CONTRADICTION, ForestResult, forest_dynamics
from holdfast.dynamics.tree.limbs import LimbArm, limb_arms, limbed_motion, solved_with_limbs
from holdfast.dynamics.tree.plan import plan_of
from holdfast.dynamics.tree.varied_forest import damping_torques, spring_torques
from holdfast.errors import StateError
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.model.forest import Forest, ForestBody
from holdfast.names import called
from holdfast.progress import busy
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array, array, concatenate, maximum, where

if TYPE_CHECKING:
    from holdfast.compiled.function import Function

INPUTS = ("q", "qd", "tau")
_SOLUTION = ("qdd", "closure_wrench", "coupling_force")
_OF_STATUS = ("rank", "status", "condition")


class CompiledForestResult(SolvedResults, ForestResult):  # pyright: ignore[reportIncompatibleVariableOverride]
    """A `ForestResult` of one system or a batch, whose arrays are written by machine code.

    For a batch every array has a leading axis, and `rank`, `status`, `mobility` and `condition` are arrays as well.
    If the forces are not unique (`INDETERMINATE_FORCES`), they are one of the solutions, not the smallest ones.
    The accelerations of all bodies are not among them. A call with `out=result` overwrites the result.
    """

    method = "sequential"

    @property
    def forest(self) -> Forest:  # type: ignore[override]
        """The forest."""
        return self.chain

    @property
    def mobility(self) -> Any:  # type: ignore[override]
        """n_v minus the rank."""
        return self.forest.velocity_count - self.rank


@called
class CompiledForest:
    """The forward dynamics of one forest as machine code; made by `holdfast.compile`.

    Attributes:
        forest: the forest, all numbers of which are constants of the code.
        parameters: ("link_wrench",) if external wrenches on the bodies are an input, else ().
        progress: whether to show that machine code is made; see `holdfast.compile`.
        externals: the arrays that the machine code reads and writes, by name.
    """

    name, has_status, request = "forward_dynamics", True, None  # what a `BoundFunction` asks of a function

    def __init__(self, forest: Forest, parameters: Sequence[str] = (), progress: bool | None = None) -> None:
        self.forest, self.chain, self.progress, self.parameters = forest, forest, progress, tuple(parameters)
        n = forest.velocity_count
        shapes = {"q": (forest.position_count,), **dict.fromkeys(("qd", "tau", "qdd"), (n,))}
        shapes |= {"link_wrench": (len(forest.bodies), 6), "closure_wrench": (len(forest.closures), 6)}
        shapes |= {"coupling_force": (len(forest.couplings),), **dict.fromkeys(_OF_STATUS, ())}
        self.externals = externals([*INPUTS, *parameters], [], (*_SOLUTION, *_OF_STATUS), shapes)

    def forward_dynamics(
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
        arrays.require_threads(threads)
        given = {"q": q, "qd": qd, "tau": tau} | ({} if link_wrench is None else {"link_wrench": link_wrench})
        if not given.keys() <= self.externals.keys():
            raise StateError("link_wrench: expected none; try holdfast.compile(forest, parameters=['link_wrench'])")
        found = {name: arrays.floats(name, x, self.externals[name].shape) for name, x in given.items()}
        batch = arrays.batch_of(found, self.externals)
        if out is None:
            result = self.results(batch)
        else:
            arrays.require_fit(out, self.forest, batch)
            result = out
        if batch is not None and not self.calls.kernel.batch_is_compiled:
            with busy(self.progress, f"compiling {self.name} of a forest for batches"):
                self.calls.kernel.compile_batch()
        self.calls(found, result, threads)
        if batch is None and result.array("status") >= FIRST_BAD:
            self._refuse(found)
        return result

    def bind(self, **inputs: Array) -> BoundFunction:
        """Return forward dynamics bound to fixed arrays: a call without arguments, for control loops.

        Args:
            **inputs: arrays of the caller for q, qd, tau and link_wrench (float64, C order), which are read at every
                call; new arrays are made for the others.

        Raises:
            StateError: a name or shape is wrong.
        """
        return BoundFunction(cast("Function", self), inputs)

    @property
    def operation_count(self) -> int:
        """The number of arithmetic operations for one system."""
        return self.calls.kernel.operation_count

    @cached_property
    def calls(self) -> Calls:
        """The calls of the machine code, which is made or loaded when they are first needed."""
        with busy(self.progress, f"compiling {self.name} of a forest"):
            structure: Any = self  # whose key names the code
            code = kernel(Computation("forest", structure, self.externals, self.schedule, INPUTS))
        return Calls(code, {name: np.zeros(self.externals[name].shape) for name in self.parameters})

    @property
    def key(self) -> str:
        """A key of everything on which the code depends."""
        return f"{exact_fingerprint(self.forest) or secrets.token_hex()}/{self.parameters}"

    def schedule(self) -> Schedule:
        """Return the schedule, made by tracing the reference's functions."""
        return traced(self.externals, lambda given: forward_outputs(self.forest, given), "status", _SOLUTION)

    def results(self, batch: int | None) -> CompiledForestResult:
        """Return new memory for the results of one system, or of a batch."""
        return CompiledForestResult(self.forest, self.calls.layout, batch)

    def shown(self, results: Any) -> Any:
        """Return what a user gets of the results in memory: the results."""
        return results

    def only_array(self, results: Any) -> None:
        """Return None, as there are several results."""

    @property
    def subject(self) -> str:
        """What it is about, for descriptions."""
        return repr(self.forest)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to unpickle the object: its machine code is loaded from the cache or compiled again."""
        return CompiledForest, (self.forest, self.parameters, self.progress)

    def __repr__(self) -> str:
        """Return the forest."""
        return f"<CompiledForest of {self.forest!r}>"

    def _refuse(self, found: Mapping[str, Array]) -> None:
        """Raise the error of the reference for one system without an answer."""
        for name, x in found.items():
            if not np.isfinite(x).all():
                raise StateError(f"{name}: expected finite numbers, got {x[~np.isfinite(x)][0]}")
        wrenches = found.get("link_wrench")
        forest_dynamics(self.forest, found["q"], found["qd"], found["tau"], wrenches, check=False)
        worst = float(np.abs(found["q"]).max())
        raise StateError(f"q: expected angles of at most {arrays.LARGEST_ARGUMENT:g} rad, got {worst:.6g}")


def forward_outputs(forest: Forest, given: Given) -> dict[str, Any]:
    """Return the outputs of forward dynamics by running the reference's functions on traced arrays."""
    made, qd, plan = with_constants(forest), given["qd"], plan_of(forest.topology)
    arms = with_constant_arms(forest)
    torque = given["tau"] - damping_torques(made, qd) - spring_torques(made, given["q"])
    limbed = limbed_motion(made, arms, _unit_quaternions(forest, given["q"]), qd, torque, given.get("link_wrench"))
    found = solved_with_limbs(limbed, plan)
    low = where(reduce(maximum, found.left, 0.0) > CONTRADICTION, float(SINGULAR), float(INDETERMINATE))
    qdd = concatenate(found.qdd)
    return {
        "qdd": if_regular(qdd, found.pivots) if len(found.pivots) else qdd,
        "closure_wrench": array(found.wrenches),
        "coupling_force": array(found.multipliers),
        "rank": found.rank,
        "status": where(found.rank < forest.constraint_row_count, low, float(OK)),
        "condition": 1.0 / found.weakest,
    }


def with_constant_arms(forest: Forest) -> list[LimbArm]:
    """Return the limbs of a forest with their fixed numbers as `Constant`."""
    return [one._replace(arm=constant_arm(one.arm), base=constant_pose(one.base)) for one in limb_arms(forest)]


def with_constants(forest: Forest) -> Forest:
    """Return the forest with its fixed numbers as `Constant`, so that no BLAS computes their products."""
    closures = [
        changed(c, tip=constant_pose(c.tip), grasp=c.grasp.standing_at(constant_pose(c.grasp.frame)))
        for c in forest.closures
    ]
    bodies = tuple(map(_constant_body, forest.bodies))
    return changed(forest, bodies=bodies, closures=tuple(closures), gravity=constants(forest.gravity))


def _constant_body(body: ForestBody) -> ForestBody:
    joint = body.joint
    across = None if joint.across is None else constants(joint.across)
    numbers: dict[str, Any] = {
        name: Constant(getattr(joint, name)) for name in ("armature", "damping", "stiffness", "rest")
    }
    numbers |= {"axis": constants(joint.axis), "across": across, "rate_map": constants(joint.rate_map)}
    own = changed(joint, placement=constant_pose(joint.placement), **numbers)
    return changed(body, link=constant_link(body.link), joint=own)


def _unit_quaternions(forest: Forest, q: Array) -> Array:
    """Return positions with unit quaternions, NaN where one is not of unit length within 1e-6."""
    parts = []
    for body, at in zip(forest.bodies, forest.positions, strict=True):
        own = q[at]
        if body.joint.of_kind.pose:
            own = concatenate([own[:4] / quaternion_length(own[:4]), own[4:]])
        parts.append(own)
    return concatenate(parts)
