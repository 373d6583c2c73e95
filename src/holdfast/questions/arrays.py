"""The arrays that questions about a chain take and return: name, shape, unit, frame and point, each once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from itertools import accumulate
from typing import Any, Literal, NamedTuple

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp, WrenchLimits
from holdfast.model.link import Link
from holdfast.model.trunk import bodies_of
from holdfast.spatial.scalar import Array
from holdfast.state import State, found_state

Shape = tuple[int, ...]
Axes = tuple[int | str, ...]  # lengths, or names of lengths in `sizes`
Role = Literal["state", "input", "parameter", "result", "law", "step"]


class Row(NamedTuple):
    """An array.

    Attributes:
        name: its name in calls, machine code and files.
        axes: its axes, or a function of the chain that returns its shape.
        unit: of its numbers.
        meaning: what it is, with frame and reference point, in a few words.
        role: a part of the state, an input, a parameter of the model, a result, or an array of laws or of steps.
        field: the field of `State` or `Inputs` that holds it; "" if none does.
        of: the chains that have it: all, those with a "trunk", those whose trunk is "standing", or those that "float".
        value: a parameter's numbers for a chain; None if the chain does not hold them.
        labels: names of the entries along its last axis, where they do not follow from the unit; see `entries`.
    """

    name: str
    axes: Axes | Callable[[ClosedChain], Shape]
    unit: str
    meaning: str
    role: Role = "result"
    field: str = ""
    of: str = ""
    value: Callable[[ClosedChain], Any] | None = None
    labels: tuple[str, ...] = ()

    def shape(self, chain: ClosedChain) -> Shape:
        """Return its shape for a chain."""
        return self.axes(chain) if callable(self.axes) else shape_of(self.axes, chain)

    def gradient_shape(self, chain: ClosedChain) -> Shape:
        """Return the shape of gradients by it; those by poses are [turn; shift]."""
        shape = self.shape(chain)
        return (*shape[:-1], 6) if self.is_pose else shape

    def exists(self, chain: ClosedChain) -> bool:
        """Return whether a chain has it."""
        return {"": True, "trunk": chain.trunk is not None, "float": chain.floats}.get(self.of, not chain.floats)

    @property
    def is_pose(self) -> bool:
        """Whether it holds poses, wxyz_xyz."""
        return self.name.endswith("_pose")

    @property
    def entries(self) -> list[tuple[str, str]]:
        """Name and unit of each entry along its last axis; none if they have no names.

        A unit with commas, such as that of wrenches, lists the units of equal parts of the axis.
        """
        if self.is_pose:
            return [*((name, "") for name in ("qw", "qx", "qy", "qz")), *((axis, "m") for axis in "xyz")]
        names = self.labels or [f"{half}_{axis}" for half in HALVES.get(self.unit, ()) for axis in "xyz"]
        units = self.unit.split(", ")
        return [(name, units[k * len(units) // len(names)]) for k, name in enumerate(names)]

    @property
    def text(self) -> str:
        """Its shape, meaning and unit, as documentation gives them."""
        known = () if callable(self.axes) else self.axes
        inside = ", ".join(map(str, known)) + ("," if len(known) == 1 else "")
        shape = "" if callable(self.axes) else f"({inside}) " if known else ""
        return f"{shape}{self.meaning}{f' [{self.unit}]' if self.unit else ''}"


# names of the halves of spatial vectors, by unit
HALVES = {
    "N m, N": ("moment", "force"),
    "rad/s, m/s": ("omega", "v"),
    "rad/s^2, m/s^2": ("omega_dot", "v_dot"),
    "N m s, N s": ("angular", "linear"),
}


def value_of(name: str, chain: ClosedChain) -> Array:
    """Return a parameter's numbers for a chain, in its shape; they may be traced."""
    row = ARRAYS[name]
    assert row.value is not None
    found = np.array(row.value(chain))
    return (found if found.dtype == object else found.astype(float)).reshape(row.shape(chain))


