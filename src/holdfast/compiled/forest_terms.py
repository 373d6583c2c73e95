"""The arrays of a forest's forward dynamics in machine code, in the terms of the forest or of its chain."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.result import Results, SolvedResults
from holdfast.compiled.traced_chain import Given
from holdfast.dynamics.tree.forest_derivatives import FOREST_RESULTS, POSITIONS_RATES_TORQUES
from holdfast.dynamics.tree.forest_dynamics import ForestResult, forest_dynamics
from holdfast.dynamics.tree.mechanism import MechanismResult, mechanism_dynamics
from holdfast.dynamics.tree.mechanism_terms import (
    ForestPlace,
    chain_arguments,
    chain_results,
    driven_joints,
    flat_rates,
    require_passive,
)
from holdfast.dynamics.tree.varied_forest import FOREST_ARGUMENTS, ForestArguments
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.forest import Forest
from holdfast.questions.arrays import FLOATING, FLOATING_RESULT, STATE_AND_TORQUES, Shape, state_fields
from holdfast.spatial.frozen import frozen_property
from holdfast.spatial.scalar import Array, array, where
from holdfast.state import Inputs, State


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


class CompiledMechanismResult(SolvedResults, MechanismResult):  # pyright: ignore[reportIncompatibleVariableOverride]
    """A `MechanismResult` of one system or a batch, whose arrays are written by machine code.

    For a batch every array has a leading axis, and `rank`, `status`, `mobility` and `condition` are arrays as well.
    If the forces are not unique (`INDETERMINATE_FORCES`), they are one of the solutions, not the smallest ones.
    It has no `bodies`. A call with `out=result` overwrites the result.
    """

    method = "sequential"

    @property
    def mobility(self) -> Any:  # type: ignore[override]
        """Dimension of the space of velocities that closures and couplings allow."""
        return self.chain.as_forest.forest.velocity_count - self.rank

    @property
    def base_acceleration(self) -> Array | None:  # type: ignore[override]
        """(6,) [omega_dot; v_dot] of a floating base's origin; None without one."""
        return self.array(FLOATING_RESULT) if FLOATING_RESULT in self.layout.shapes else None

    @frozen_property
    def accelerations(self) -> Mapping[str, Array]:
        """The accelerations of the objects by name, (6,)."""
        names, found = [*self.chain.free_objects], self.array("object_acceleration")
        return {name: found if len(names) == 1 else found[..., k, :] for k, name in enumerate(names)}


class ForestTerms(NamedTuple):
    """What machine code of a question reads and writes, and what that is of the forest.

    Attributes:
        subject: the forest, or the chain.
        forest: the forest.
        inputs: shapes of the arrays of a call, in order.
        further: shapes of those that are zero unless they are given.
        outputs: shapes of the results, without what says whether there are any, such as rank and status.
        arguments: returns the arguments of the forest by name, of the traced arrays.
        results: returns the results, of those of the forest.
        require: refuses arrays of one system or a batch that are no inputs.
        refuse: raises the error of the reference for one system, if it has one.
        made: the class of the results.
        arguments_by: by what the question can be differentiated, as parts of arrays of the forest.
        results_of: the results as parts of arrays of the forest.
        by, of: arguments and results of derivatives by default.
    """

    subject: Any
    forest: Forest
    inputs: Mapping[str, Shape]
    further: Mapping[str, Shape]
    outputs: Mapping[str, Shape]
    arguments: Callable[[Given], dict[str, Array]]
    results: Callable[[Mapping[str, Array]], dict[str, Array]]
    require: Callable[[Mapping[str, Array]], None]
    refuse: Callable[[Mapping[str, Array]], object]
    made: type[Results]
    arguments_by: Mapping[str, ForestPlace]
    results_of: Mapping[str, ForestPlace]
    by: tuple[str, ...]
    of: tuple[str, ...]


def forest_result_shapes(forest: Forest) -> dict[str, Shape]:
    """Return the shapes of a forest's results by name."""
    bodies, closures, couplings = len(forest.bodies), len(forest.closures), len(forest.couplings)
    shapes: tuple[Shape, ...] = (forest.velocity_count,), (bodies, 6), (closures, 6), (couplings,)
    return dict(zip(FOREST_RESULTS, shapes, strict=True))


def forest_terms(forest: Forest, parameters: Sequence[str]) -> ForestTerms:
    """Return the arrays of a forest in its own terms; `parameters` may have "link_wrench"."""
    n, wrenches = (forest.velocity_count,), (len(forest.bodies), 6)
    none = ForestArguments(forest, np.zeros(forest.position_count), np.zeros(n), np.zeros(n), np.zeros(wrenches))
    values = none.values(FOREST_ARGUMENTS)
    shapes = {name: shape for name, shape in forest_result_shapes(forest).items() if name != "acceleration"}

    def refuse(found: Mapping[str, Array]) -> None:
        forest_dynamics(forest, found["q"], found["qd"], found["tau"], found.get("link_wrench"), check=False)

    return ForestTerms(
        forest,
        forest,
        {"q": (forest.position_count,), "qd": n, "tau": n},
        {"link_wrench": wrenches} if "link_wrench" in parameters else {},
        shapes,
        dict,
        dict,
        lambda found: None,
        refuse,
        CompiledForestResult,
        {name: ForestPlace(name, slice(None), x.shape) for name, x in values.items()},
        {name: ForestPlace(name, slice(None), shape) for name, shape in shapes.items()},
        POSITIONS_RATES_TORQUES,
        ("qdd", "closure_wrench"),
    )


