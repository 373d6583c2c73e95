"""Forward dynamics of a forest, or of a chain that is answered as one, as machine code (`holdfast.compile`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, reduce
from typing import Any, cast

import numpy as np

from holdfast.compiled import arrays
from holdfast.compiled.bound import BoundFunction
from holdfast.compiled.calls import Calls
from holdfast.compiled.computation import Computation
from holdfast.compiled.forest_terms import (
    CompiledForestResult,
    CompiledMechanismResult,
    ForestTerms,
    chain_terms,
    forest_terms,
)
from holdfast.compiled.function import Function, NotCompiledError
from holdfast.compiled.kernels import kernel
from holdfast.compiled.result import INDETERMINATE, OK, SINGULAR
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
from holdfast.dynamics.tree.forest_dynamics import CONTRADICTION
from holdfast.dynamics.tree.limbs import LimbArm, limb_arms, limbed_motion, solved_with_limbs
from holdfast.dynamics.tree.plan import plan_of
from holdfast.dynamics.tree.varied_forest import damping_torques, spring_torques
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import code_key
from holdfast.model.forest import Forest, ForestBody
from holdfast.names import called, unknown_attribute
from holdfast.progress import busy
from holdfast.questions.question import QUESTIONS
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array, array, concatenate, maximum, where

_OF_STATUS = ("rank", "status", "condition")
DERIVATIVES = tuple(f"forward_dynamics_{kind}" for kind in ("vjp", "jvp", "jacobian"))


class ForestFunction:
    """Forward dynamics as machine code, called for one system or a batch, or bound to fixed arrays.

    Attributes:
        terms: the arrays that it takes and returns.
        externals: the arrays that the machine code reads and writes, by name.
        progress: whether to show that machine code is made; see `holdfast.compile`.
    """

    name, has_status, request = "forward_dynamics", True, None  # what a `BoundFunction` asks of a function

    def __init__(self, terms: ForestTerms, key: str, progress: bool | None) -> None:
        self.terms, self.chain, self.key, self.progress = terms, terms.subject, key, progress
        shapes = {**terms.inputs, **terms.further, **terms.outputs, **dict.fromkeys(_OF_STATUS, ())}
        self.externals = externals([*terms.inputs, *terms.further], [], (*terms.outputs, *_OF_STATUS), shapes)

    def __call__(self, given: Mapping[str, Any], out: Any, threads: int | None) -> Any:
        """Return accelerations and forces of one system or a batch.

        Args:
            given: the arrays by name; those of `terms.further` are zero by default.
            out: an earlier result, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.

        Raises:
            StateError, SingularChainError, ModelError: as the reference raises them.
        """
        arrays.require_threads(threads)
        present = {name: x for name, x in given.items() if x is not None}
        if lacking := [name for name in self.terms.inputs if name not in present]:
            raise StateError(f"{self.name}: expected {', '.join(self.terms.inputs)}, got no {' and no '.join(lacking)}")
        if unknown := [name for name in present if name not in self.externals]:
            raise StateError(f"{unknown[0]}: expected none; try holdfast.compile(..., parameters=['link_wrench'])")
        found = {name: arrays.floats(name, x, self.externals[name].shape) for name, x in present.items()}
        self.terms.require(found)
        batch = arrays.batch_of(found, self.externals)
        if out is None:
            result = self.results(batch)
        else:
            arrays.require_fit(out, self.chain, batch)
            result = out
        if batch is not None and not self.calls.kernel.batch_is_compiled:
            with busy(self.progress, f"compiling {self.name} of {self._of} for batches"):
                self.calls.kernel.compile_batch()
        self.calls(found, result, threads)
        if batch is None and result.array("status") >= FIRST_BAD:
            self._refuse(found)
        return result

    @property
    def _of(self) -> str:
        return "a forest" if self.chain is self.terms.forest else ", ".join(self.chain.names)

    @cached_property
    def calls(self) -> Calls:
        """The calls of the machine code, which is made or loaded when they are first needed."""
        with busy(self.progress, f"compiling {self.name} of {self._of}"):
            structure: Any = self  # whose key names the code
            code = kernel(Computation("forest", structure, self.externals, self.schedule, tuple(self.terms.inputs)))
        return Calls(code, {name: np.zeros(shape) for name, shape in self.terms.further.items()})

    def schedule(self) -> Schedule:
        """Return the schedule, made by tracing the reference's functions."""
        forest, terms = self.terms.forest, self.terms

        def outputs(given: Given) -> dict[str, Any]:
            found = forward_outputs(forest, terms.arguments(given))
            return terms.results(found) | {name: found[name] for name in _OF_STATUS}

        return traced(self.externals, outputs, "status", tuple(self.terms.outputs))

    def results(self, batch: int | None) -> CompiledForestResult | CompiledMechanismResult:
        """Return new memory for the results of one system, or of a batch."""
        return self.terms.made(self.chain, self.calls.layout, batch)

    def shown(self, results: Any) -> Any:
        """Return what a user gets of the results in memory: the results."""
        return results

    def only_array(self, results: Any) -> None:
        """Return None, as there are several results."""

    @property
    def subject(self) -> str:
        """What it is about, for descriptions."""
        return repr(self.chain)

    def _refuse(self, found: Mapping[str, Array]) -> None:
        """Raise the error of the reference for one system without an answer."""
        for name, x in found.items():
            if not np.isfinite(x).all():
                raise StateError(f"{name}: expected finite numbers, got {x[~np.isfinite(x)][0]}")
        self.terms.refuse(found)
        worst = float(np.abs(found["q"]).max())
        raise StateError(f"q: expected angles of at most {arrays.LARGEST_ARGUMENT:g} rad, got {worst:.6g}")