def sizes(chain: ClosedChain) -> dict[str, int]:
    """Return the lengths of a chain's axes by name."""
    return {
        "n": chain.joint_count,
        "arms": len(chain.arms),
        "grasps": len(chain.grasps),
        "links": sum(arm.joint_count for arm in chain.arms.values()),
        "bodies": len(bodies_of(chain.trunk)),
        "freedoms": chain.contact_freedom_count,
        "couplings": len(chain.all_couplings),
        "touches": 0 if chain.touching is None else len(chain.touching.names),
    }


def shape_of(axes: Axes, chain: ClosedChain) -> Shape:
    """Return the shape of axes for a chain."""
    known = sizes(chain)
    return tuple(known[axis] if isinstance(axis, str) else axis for axis in axes)


def starts(sizes: Iterable[int]) -> list[int]:
    """Return the offsets of consecutive parts of the given sizes, and the end of the last part."""
    return list(accumulate(sizes, initial=0))


def contact_of(grasp: Grasp) -> Array:
    """Return the numbers that determine the margin of a grasp.

    They are (7,): 1 if it is one-sided, mu, `Grasp.contact_size`, largest moment, largest force, lever.
    """
    contact, limits = grasp.contact, grasp.wrench_limits or WrenchLimits()
    one_sided = [0.0, 1.0] if contact is None else [1.0, contact.mu]
    return np.array([*one_sided, *grasp.contact_size, limits.moment, limits.force, limits.lever], dtype=float)


def _of_model(name: str, axes: Axes, unit: str, meaning: str, value: Callable[[ClosedChain], Any], of: str = "") -> Row:
    return Row(name, axes, unit, meaning, "parameter", "", of, value)


def _links(chain: ClosedChain) -> list[Link]:
    return [link for arm in chain.arms.values() for link in arm.links]


def _each(what: str, bodies: Iterable[Any]) -> list[Any]:
    return [getattr(body, what) for body in bodies]


