"""The arrays of a time step as machine code, and its schedule: the text of `advance`, traced."""

from __future__ import annotations

import math

from holdfast.compiled.externals import BASE_MOTION, LINKS, externals, shapes
from holdfast.compiled.structure import Structure
from holdfast.compiled.traced_chain import traced
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External, Schedule
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout import advance
from holdfast.simulation.rollout.law import ControlLaw
from holdfast.simulation.rollout.traced_motion import Motions
from holdfast.simulation.runge_kutta import Tableau

PARAMETERS = ("gravity", "generic_rank", "object_mass", "object_com", "object_inertia", "base_R", "base_p")


def carried_shapes(chain: ClosedChain, law: ControlLaw) -> dict[str, Shape]:
    """Return what a system is between two steps, by name; arrays without numbers are left out."""
    n, grasps = chain.joint_count, len(chain.grasps)
    own: dict[str, Shape] = {
        "slope": (2 * n + 16,),
        "drive": (n,),
        "memory": (len(law.memory),),
        "rank": (),
        "condition": (),
        "margin": (grasps,),
    }
    kept = {name: (shapes(chain) | own)[name] for name in advance.KEPT}
    books: dict[str, Shape] = {"work": (4,), "gaps": (4,), "code": (), "count": (), "before": (len(law.memory),)}
    found = kept | books | {"worst_margin": (grasps,), "worst_time": (grasps,)}
    return {name: shape for name, shape in found.items() if math.prod(shape)}


def step_externals(structure: Structure, law: ControlLaw) -> dict[str, External]:
    """Return the arrays of a step: inputs, parameters, and what is carried on."""
    chain = structure.chain
    own: dict[str, Shape] = {
        "begin": (),
        "step": (),
        "held": (),
        "least_margin": (),
        "least_joint_margin": (),
        "generic_rank": (),
        "contact": (len(chain.grasps), 6),
        "limits": (4, chain.joint_count),
    }
    told = {f"control.{name}": tuple(shape) for name, shape in law.parameters.items()}
    options = structure.options
    inputs = ["begin", "step", "held", "least_margin", "least_joint_margin", "object_wrench", *told]
    inputs += ["link_wrench"] if options.link_wrenches else []
    parameters = [
        *PARAMETERS,
        *(LINKS if options.link_inertia else ()),
        *(BASE_MOTION if options.base_motion else ()),
        "grasp_R",
        "grasp_p",
        "contact",
        "limits",
    ]
    carried = {f"last.{name}": External(shape, "carried") for name, shape in carried_shapes(chain, law).items()}
    return externals(inputs, parameters, (), shapes(chain) | own | told) | carried


def step_schedule(structure: Structure, law: ControlLaw, motions: Motions, tableau: Tableau) -> Schedule:
    """Return the schedule of one step."""
    return traced(step_externals(structure, law), lambda given: advance.step(structure, law, motions, tableau, given))


def evaluation_schedule(structure: Structure, law: ControlLaw, motions: Motions) -> Schedule:
    """Return the schedule that finds the slope at a step's start anew, under other torques or parameters."""
    return traced(step_externals(structure, law), lambda given: advance.evaluation(structure, law, motions, given))
