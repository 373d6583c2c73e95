"""Inverse dynamics of forests, and of chains that are answered as forests, by machine code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any, ClassVar, cast, get_args

import numpy as np

from holdfast.compiled.bound import BoundFunction
from holdfast.compiled.derivative_schedule import DerivativeKind
from holdfast.compiled.forest_function import ForestFunction
from holdfast.compiled.forest_schedule import unit_positions, with_constants
from holdfast.compiled.forest_terms import ForestTerms, chain_arrays, forest_result_shapes, of_objects
from holdfast.compiled.function import Function, NotCompiledError
from holdfast.compiled.result import INVALID, OK, StatusResults
from holdfast.compiled.traced_chain import Given
from holdfast.dynamics.tree.forest_inverse import (
    MISSING,
    TRANSMITTED,
    ForestTorques,
    along_rows,
    carrying_forces,
    driven,
    forest_inverse_dynamics,
    inverse_terms,
    loads_for,
    untransmitted,
    wrenches_along,
)
from holdfast.dynamics.tree.mechanism_inverse import MechanismTorques, mechanism_torques
from holdfast.dynamics.tree.mechanism_terms import chain_results, flat_rates, joint_rows
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.forest import Forest
from holdfast.names import called, unknown_attribute
from holdfast.questions.arrays import FLOATING_RESULT, Shape
from holdfast.spatial.frozen import FrozenDict, frozen_property
from holdfast.spatial.scalar import Array, array, maximum, where

WANTED = "wanted_wrench"  # the array of wanted wrenches, since `grasp_wrench` is that of the result


class CompiledForestTorques(StatusResults, ForestTorques):  # pyright: ignore[reportIncompatibleVariableOverride]
    """A `ForestTorques` of one system or a batch, whose arrays are written by machine code.

    For a batch every array has a leading axis, and `status` is an array; it is INVALID where no forces can carry a
    passive part. A call with `out=result` overwrites the result.
    """


class CompiledMechanismTorques(StatusResults, MechanismTorques):  # pyright: ignore[reportIncompatibleVariableOverride]
    """A `MechanismTorques` of one system or a batch, whose arrays are written by machine code.

    For a batch every array has a leading axis, and `status` is an array; it is INVALID where no forces can carry a
    passive part. A call with `out=result` overwrites the result.
    """

    @frozen_property
    def wrenches(self) -> Mapping[Any, Array]:
        """The rows of `grasp_wrench` by the keys of the chain's grasps and loops."""
        return FrozenDict({key: self.grasp_wrench[..., i, :] for key, i in self.chain.as_forest.closures.items()})

    def __repr__(self) -> str:
        """Return the torques of one system, or how many systems there are."""
        if self.batch is None:
            return super().__repr__()
        return f"<{type(self).__name__} of {self.batch} systems of {', '.join(self.chain.names)}>"


class InverseFunction(ForestFunction):
    """Inverse dynamics of a forest as machine code."""

    question: ClassVar[str] = "inverse_dynamics"
    of_status: ClassVar[tuple[str, ...]] = ("status",)

    def traced_outputs(self, given: Given) -> dict[str, Any]:
        """Return the outputs by name of the traced arrays."""
        found = inverse_outputs(self.terms.forest, self.terms.arguments(given))
        return self.terms.results(found) | {"status": found["status"]}


def inverse_outputs(forest: Forest, given: Given) -> dict[str, Any]:
    """Return torques, wrenches, forces and status of inverse dynamics, by running the reference's functions."""
    q, none = unit_positions(forest, given["q"]), np.zeros(forest.velocity_count)
    motion = ForestArguments(with_constants(forest), q, given["qd"], none, given["link_wrench"]).motion({})
    terms, needed, near = inverse_terms(motion), loads_for(motion, given["qdd"]), given["closure_wrench"]
    asked = along_rows(forest, terms, near)
    found, rows = carrying_forces(forest, terms, needed, asked), len(terms.K)
    kept = wrenches_along(forest, terms, asked[:rows])
    lost = reduce(maximum, [untransmitted(f, x) for f, x in zip(near, kept, strict=True)], 0.0)
    return {
        "tau": array([x if has else 0.0 for x, has in zip(found.left, driven(forest), strict=True)]),
        "closure_wrench": wrenches_along(forest, terms, found.force[:rows]),
        "coupling_force": found.force[rows:],
        "status": where(
            found.missing <= MISSING, where(lost <= TRANSMITTED, float(OK), float(INVALID)), float(INVALID)
        ),
    }