POSE, WRENCH, TWIST, ACCELERATION = (7,), (6,), (6,), (6,)
RAD, RATE, RATE_2, TORQUE = "rad or m", "rad/s or m/s", "rad/s^2 or m/s^2", "N m or N"
_ROWS = (
    # The state.
    Row("q", ("n",), RAD, "joint positions, arms in order, base to tip, a trunk's first", "state", "q"),
    Row("qd", ("n",), RATE, "joint rates", "state", "qd"),
    Row("object_pose", POSE, "", "wxyz_xyz of the object frame", "state", "object_pose"),
    Row("object_twist", TWIST, "rad/s, m/s", "[omega; v of C] of the object, world axes", "state", "object_twist"),
    Row("floating_pose", POSE, "", "wxyz_xyz of the floating base", "state", "base_pose", "float"),
    Row("floating_twist", TWIST, "rad/s, m/s", "[omega; v of its origin] of the floating base, world axes", "state",
        "base_twist", "float"),
    # What acts, and how bases move.
    Row("qdd", ("n",), RATE_2, "joint accelerations", "input"),
    Row("tau", ("n",), TORQUE, "joint torques", "input"),
    Row("grasp_wrench", ("arms", 6), "N m, N", "wrench [moment; force] of each arm on the object about the contact"
        " point, world axes", "input"),
    Row("object_wrench", WRENCH, "N m, N", "external wrench on the object about C, world axes", "input",
        "object_wrench"),
    Row("link_wrench", ("links", 6), "N m, N", "external wrench on each link of the arms about its frame's origin,"
        " world axes", "input", "link_wrenches"),
    Row("trunk_link_wrench", ("bodies", 6), "N m, N", "external wrench on each body of the trunk about its frame's"
        " origin, world axes", "input", "trunk_link_wrenches", "trunk"),
    Row("base_twist", ("arms", 6), "rad/s, m/s", "[omega; v] of each base's origin, world axes", "input",
        "base_twists"),
    Row("base_acceleration", ("arms", 6), "rad/s^2, m/s^2", "its derivative", "input", "base_accelerations"),
    Row("trunk_base_twist", TWIST, "rad/s, m/s", "[omega; v] of the origin of the trunk's base, world axes", "input",
        "trunk_base_twist", "standing"),
    Row("trunk_base_acceleration", ACCELERATION, "rad/s^2, m/s^2", "its derivative", "input",
        "trunk_base_acceleration", "standing"),
    Row("about", (3,), "m", "the point about which momentum is taken, world axes", "input"),
    # The model.
    _of_model("gravity", (3,), "m/s^2", "gravity, world axes", lambda chain: chain.gravity),
    _of_model("object_mass", (), "kg", "mass of the object", lambda chain: chain.held_object.mass),
    _of_model("object_com", (3,), "m", "mass centre of the object, object axes", lambda chain: chain.held_object.com),
    _of_model("object_inertia", (3, 3), "kg m^2", "inertia of the object about its mass centre, object axes",
        lambda chain: chain.held_object.inertia),
    Row("grasp_pose", ("grasps", 7), "", "wxyz_xyz of each contact frame in the object frame", "parameter"),
    _of_model("grasp_R", ("grasps", 3, 3), "", "each contact's axes to object axes",
        lambda chain: [grasp.frame.R for grasp in chain.grasps.values()]),
    _of_model("grasp_p", ("grasps", 3), "m", "contact points, object frame",
        lambda chain: [grasp.frame.p for grasp in chain.grasps.values()]),
    Row("base_pose", ("arms", 7), "", "wxyz_xyz of each arm's base in the world; of an arm on a trunk, in its body",
        "parameter"),
    _of_model("base_R", ("arms", 3, 3), "", "each base's axes to world axes; of an arm on a trunk, to its body's",
        lambda chain: [arm.base.R for arm in chain.arms.values()]),
    _of_model("base_p", ("arms", 3), "m", "origins of the bases",
        lambda chain: [arm.base.p for arm in chain.arms.values()]),
    _of_model("armature", ("n",), "kg m^2 or kg", "rotor inertias felt at the joints",
        lambda chain: [joint.armature for joint in chain.all_joints]),
    _of_model("damping", ("n",), "N m s/rad or N s/m", "viscous damping of the joints",
        lambda chain: [joint.damping for joint in chain.all_joints]),
    _of_model("link_mass", ("links",), "kg", "masses of the arms' links", lambda chain: _each("mass", _links(chain))),
    _of_model("link_com", ("links", 3), "m", "their mass centres, link axes",
        lambda chain: _each("com", _links(chain))),
    _of_model("link_inertia", ("links", 3, 3), "kg m^2", "their inertias about the mass centres, link axes",
        lambda chain: _each("inertia", _links(chain))),
    _of_model("trunk_link_mass", ("bodies",), "kg", "masses of the trunk's bodies, a floating base first",
        lambda chain: _each("mass", bodies_of(chain.trunk)), "trunk"),
    _of_model("trunk_link_com", ("bodies", 3), "m", "their mass centres, body axes",
        lambda chain: _each("com", bodies_of(chain.trunk)), "trunk"),
    _of_model("trunk_link_inertia", ("bodies", 3, 3), "kg m^2", "their inertias about the mass centres, body axes",
        lambda chain: _each("inertia", bodies_of(chain.trunk)), "trunk"),
    _of_model("joint_limits", (4, "n"), "", "lowest and highest positions, rate limits and effort limits of the"
        " joints; infinite for none", lambda chain: np.transpose(
            [(*joint.position_limits, joint.rate_limit, joint.effort_limit) for joint in chain.freedoms])),
    _of_model("contact", ("grasps", 7), "", "one-sided or not, friction, two sizes of the contact, largest moment"
        " and force, lever", lambda chain: [contact_of(grasp) for grasp in chain.grasps.values()]),
    Row("acceleration", ACCELERATION, "rad/s^2, m/s^2", "wanted [omega_dot; v_dot of C], world axes", "input"),
    _of_model("effort_share", (), "", "share of the joints' effort limits that may be used", lambda chain: 1.0),
    _of_model("demanded_margin", ("grasps",), "N", "margins that the grasps must keep",
        lambda chain: np.zeros(len(chain.grasps))),
    _of_model("least_normal", ("grasps",), "N", "smallest forces along the contacts' normals",
        lambda chain: np.full(len(chain.grasps), -np.inf)),
    _of_model("most_normal", ("grasps",), "N", "largest forces along them",
        lambda chain: np.full(len(chain.grasps), np.inf)),
    _of_model("acceleration_limits", (2, "n"), RATE_2, "lowest and highest joint accelerations",
        lambda chain: [[-np.inf] * chain.joint_count, [np.inf] * chain.joint_count]),
    _of_model("task", (6, 6), "", "rows S on the object's acceleration, of which S acceleration is asked; a row of"
        " zeros asks nothing", lambda chain: np.eye(6)),
    _of_model("task_weight", (), "s^2/rad or s^2/m", "weight of the distance from what is asked of the object, which"
        " then gives way to the limits", lambda chain: 100.0),
    _of_model("effort_weight", ("n",), "1/(N m)^2 or 1/N^2", "weights of squared torques",
        lambda chain: [joint.effort_limit**-2.0 if math.isfinite(joint.effort_limit) else 1.0
            for joint in chain.all_joints]),
    _of_model("wish", ("arms", 6), "N m, N", "wished wrench of each arm on the object about the contact point, contact"
        " axes", lambda chain: np.zeros((len(chain.arms), 6))),
    _of_model("wished_qdd", ("n",), RATE_2, "wished joint accelerations, as far as the object leaves them free",
        lambda chain: np.zeros(chain.joint_count)),
    _of_model("force_scale", (), "N", "unit of forces; 0: the size of the force that the object needs, at least 1 N",
        lambda chain: 0.0),
    _of_model("wrench_weight", (), "", "weight of the wrenches, in units of the force scale", lambda chain: 0.01),
    _of_model("acceleration_weight", (), "", "weight of the joint accelerations, in units of 10 rad/s^2 or m/s^2",
        lambda chain: 1.0),
    _of_model("price", (), "", "cost of passing the limits by the force scale", lambda chain: 1e4),
    _of_model("barrier", (), "", "slack times multiplier of every limit at the end, which smooths the answer; 0: none,"
        " and no derivatives",
        lambda chain: 0.0),
    Row("generic_rank", (), "", "rank of the grasp constraint away from singular configurations; -1: not known",
        "parameter"),
    Row("units", (), "", "the identity matrix", "parameter"),
    # Results of forward dynamics.
    Row("object_acceleration", ACCELERATION, "rad/s^2, m/s^2", "[omega_dot; v_dot of C] of the object, world axes"),
    Row("contact_acceleration", ("freedoms",), "", "accelerations along the freedoms of the grasps"),
    Row("base_wrench", ("arms", 6), "N m, N", "wrench of each base on its arm about the base's origin, world axes"),
    Row("trunk_base_wrench", WRENCH, "N m, N", "wrench of the base on the trunk about the base's origin, world axes",
        "result", "", "trunk"),
    Row("floating_acceleration", ACCELERATION, "rad/s^2, m/s^2", "[omega_dot; v_dot of its origin] of the floating"
        " base, world axes", "result", "base_acceleration", "float"),
    Row("rank", (), "", "number of independent rows of the grasp constraint"),
    Row("status", (), "", "status, as returned"),
    Row("condition", (), "", "condition of the grasp constraint"),
    Row("touch_force", ("touches", 3), "N", "force of the world on the object at every candidate of `touching`, world"
        " axes"),
    Row("touch_gap", ("touches",), "m", "distances between the candidates and their shapes"),
    Row("touch_mode", ("touches",), "", "numbers of `ContactMode`: open, sticks, slips, closed"),
    Row("touch_status", (), "", "whether the laws of contact are satisfied"),
    Row("touch_residual", (), "", "violation of the laws of contact, relative to the accelerations"),
    Row("touch_start", ("touches", 3), "N", "forces of the world from which those of a similar instant are looked for,"
        " world axes", "input"),
    Row("bushing_wrench", ("arms", 6), "N m, N", "wrench that each bushing exerts on the object about the contact"
        " point, world axes"),
    Row("largest_wrench", (), "", "largest number among the wrenches on the trunk, by which what its base needs is"
        " judged"),
    # Control laws.
    Row("t", (), "s", "time", "law"),
    Row("memory", (), "", "memory of the law", "law"),
    Row("kept", (), "", "next memory; copy it to `memory` after each sample", "law"),
    # Steps of rollouts.
    Row("before", (), "", "memory of the law before the last step", "step"),
    Row("begin", (), "s", "time from which steps are counted", "step"),
    Row("step", (), "s", "length of the step", "step"),
    Row("held", (), "", "1: the state is taken as it is and not closed; 0 in ordinary steps", "step"),
    Row("least_margin", (), "N", "a step is refused where a grasp's margin falls below it", "step"),
    Row("least_joint_margin", (), "", "a step is refused where a joint's margin falls below it", "step"),
    Row("search", (), "", "1: refuse steps that pass a singular configuration", "step"),
    Row("keep_rows", (), "", "1: hold the rows of the constraint that were held before", "step"),
    Row("held_rows", (), "", "which rows of the constraint are held", "step"),
    Row("limits", (4, "n"), "", "as joint_limits", "step"),
    Row("added_armature", ("n",), "kg m^2 or kg", "armature that a stage adds", "step"),
    Row("added_torque", ("n",), TORQUE, "torque that a stage adds", "step"),
    Row("slope", (), "", "rates at the end of the step, with which the next one begins", "step"),
    Row("drive", ("n",), TORQUE, "torques of the drives", "step"),
    Row("margin", ("grasps",), "N", "margins of the grasps", "step"),
    Row("worst_margin", ("grasps",), "N", "least margins so far", "step"),
    Row("worst_time", ("grasps",), "s", "when they occurred", "step"),
    Row("work", (4,), "J", "work so far of drives, of damping and friction, of bases, of external wrenches", "step"),
    Row("gaps", (4,), "", "largest gaps: position, velocity, before projection and after", "step"),
    Row("code", (), "", "status, as returned", "step"),
    Row("count", (), "", "number of steps taken", "step"),
)  # fmt: skip
ARRAYS: Mapping[str, Row] = {row.name: row for row in _ROWS}

