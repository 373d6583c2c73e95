"""Descriptions of the arrays of exported functions for the C header."""

from __future__ import annotations

import math
from collections.abc import Iterable

from holdfast.compiled.arm_functions import CLOSED
from holdfast.compiled.derivative_schedule import FOUND, WITH
from holdfast.compiler.schedule import External

LAST, CONTROL = "last.", "control."  # prefixes of the arrays that a step carries on, and of its torques

_MEANINGS = {
    "q": "joint positions, arms in order, base to tip, a trunk's first [rad or m]",
    "qd": "joint velocities [rad/s or m/s]",
    "qdd": "joint accelerations [rad/s^2 or m/s^2]",
    "tau": "joint torques [N m or N]",
    "object_pose": "quaternion w, x, y, z and origin of the object frame [m]",
    "object_twist": "angular velocity, velocity of the object's origin C, world axes",
    "object_acceleration": "angular acceleration, acceleration of C, world axes",
    "object_wrench": "external moment about C and force on the object, world axes",
    "link_wrench": "external moments and forces on the links of the arms, world axes",
    "trunk_link_wrench": "external moments and forces on the trunk's bodies, world axes",
    "grasp_wrench": "moment about the contact and force of each arm on the object, world axes",
    "base_wrench": "moment and force of each base on its arm about the base origin, world axes",
    "trunk_base_wrench": "moment and force of the base on the trunk, world axes",
    "bushing_wrench": "moment about the contact and force that each bushing exerts on the object, world axes",
    "largest_wrench": "the largest number among the wrenches on the trunk; beside it, what its base needs must vanish",
    "contact_acceleration": "accelerations along the grasps' freedoms",
    "floating_pose": "quaternion w, x, y, z and origin of the floating base [m]",
    "floating_twist": "angular velocity, velocity of the floating base's origin, world axes",
    "floating_acceleration": "the floating base's acceleration, world axes",
    "gravity": "gravity, world axes [m/s^2]",
    "about": "the point that momentum is about [m]",
    "generic_rank": "rank of the grasp constraint away from singular configurations; -1: not known",
    "object_mass": "mass of the object [kg]",
    "object_com": "its mass centre, object axes [m]",
    "object_inertia": "its inertia about the mass centre, object axes [kg m^2]",
    "link_mass": "masses of the arms' links [kg]",
    "link_com": "their mass centres, link axes [m]",
    "trunk_link_mass": "masses of the trunk's bodies, a floating base first [kg]",
    "trunk_link_com": "their mass centres, body axes [m]",
    "trunk_link_inertia": "their inertias about the mass centres, body axes [kg m^2]",
    "link_inertia": "their inertias about the mass centres, link axes [kg m^2]",
    "base_R": "each arm's base axes to world axes (of an arm on a trunk: to those of its link)",
    "base_p": "the bases' origins [m]",
    "base_twist": "the bases' angular velocity and velocity, world axes",
    "base_acceleration": "their accelerations, world axes",
    "trunk_base_twist": "angular velocity and velocity of the trunk's base, world axes",
    "trunk_base_acceleration": "its acceleration, world axes",
    "grasp_R": "each contact's axes to object axes",
    "grasp_p": "the contacts' origins, object frame [m]",
    "rank": "independent rows of the grasp constraint",
    "status": "as returned",
    "condition": "of the grasp constraint",
    "t": "time [s]",
    "memory": "what the law remembers",
    "kept": "what it will have to remember: copy it to `memory` once a sample is over",
    "before": "what the law remembered before the last step",
    "begin": "the time at which steps are counted from [s]",
    "step": "length of the step [s]",
    "held": "1: the state is given as it is and not closed; 0 in all ordinary steps",
    "least_margin": "the step is refused where a grasp's margin falls below it [N]",
    "least_joint_margin": "the step is refused where a joint is nearer to a limit",
    "search": "1: refuse steps that pass a singular configuration",
    "keep_rows": "1: hold the rows of the constraint that were held before",
    "held_rows": "which rows of the constraint are held",
    "contact": "what the grasps' margins are made of",
    "limits": "joint limits",
    "added_armature": "armature that a stage adds [kg m^2 or kg]",
    "added_torque": "torque that a stage adds [N m or N]",
    "slope": "rates at the step's end, with which the next step begins",
    "drive": "torques of the drives [N m or N]",
    "margin": "the grasps' margins [N]",
    "worst_margin": "the least margins so far [N]",
    "worst_time": "when they were [s]",
    "work": "work of drives, damping and friction, bases, external wrenches so far [J]",
    "gaps": "largest open gaps: position, velocity; before projection and after",
    "code": "as returned",
    "count": "steps taken",
    "mass_matrix": "joint mass matrices of the arms, one after the other, by rows",
    "jacobian": "Jacobians of the arms' tips, one after the other, by rows",
    "position": "of grasps: gaps of their rows [rad, m]; of joints: distances to the nearer end of the range",
    "velocity": "velocity gaps of the grasps' rows",
    "rate": "rate limits minus the sizes of the joint velocities",
    "effort": "effort limits minus the sizes of the joint torques",
    "grasp_margins": "the grasps' margins; infinite without a limit [N]",
    "wrist_wrenches": "the grasp wrenches in tip axes",
    "joint_limits": "of the joints: lowest and highest positions, rate limits, effort limits; infinite for none",
    "energy": "energy [J]",
    "momentum": "angular and linear momentum, world axes",
    "centre_of_mass": "of links and object [m]",
    "object_mobility": "what acceleration of the object a wrench at C makes",
    "frame": "axes to world axes by rows, then origin [m], frame after frame",
    "units": "the identity matrix",
}


def fields_of(externals: Iterable[str]) -> dict[str, str]:
    """Return the C names of arrays, without prefix where possible."""
    found: dict[str, str] = {}
    taken = {"workspace", *_KEYWORDS}
    for name in externals:
        field = name.removeprefix(LAST).removeprefix(CONTROL).replace(".", "_")
        while field in taken:
            field += "_"
        taken.add(field)
        found[name] = field
    return found


def meaning(name: str) -> str:
    """Return the description of an array; "" for a parameter of a law."""
    for prefix, words in ((WITH, "what is multiplied, as"), (FOUND, "derivatives by or of"), (CLOSED, "closed:")):
        if name.startswith(prefix):
            rest = name.removeprefix(prefix)
            return f"{words} {_MEANINGS[rest]}" if rest in _MEANINGS else f"{words} {rest}"
    return _MEANINGS.get(name.removeprefix(LAST).removeprefix(CONTROL), "")


def extent(external: External) -> str:
    """Return an array's shape in C syntax; [1] for a number."""
    return "".join(f"[{n}]" for n in external.shape) if math.prod(external.shape) and external.shape else "[1]"


_KEYWORDS = frozenset(
    """
    alignas alignof and asm auto bool break case catch char class const continue default delete do double else enum
    explicit export extern false float for friend goto if inline int long mutable namespace new not operator or
    private protected public register restrict return short signed sizeof static struct switch template this throw
    true try typedef typename union unsigned using virtual void volatile while
    """.split()  # noqa: SIM905
)