def forest_inverse_terms(forest: Forest, parameters: Sequence[str]) -> ForestTerms:
    """Return the arrays of inverse dynamics of a forest in its own terms; `parameters` may have "link_wrench"."""
    n, wrenches = (forest.velocity_count,), (len(forest.bodies), 6)
    results = forest_result_shapes(forest)
    further = {WANTED: results["closure_wrench"]} | ({"link_wrench": wrenches} if "link_wrench" in parameters else {})

    def arguments(given: Given) -> dict[str, Array]:
        return {"link_wrench": np.zeros(wrenches), **given, "closure_wrench": given[WANTED]}

    def refuse(found: Mapping[str, Array]) -> None:
        given = (found.get(name) for name in ("q", "qd", "qdd", "link_wrench"))
        forest_inverse_dynamics(forest, *given, closure_wrench=found.get(WANTED), check=False)  # pyright: ignore

    return ForestTerms(
        forest,
        forest,
        {"q": (forest.position_count,), "qd": n, "qdd": n},
        further,
        {"tau": n, **{name: results[name] for name in ("closure_wrench", "coupling_force")}},
        arguments,
        lambda found: {name: found[name] for name in ("tau", "closure_wrench", "coupling_force")},
        lambda found: None,
        refuse,
        CompiledForestTorques,
        {},
        {},
        (),
        (),
    )


def chain_inverse_terms(chain: ClosedChain, parameters: Sequence[str]) -> ForestTerms:
    """Return the arrays of inverse dynamics in the terms of a chain; `parameters` may have "link_wrench"."""
    own, results = chain_arrays(chain, parameters), chain_results(chain)
    wrenches, joints = results["grasp_wrench"], joint_rows(chain)
    accelerations = {name: results[name].shape for name in ("object_acceleration", FLOATING_RESULT) if name in results}
    inputs: dict[str, Shape] = {**dict.fromkeys(("q", "qd"), ()), "qdd": results["qdd"].shape}
    inputs.update({**own.state, **accelerations})

    def arguments(given: Given) -> dict[str, Array]:
        qdd = flat_rates(given["qdd"], given["object_acceleration"], given.get(FLOATING_RESULT))
        return own.arguments(given) | {"qdd": qdd, "closure_wrench": given[WANTED]}

    def from_forest(found: Mapping[str, Array]) -> dict[str, Array]:
        return {
            "tau": found["tau"][joints],
            "grasp_wrench": found["closure_wrench"],
            "coupling_force": found["coupling_force"],
        }

    def refuse(found: Mapping[str, Array]) -> None:
        state, inputs = own.asked(found)
        of_objects = found["object_acceleration"] if chain.free_objects else None
        given = found["qdd"], found.get(WANTED), inputs, found.get(FLOATING_RESULT), of_objects
        mechanism_torques(chain, state, *given, check=False)

    outputs = {"tau": results["qdd"].shape, "grasp_wrench": wrenches.shape}
    return ForestTerms(
        chain,
        chain.as_forest.forest,
        inputs,
        {WANTED: wrenches.shape, **own.wrenches},
        outputs | {"coupling_force": results["coupling_force"].shape},
        arguments,
        from_forest,
        lambda found: None,
        refuse,
        CompiledMechanismTorques,
        {},
        {},
        (),
        (),
    )