STATE, FLOATING = ("q", "qd", "object_pose", "object_twist"), ("floating_pose", "floating_twist")
_STATE_FIELDS = {name: ARRAYS[name].field for name in (*STATE, *FLOATING)}
BASE_MOTION = ("base_twist", "base_acceleration")  # parameters if bases move
TRUNK_BASE_MOTION = ("trunk_base_twist", "trunk_base_acceleration")
MOVING = (*BASE_MOTION, *TRUNK_BASE_MOTION)
LINKS = ("link_mass", "link_com", "link_inertia")
TRUNK_LINKS = tuple(f"trunk_{name}" for name in LINKS)
OBJECT = ("object_mass", "object_com", "object_inertia")
LIMITS, CONTACTS = "joint_limits", "contact"  # `forces.margins.joint_limits`, `contacts_of`
ACCELERATION_LIMITS = "acceleration_limits"
TASK, TASK_WEIGHT = "task", "task_weight"
DISTRIBUTED = (
    *("effort_share", "demanded_margin", "least_normal", "most_normal"),
    *("effort_weight", "wish", "wished_qdd", "force_scale", "wrench_weight", "acceleration_weight", "price"),
    "barrier",
)  # what the distribution of forces is asked
# Users pass poses as wxyz_xyz; machine code reads rotation matrices, and origins if they matter.
POSE_ARRAYS = {"base_pose": ("base_R", "base_p"), "grasp_pose": ("grasp_R", "grasp_p")}
INTERNAL = {"generic_rank", LIMITS, CONTACTS, *(name for pair in POSE_ARRAYS.values() for name in pair)}
STATE_AND_TORQUES = ("q", "qd", "tau", "object_pose", "object_twist")