class ChainArrays(NamedTuple):
    """The state of a chain and the wrenches on it as arrays of machine code.

    Attributes:
        state: shapes of the arrays of its state.
        wrenches: shapes of external wrenches.
        arguments: returns q, qd and link_wrench of its forest, of the traced arrays.
        asked: returns the state and the inputs of one system.
    """

    state: Mapping[str, Shape]
    wrenches: Mapping[str, Shape]
    arguments: Callable[[Given], dict[str, Array]]
    asked: Callable[[Mapping[str, Array]], tuple[State, Inputs]]


def chain_arrays(chain: ClosedChain, parameters: Sequence[str]) -> ChainArrays:
    """Return the arrays of a chain's state and of wrenches on it; `parameters` may have "link_wrench"."""
    forest, places, count = chain.as_forest.forest, chain_arguments(chain), len(chain.free_objects)
    several = () if count == 1 else (count,)
    state: dict[str, Shape] = {"q": (forest.position_count - 7 * (count + chain.floats),), "qd": (chain.joint_count,)}
    state |= {"object_pose": (*several, 7), "object_twist": (*several, 6)}
    state |= dict(zip(FLOATING, ((7,), (6,)), strict=True)) if chain.floats else {}
    names = ["object_wrench", *(("link_wrench", "trunk_link_wrench") if "link_wrench" in parameters else ())]
    further = {name: places[name].shape for name in names if name in places}

    def arguments(given: Given) -> dict[str, Array]:
        wrenches = np.zeros((len(forest.bodies), 6), dtype=object)
        for name in further:
            wrenches[places[name].rows] = given[name].reshape(-1, 6)
        return {
            "q": flat_rates(given["q"], given["object_pose"], given.get(FLOATING[0])),
            "qd": flat_rates(given["qd"], given["object_twist"], given.get(FLOATING[1])),
            "link_wrench": wrenches,
        }

    def asked(found: Mapping[str, Array]) -> tuple[State, Inputs]:
        at = State(**{field: found[name] for name, field in state_fields(chain).items()})
        wrenches = {f"{name}es": found[name] for name in further if name != "object_wrench" and name in found}
        return at, Inputs(object_wrench=found.get("object_wrench"), **wrenches)

    return ChainArrays(state, further, arguments, asked)


def of_objects(chain: ClosedChain, **given: Any) -> dict[str, Any]:
    """Return arrays of objects by name; those of a chain without objects that are not given have no rows."""
    if chain.free_objects:
        return given
    return {name: np.zeros((0, 7 if name == "object_pose" else 6)) if x is None else x for name, x in given.items()}


def chain_terms(chain: ClosedChain, parameters: Sequence[str]) -> ForestTerms:
    """Return the arrays of a chain's forest in the terms of the chain; `parameters` may have "link_wrench"."""
    forest, places, results = chain.as_forest.forest, chain_arguments(chain), chain_results(chain)
    own, count = chain_arrays(chain, parameters), len(chain.free_objects)
    n, driven = chain.joint_count, driven_joints(chain)
    inputs: dict[str, Shape] = {"q": own.state["q"], "qd": (n,), "tau": (n,), **own.state}

    def arguments(given: Given) -> dict[str, Array]:
        tau = array(
            [x if has else where(abs(x) <= 0.0, 0.0, np.nan) for x, has in zip(given["tau"], driven, strict=True)]
        )
        drives = flat_rates(tau.reshape(n), np.zeros((count, 6)), np.zeros(6) if chain.floats else None)
        return own.arguments(given) | {"tau": drives}

    def from_forest(found: Mapping[str, Array]) -> dict[str, Array]:
        acceleration = np.zeros((len(forest.bodies), 6), dtype=object)  # of free bodies, which are asked for
        for k, (body, at) in enumerate(zip(forest.bodies, forest.velocities, strict=True)):
            if body.joint.of_kind.floats:
                acceleration[k] = found["qdd"][at]
        return {name: place.of({**found, "acceleration": acceleration}) for name, place in results.items()}

    def refuse(found: Mapping[str, Array]) -> None:
        state, given = own.asked(found)
        mechanism_dynamics(chain, state, found["tau"], given, check=False)

    def require(found: Mapping[str, Array]) -> None:
        worst = np.abs(found["tau"]).max(axis=tuple(range(found["tau"].ndim - 1)), initial=0.0)
        require_passive(chain, worst)

    return ForestTerms(
        chain,
        forest,
        inputs,
        own.wrenches,
        {name: place.shape for name, place in results.items()},
        arguments,
        from_forest,
        require,
        refuse,
        CompiledMechanismResult,
        places,
        results,
        STATE_AND_TORQUES,
        ("qdd", "grasp_wrench"),
    )