class _Inverse:
    """Inverse dynamics by machine code, for one system or a batch.

    Attributes:
        function: what calls the machine code.
    """

    def __init__(self, terms: ForestTerms, key: str, progress: bool | None) -> None:
        self.function = InverseFunction(terms, key, progress)

    def bind(self, **inputs: Array) -> BoundFunction:
        """Return inverse dynamics bound to fixed arrays: a call without arguments.

        Args:
            **inputs: arrays of the caller for the arguments (float64, C order), which are read at every call; new
                arrays are made for the others. Wanted wrenches are `wanted_wrench`.

        Raises:
            StateError: a name or shape is wrong.
        """
        return BoundFunction(cast(Function, self.function), inputs)

    @property
    def operation_count(self) -> int:
        """The number of arithmetic operations for one system."""
        return self.function.calls.kernel.operation_count

    def __getattr__(self, name: str) -> Any:
        """Raise an error that says that derivatives have no machine code here."""
        if name in get_args(DerivativeKind):
            raise NotCompiledError(
                f"compile: 'inverse_dynamics.{name}': expected the answer alone of a forest, or of a chain that is"
                " answered as one; try the derivatives of forward_dynamics"
            )
        raise unknown_attribute(self, name)


@called
class ForestInverse(_Inverse):
    """Inverse dynamics of a compiled forest: `compiled.inverse_dynamics(q, qd, qdd)`."""

    def __call__(
        self,
        q: Any,
        qd: Any,
        qdd: Any,
        *,
        closure_wrench: Any = None,
        link_wrench: Any = None,
        out: CompiledForestTorques | None = None,
        threads: int | None = None,
    ) -> CompiledForestTorques:
        """Return the torques of one system or a batch, with the least forces, as `forest_inverse_dynamics` does.

        Any argument may have a leading batch axis; those without it are shared. Results do not depend on batch size or
        number of threads, bit for bit. Neither the state nor the accelerations need satisfy closures. In a batch,
        systems without an answer have the status INVALID, and NaN as results.

        Args:
            q: (n_q,) positions, in the order of the bodies (`Forest`).
            qd: (n_v,) rates.
            qdd: (n_v,) accelerations.
            closure_wrench: (closures, 6) wanted wrenches, zero by default; the forces are the closest that carry all
                passive parts.
            link_wrench: (bodies, 6) as for `ForestForward`.
            out: an earlier result, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.

        Raises:
            StateError: a shape or a number is wrong, a closure does not transmit a wanted wrench, or no forces of a
                single system can carry a passive part.
        """
        given = {"q": q, "qd": qd, "qdd": qdd, WANTED: closure_wrench, "link_wrench": link_wrench}
        return self.function(given, out, threads)


@called
class MechanismInverse(_Inverse):
    """Inverse dynamics of a compiled chain with branches: `compiled.inverse_dynamics(q, qd, qdd, ...)`."""

    def __call__(
        self,
        q: Any,
        qd: Any,
        qdd: Any,
        object_pose: Any = None,
        object_twist: Any = None,
        object_acceleration: Any = None,
        *,
        grasp_wrench: Any = None,
        out: CompiledMechanismTorques | None = None,
        threads: int | None = None,
        **further: Any,
    ) -> CompiledMechanismTorques:
        """Return the torques of one system or a batch, with the least forces, as `inverse_dynamics` does.

        Any argument may have a leading batch axis; those without it are shared. Results do not depend on batch size or
        number of threads, bit for bit. Neither the state nor the accelerations need satisfy closures. In a batch,
        systems without an answer have the status INVALID, and NaN as results.

        Args:
            q: positions of the joints, as for `MechanismForward`.
            qd: (n,) rates of the joints.
            qdd: (n,) their accelerations.
            object_pose: (7,) wxyz_xyz of the object, or (k, 7) of k objects; None without objects.
            object_twist: (6,) its twist, or (k, 6) of k objects.
            object_acceleration: (6,) its acceleration, or (k, 6) of k objects.
            grasp_wrench: (grasps and loops, 6) wanted wrenches, zero by default; the forces are the closest that carry
                all passive parts.
            out: an earlier result, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **further: object_wrench, floating_pose, floating_twist, link_wrench and trunk_link_wrench as for
                `MechanismForward`, and with a floating base floating_acceleration (6,).

        Raises:
            StateError: a shape or a number is wrong, a grasp or loop does not transmit a wanted wrench, or no forces of
                a single system can carry a passive part.
        """
        own = {"object_pose": object_pose, "object_twist": object_twist, "object_acceleration": object_acceleration}
        own = of_objects(self.function.chain, **own)
        given = {"q": q, "qd": qd, "qdd": qdd, **own, WANTED: grasp_wrench, **further}
        return self.function(given, out, threads)