# The arguments of forward dynamics, in order.
OF_JOINTS = ("q", "qd", "tau", "armature", "damping")
OF_LINKS = (*LINKS, "link_wrench")
OF_OBJECT = (*OBJECT, "object_wrench")  # not in the equations of the arms
BODY_POSES = ("object_pose", "grasp_pose", "base_pose")
POSES = (*BODY_POSES, "floating_pose")
ARGUMENTS = (*OF_JOINTS, "object_twist", *OF_OBJECT, *BODY_POSES, "gravity", *BASE_MOTION, *OF_LINKS)
RESULTS = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")
TOUCH_RESULTS = ("touch_force", "touch_gap", "touch_mode", "touch_status", "touch_residual")
TOUCH_START = "touch_start"  # an input on request
FLOATING_RESULT, BASE_RESULT = "floating_acceleration", "trunk_base_wrench"


def arguments_of(chain: ClosedChain) -> tuple[str, ...]:
    """Return the names of the arguments with respect to which a chain's forward dynamics can be differentiated."""
    if chain.trunk is None:
        return ARGUMENTS
    return (*ARGUMENTS, *TRUNK_LINKS, "trunk_link_wrench", *(FLOATING if chain.floats else TRUNK_BASE_MOTION))


def results_of(chain: ClosedChain) -> tuple[str, ...]:
    """Return the names of a chain's results of forward dynamics; `floating_acceleration` is that of a floating base."""
    if chain.trunk is None:
        return RESULTS
    return (*RESULTS, *([FLOATING_RESULT] if chain.floats else []), BASE_RESULT)


