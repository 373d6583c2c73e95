"""A question about the forces of a chain, ready to be asked as a programme."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.forces.acceleration_map import (
    WorldForces,
    acceleration_map,
    asked_rows,
    force_scale,
    motion_without_torques,
    scaled_map,
)
from holdfast.forces.affine_map import AccelerationMap, AccelerationTask, towards_task
from holdfast.forces.forest_equations import forest_equations
from holdfast.forces.forest_map import forest_force, forest_map, scaled_forest_map
from holdfast.forces.forest_task import NamedTask, named_tasks, on_accelerations
from holdfast.forces.limit_rows import Limit, limit_rows, same_modes
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.forces.programmes import Costs, Form, Posed, Solved, answer, at_value, costs, posed
from holdfast.forces.touched_object import normal_force_rows, touched_object
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest, require_unused, without_contacts
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit, shaped_inputs

NOTHING = AccelerationTask(np.zeros((0, 6)), np.zeros(0))


class ForceQuestion(NamedTuple):
    """A question about the forces of a chain, ready to be asked as a programme.

    Attributes:
        state: the state.
        found: the map of all motions and forces.
        limits: the limits.
        costs: the cost.
        v1: (m,) change of the map's v0 per unit of sigma; None without a share that grows.
        inputs: external wrenches and base motion.
    """

    state: State
    found: AccelerationMap
    limits: list[Limit]
    costs: Costs
    v1: Array | None = None
    inputs: Inputs | None = None

    def posed(self, form: Form, price: float = 0.0) -> Posed:
        """Return the programme of a form."""
        return posed(form, self.found, self.limits, self.costs, price=price, v1=self.v1)

    def asked(self, form: Form, price: float = 0.0) -> Solved:
        """Return the solution of a form."""
        return answer(self.posed(form, price))

    def whole(self) -> ForceQuestion:
        """Return the question at sigma = 1, without a share that grows."""
        if self.v1 is None:
            return self
        return self._replace(found=self.found._replace(v0=self.found.v0 + self.v1), v1=None)

    def cheapest(self, form: Form, extra: float) -> Solved:
        """Return the solution of least cost that reaches a number of a form."""
        return at_value(form, extra, self.found, self.limits, self.costs, v1=self.v1)


def force_question(
    chain: ClosedChain,
    state: State,
    acceleration: Any,
    task: Any,
    cost: ForceCost | None,
    limits: ForceLimits | None,
    inputs: Inputs | None,
    normal_force: Mapping[str, Any] | None = None,
) -> ForceQuestion:
    """Return the question of `distribute`; arguments as there."""
    checks.instance(cost, (ForceCost, type(None)), "cost")
    if answered_as_forest(chain):
        require_unused(normal_force=normal_force is not None)
        return _forest_question(chain, state, acceleration, task, cost or ForceCost(), limits, inputs)
    motion, wanted = _motion(chain, state, inputs), _asked(acceleration, task)
    weight = None if cost is None else cost.task_weight()
    exact, force = wanted if weight is None else NOTHING, force_scale(motion, wanted.smallest)
    if cost is not None and cost.barrier:
        without_contacts(chain, "cost: barrier")
    all_asked = np.linalg.matrix_rank(exact.rows) == 6
    world = _world(motion, state, normal_force, exact.smallest if all_asked else None)
    found = acceleration_map(motion, exact, force=force, world=world)
    if weight is None:
        return _with_limits(state, found, limits, cost)._replace(inputs=inputs)
    wanted = wanted.weighed(weight)
    return _with_limits(state, towards_task(found, wanted), limits, cost, wanted)._replace(inputs=inputs)


def scaled_question(
    chain: ClosedChain,
    state: State,
    acceleration: Any,
    payload: bool,
    cost: ForceCost | None,
    limits: ForceLimits | None,
    inputs: Inputs | None,
    normal_force: Mapping[str, Any] | None = None,
) -> ForceQuestion:
    """Return the question of `lift_margin`; arguments as there."""
    if answered_as_forest(chain):
        require_unused(normal_force=normal_force is not None)
        equations = forest_equations(chain, state, inputs)
        tasks = named_tasks(equations, acceleration, None)
        found, v1 = scaled_forest_map(equations, tasks, forest_force(equations, tasks), payload=payload)
        return _with_limits(state, found, limits, cost)._replace(v1=v1)
    motion, wanted = _motion(chain, state, inputs), _asked(acceleration, None)
    held = wanted if payload else wanted._replace(values=np.zeros(6))
    more = np.zeros(6) if payload else wanted.values
    world = _world(motion, state, normal_force, held.smallest, None if payload else more)
    found, v1 = scaled_map(motion, held, more, payload=payload, world=world)
    question = _with_limits(state, found, limits, cost)._replace(v1=v1, inputs=inputs)
    forward = [] if world is None or payload else same_modes(found, more)
    return question._replace(limits=[*question.limits, *forward])


def _forest_question(
    chain: ClosedChain,
    state: State,
    acceleration: Any,
    task: Any,
    cost: ForceCost,
    limits: ForceLimits | None,
    inputs: Inputs | None,
) -> ForceQuestion:
    """Return the question of a chain that is answered as a forest."""
    if cost.barrier:
        raise MethodNotApplicable(
            f"cost: barrier: expected 0 for a chain that is answered as a forest, got {cost.barrier:g}"
        )
    equations = forest_equations(chain, state, inputs)
    tasks = named_tasks(equations, acceleration, task)
    weights = _weights(cost.task, tasks)
    force = forest_force(equations, tasks)
    found = forest_map(equations, [one for one in tasks if one.name not in weights], force)
    if not weights:
        return _with_limits(state, found, limits, cost)
    yielding = [one for one in tasks if one.name in weights]
    weight = np.concatenate([np.full(len(one.rows), weights[one.name]) for one in yielding])
    wanted = on_accelerations(equations, yielding).weighed(weight)
    return _with_limits(state, towards_task(found, wanted), limits, cost, wanted)


def _weights(given: Any, tasks: list[NamedTask]) -> dict[str, float]:
    """Return the weights of tasks that give way, by name of their frames.

    Raises:
        StateError: one belongs to a frame of which nothing is asked.
    """
    names = [one.name for one in tasks]
    if not isinstance(given, Mapping):
        return {} if given is None else dict.fromkeys(names, float(given))
    for name in given:
        if name not in names:
            raise StateError(f"cost: task: nothing is asked of '{name}'.{checks.did_you_mean(str(name), names)}")
    return {name: float(weight) for name, weight in given.items()}


def _motion(chain: ClosedChain, state: State, inputs: Inputs | None) -> ChainMotion:
    require_fit(chain, state)
    return motion_without_torques(chain, state, shaped_inputs(chain, inputs))


def _world(
    motion: ChainMotion, state: State, normal_force: Any, alpha: Array | None, more: Array | None = None
) -> WorldForces | None:
    """Return the forces of the world on the object, and what is asked of them; see `touched_object`."""
    touched = touched_object(motion, state, alpha, more)
    rows = normal_force_rows(motion.chain, touched, normal_force)
    return None if touched is None else WorldForces(touched, *rows)


def _asked(acceleration: Any, task: Any) -> AccelerationTask:
    """Return what is asked, checked."""
    for name, given in (("acceleration", acceleration), ("task", task)):
        if isinstance(given, Mapping):
            raise StateError(f"{name}: expected that of the object, for serial arms that hold one, got one by name")
    rows = asked_rows(task)
    given = np.zeros(len(rows)) if acceleration is None else acceleration
    return AccelerationTask(rows, checks.numbers(given, (len(rows),), "acceleration", StateError))


def _with_limits(
    state: State,
    found: AccelerationMap,
    limits: ForceLimits | None,
    cost: ForceCost | None,
    asked: AccelerationTask | None = None,
) -> ForceQuestion:
    checks.instance(limits, (ForceLimits, type(None)), "limits")
    checks.instance(cost, (ForceCost, type(None)), "cost")
    rows = limit_rows(found, state, limits or ForceLimits())
    return ForceQuestion(state, found, rows, costs(found, cost or ForceCost(), asked))