class _Compiled:
    """What machine code of forests and of chains that are answered as forests have in common."""

    def __init__(
        self,
        subject: Any,
        terms: Callable[[Any, Sequence[str]], ForestTerms],
        parameters: Sequence[str],
        progress: bool | None,
    ) -> None:
        self.parameters, self.progress, self._subject = tuple(parameters), progress, subject
        key = f"{code_key(subject)}/{type(self).__name__}/{self.parameters}"
        self.function = ForestFunction(terms(subject, self.parameters), key, progress)

    def bind(self, **inputs: Array) -> BoundFunction:
        """Return forward dynamics bound to fixed arrays: a call without arguments, for control loops.

        Args:
            **inputs: arrays of the caller for the arguments of `forward_dynamics` (float64, C order), which are read at
                every call; new arrays are made for the others.

        Raises:
            StateError: a name or shape is wrong.
        """
        return BoundFunction(cast(Function, self.function), inputs)

    def __getattr__(self, name: str) -> Any:
        """Raise an error that says that a question has no machine code here."""
        if name in (*QUESTIONS, *DERIVATIVES, "export"):
            raise NotCompiledError(
                f"compile: '{name}': expected forward_dynamics of a forest, or of a chain that is answered as a forest,"
                " which have no other machine code; try the function of the chain that runs as reference"
            )
        raise unknown_attribute(self, name)

    @property
    def operation_count(self) -> int:
        """The number of arithmetic operations for one system."""
        return self.function.calls.kernel.operation_count

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to unpickle the object: its machine code is loaded from the cache or compiled again."""
        return type(self), (self._subject, self.parameters, self.progress)

    def __repr__(self) -> str:
        """Return what it is about."""
        return f"<{type(self).__name__} of {self._subject!r}>"


@called
class CompiledForest(_Compiled):
    """The forward dynamics of one forest as machine code; made by `holdfast.compile`.

    Attributes:
        forest: the forest, all numbers of which are constants of the code.
        parameters: ("link_wrench",) if external wrenches on the bodies are an input, else ().
        progress: whether to show that machine code is made; see `holdfast.compile`.
    """

    def __init__(self, forest: Forest, parameters: Sequence[str] = (), progress: bool | None = None) -> None:
        self.forest = forest
        super().__init__(forest, forest_terms, parameters, progress)

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
        return self.function({"q": q, "qd": qd, "tau": tau, "link_wrench": link_wrench}, out, threads)


@called
class CompiledMechanism(_Compiled):
    """The forward dynamics of one chain with branches, loops, couplings or several objects as machine code.

    It is made by `holdfast.compile`, and all numbers of the chain are constants of the code.

    Attributes:
        chain: the chain.
        parameters: ("link_wrench",) if external wrenches on the links are inputs, else ().
        progress: whether to show that machine code is made; see `holdfast.compile`.
    """

    def __init__(self, chain: ClosedChain, parameters: Sequence[str] = (), progress: bool | None = None) -> None:
        self.chain = chain
        super().__init__(chain, chain_terms, parameters, progress)

    def forward_dynamics(
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
        own = {"object_pose": object_pose, "object_twist": object_twist}
        none = np.zeros((0, 7)), np.zeros((0, 6))
        if not self.chain.free_objects:
            own = {k: empty if x is None else x for (k, x), empty in zip(own.items(), none, strict=True)}
        return self.function({"q": q, "qd": qd, "tau": tau, **own, **further}, out, threads)


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
