"""Forward dynamics as a schedule: arms outward, the object's filter out and back, arms back.

object -> arms (side by side) -> filter, arm after arm -> turning point
<- arms (side by side) <- filter, arm after arm <-
"""

from __future__ import annotations

from holdfast.compiled import object_stages
from holdfast.compiled.arm_stages import BASE_MOTION, LINKS, ArmType, held_arm, lone_arm
from holdfast.compiled.filter_writer import FilterWriter
from holdfast.compiled.structure import Structure
from holdfast.compiled.wiring import externals, shapes
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External, Schedule
from holdfast.compiler.stage import Stage

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
    writer = FilterWriter(structure, forward_externals(structure))
    forward_calls(writer)
    guarded = tuple(name for name in GUARDED if writer.externals[name].size)
    return Schedule(
        writer.externals,
        writer.internals,
        writer.groups,
        tuple(writer.prepare),
        tuple(writer.calls),
        "status",
        guarded,
    )


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
