"""Forward dynamics as a schedule: the reference's own functions, traced."""

from __future__ import annotations

from typing import Any

from holdfast.compiled import object_stages
from holdfast.compiled.arm_stages import BASE_MOTION, LINKS, ArmType, held_arm, lone_arm
from holdfast.compiled.filter_writer import FilterWriter
from holdfast.compiled.object_stages import verdict
from holdfast.compiled.structure import Structure
from holdfast.compiled.traced_chain import Given, traced, traced_chain, traced_inputs, traced_state
from holdfast.compiled.wiring import externals, shapes
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External, Schedule
from holdfast.compiler.stage import Stage
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.sequential import sequential

GUARDED = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")


def forward_externals(structure: Structure) -> dict[str, External]:
    """Return the arrays of compiled forward dynamics: inputs, parameters, results."""
    chain, options = structure.chain, structure.options
    inputs = ["q", "qd", "tau", "object_pose", "object_twist", "object_wrench"]
    parameters = ["gravity", "generic_rank", "object_mass", "object_com", "object_inertia"]
    parameters += ["base_R", *(BASE_MOTION if options.base_motion else ()), "grasp_R", "grasp_p"]
    if options.link_wrenches:
        inputs.append("link_wrench")
    if options.link_inertia:
        parameters += LINKS
    verdict: dict[str, Shape] = {"generic_rank": (), "rank": (), "status": (), "condition": ()}
    outputs = (*GUARDED, "rank", "status", "condition")
    return externals(inputs, parameters, outputs, shapes(chain) | verdict)


def forward_schedule(structure: Structure) -> Schedule:
    """Return the schedule of one chain's forward dynamics."""
    externals = forward_externals(structure)
    guarded = tuple(name for name in GUARDED if externals[name].size)
    return traced(externals, lambda given: forward(structure, given), "status", guarded)


def forward(structure: Structure, given: Given) -> dict[str, Any]:
    """Return the outputs of forward dynamics: the reference's `sequential`, run on what is given."""
    chain = traced_chain(structure, given)
    motion = chain_motion(chain, traced_state(chain, given), given["tau"], traced_inputs(chain, given))
    found = sequential(motion, structure.options.route)
    whole = chain_solution(motion, found, structure.options.route)
    status = verdict(found.rank, given["generic_rank"][()], chain.constraint_row_count)
    judged = {"rank": found.rank, "status": status, "condition": 1.0 / found.weakest_pivot}
    return {name: getattr(whole, name) for name in GUARDED} | judged


def forward_calls(writer: FilterWriter) -> None:
    """Add the calls of one evaluation of forward dynamics."""
    structure = writer.structure
    options = structure.options

    def arm(row: int) -> Stage:
        kind = structure.kind(row)
        of = ArmType(structure.arm(row), kind, options)
        return held_arm(of, options.route) if kind else lone_arm(of, options.route)

    writer.alone("object", object_stages.held_object(writer.dense_first, structure.chain.contact_freedom_count))
    writer.arm_groups("", arm)
    writer.solve("", structure.kind, 6 * len(structure.held_rows))
