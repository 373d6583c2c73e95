"""How a step of systems becomes machine code: its arrays, what is carried between steps, and its functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.parameters import parameters_of
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import externals
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External
from holdfast.control.controller import ControlLaw
from holdfast.forces.margins import joint_limits
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import BASE_MOTION, CONTACTS, link_parameters, shapes
from holdfast.simulation.contact_stepper import TOUCH_WRENCH
from holdfast.simulation.increment import increment_size
from holdfast.simulation.rollout import stage_values, traced_impulses, traced_modes, traced_step
from holdfast.simulation.rollout.between_steps import after_jump
from holdfast.simulation.rollout.traced_step import StepModel
from holdfast.simulation.rollout.varied_step import VariedSystem
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial.scalar import Array

ALWAYS_CARRIED = ("q", "qd", "qdd", "drive", "grasp_wrench", "base_wrench")  # also without joints or grasps
STEP_INPUTS = ("begin", "step", "held", "least_margin", "least_joint_margin", "search")
STEP_PARAMETERS = ("gravity", "generic_rank", "object_mass", "object_com", "object_inertia", "base_R", "base_p")


def carried_shapes(chain: ClosedChain, law: ControlLaw, options: Options) -> dict[str, Shape]:
    """Return the shapes of the arrays that a system carries between two steps, by name.

    Arrays without entries are left out, except those that every run records.

    Args:
        chain: the chain.
        law: its control law.
        options: options of the machine code.
    """
    grasps = (len(chain.grasps),)
    own = own_shapes(chain.joint_count, *grasps, len(law.memory), options)
    known = shapes(chain) | own | {"slope": (increment_size(chain),), TOUCH_WRENCH: (6,)}
    found = {name: known[name] for name in traced_step.step_results(chain)}
    found = {**found, **own}
    found |= traced_modes.carried_in_modes(chain) if options.contacts == traced_modes.IN_MODES else {}
    found |= {"error": ()} if options.adaptive else {}
    found |= {stage_values.ASKED: stage_values.asked_shape(chain, options.stages)} if options.stages else {}
    if options.held:  # for velocity and, if they differ, for position; see `dynamics.closed.held_rows`
        found["held_rows"] = (*grasps, 2 if any(g.of_kind.rate_rows for g in chain.grasps.values()) else 1, 6)
    return {name: shape for name, shape in found.items() if math.prod(shape) or name in ALWAYS_CARRIED}


def own_shapes(joints: int, margins: int, memory: int, options: Options) -> dict[str, Shape]:
    """Return the shapes of those of these arrays that are only of steps, by name, without the slope.

    Args:
        joints: number of joints.
        margins: number of margins.
        memory: size of the law's memory.
        options: options of the machine code.
    """
    found: dict[str, Shape] = {"drive": (joints,), "memory": (memory,), "rank": (), "condition": ()}
    found |= {"margin": (margins,), "work": (4,), "gaps": (4,), "code": (), "count": (), "before": (memory,)}
    found |= {"worst_margin": (margins,), "worst_time": (margins,)}
    return found | ({"resolution": (4,)} if options.resolution else {})


def step_externals(structure: Structure, law: ControlLaw, states: Mapping[str, Shape]) -> dict[str, External]:
    """Return the arrays of a step: inputs, parameters, and carried arrays, whose shapes are given."""
    chain, options = structure.chain, structure.options
    own: dict[str, Shape] = dict.fromkeys((*STEP_INPUTS, "keep_rows", "notice", "generic_rank"), ()) | {
        "tolerance": (2,)
    }
    n = chain.joint_count
    own |= {"limits": (4, n), "added_armature": (n,), "added_torque": (n,)}
    of_law = {f"control.{name}": tuple(shape) for name, shape in law.parameters.items()}
    inputs = [*STEP_INPUTS, "object_wrench", *of_law]
    if options.link_wrenches:
        inputs += ["link_wrench", *(["trunk_link_wrench"] if chain.trunk is not None else ())]
    inputs += ["keep_rows"] if options.held else []
    inputs += ["notice"] if options.resolution else []
    inputs += ["tolerance"] if options.adaptive else []
    inputs += ["added_armature", "added_torque"] if options.implicit else []
    parameters = [*STEP_PARAMETERS, *(link_parameters(chain) if options.link_inertia else ())]
    parameters += BASE_MOTION if options.base_motion else ()
    parameters += ["grasp_R", "grasp_p", CONTACTS, "limits"]
    return externals(inputs, parameters, (), shapes(chain) | own | of_law) | carried_externals(states)


def carried_externals(states: Mapping[str, Shape]) -> dict[str, External]:
    """Return carried arrays of the given shapes as arrays of machine code."""
    return {f"last.{name}": External(shape, "carried") for name, shape in states.items()}


def _structure(chain: ClosedChain, options: Options, generic_rank: int) -> Structure:
    return Structure(chain, replace(options, held=0 <= generic_rank < chain.constraint_row_count))


def _parameters(chain: ClosedChain, generic_rank: int) -> dict[str, Array]:
    return parameters_of(chain, generic_rank) | {"limits": np.array(joint_limits(chain))}


def _functions(model: StepModel, tableau: Tableau) -> StepFunctions:
    options = model.structure.options
    take_step = stage_values.step if options.stages else traced_step.step
    take_step = traced_impulses.step if options.contacts else take_step
    take_step = traced_modes.step if options.contacts == traced_modes.IN_MODES else take_step
    instant = None if options.contacts else partial(after_jump, model)
    return partial(take_step, model, tableau), partial(traced_step.evaluation, model), instant


# of a step, of the slopes at the current states, and of an instant at which torques or inputs jump; None: a step of
# length zero that holds the state
StepFunctions = tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any] | None]


class StepCode(NamedTuple):
    """How a step of one kind of chain becomes machine code.

    Attributes:
        structure: returns what the compiler sees of a chain, with options and a generic rank, -1 if it is unknown.
        carried: returns the shapes of the arrays that a system carries between two steps, of chain, law and options.
        externals: returns the arrays of a step, of the structure, the law and the carried shapes.
        parameters: returns a chain's own parameters, of the chain and a generic rank.
        functions: returns the functions of a step.
        varied: the class of systems in which some of the numbers carry derivatives.
        constant: whether most numbers of the chain are constants of the code, and some joints are passive.
    """

    structure: Callable[[ClosedChain, Options, int], Structure]
    carried: Callable[[ClosedChain, ControlLaw, Options], dict[str, Shape]]
    externals: Callable[[Structure, ControlLaw, Mapping[str, Shape]], dict[str, External]]
    parameters: Callable[[ClosedChain, int], dict[str, Array]]
    functions: Callable[[StepModel, Tableau], StepFunctions]
    varied: Any
    constant: bool = False


SERIAL_STEP = StepCode(_structure, carried_shapes, step_externals, _parameters, _functions, VariedSystem)