def state_fields(chain: ClosedChain) -> dict[str, str]:
    """Return the fields of a chain's state by the names of its arrays."""
    return {name: _STATE_FIELDS[name] for name in (*STATE, *(FLOATING if chain.floats else ()))}


def state_of(arrays: Mapping[str, Array], row: int | tuple[int, ...]) -> State:
    """Return one of several states from their arrays by name, without changing any bits."""
    found = {field: arrays[name][row].copy() for name, field in _STATE_FIELDS.items() if name in arrays}
    for x in found.values():
        x.setflags(write=False)
    return found_state(found)


def link_parameters(chain: ClosedChain) -> tuple[str, ...]:
    """Return the names of the inertial parameters of a chain's links."""
    return LINKS if chain.trunk is None else (*LINKS, *TRUNK_LINKS)


def shapes(chain: ClosedChain) -> dict[str, Shape]:
    """Return the shapes of all arrays of a chain, by name."""
    found = {name: row.shape(chain) for name, row in ARRAYS.items()}
    return {**found, **_shapes_of_forest(chain)} if chain.beyond_serial else found


def _shapes_of_forest(chain: ClosedChain) -> dict[str, Shape]:
    """Return the shapes of arrays of chains with branches, which may hold several objects, or none."""
    count, closures = len(chain.free_objects), len(chain.as_forest.closures)
    several = () if count == 1 else (count,)
    own: dict[str, Shape] = {"q": (chain.position_count,), "object_pose": (*several, 7)}
    own |= dict.fromkeys(("object_twist", "object_wrench", "object_acceleration"), (*several, 6))
    own |= {"grasp_wrench": (closures, 6), CONTACTS: (closures, 7)}
    return own | {"coupling_force": (len(chain.all_couplings),)}


def gradient_shapes(chain: ClosedChain) -> dict[str, Shape]:
    """Return the shapes of the gradients with respect to every argument."""
    of_base = () if chain.trunk is None else (*FLOATING, *TRUNK_BASE_MOTION)
    return {name: ARRAYS[name].gradient_shape(chain) for name in dict.fromkeys((*arguments_of(chain), *of_base))}


def link_rows(chain: ClosedChain) -> dict[str, slice]:
    """Return the rows of each arm's links in arrays of all arms' links."""
    ends = starts(arm.joint_count for arm in chain.arms.values())
    return {name: slice(a, b) for name, a, b in zip(chain.arms, ends[:-1], ends[1:], strict=True)}
