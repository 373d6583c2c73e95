"""What every element of a robot's file does to its motion: read, noted, refused, or nothing.

The rows cover URDF and what stands in it for Gazebo (SDF), ros2_control, Drake and MuJoCo. An element without a row is
noted by name; in URDF itself, a name that looks like a misspelling is refused.
"""

from __future__ import annotations

import difflib
from typing import NamedTuple

from holdfast.robots.urdf.document import Element, quoted, shortened


class Vocabulary(NamedTuple):
    """The attributes and children that an element may have.

    Attributes:
        attributes: attributes that are read.
        children: children that are read, each at most once except in <robot>.
        skipped: attributes and children without influence on the motion: visuals, contacts, safety, sensors, plugins,
            settings of solvers.
        extensions: children that are read by `extensions` and `transmissions`.
        noted: children that move masses or exert forces and are not read; noted unless they are zero or false.
        refused: children that couple bodies; refused unless these are locked together.
    """

    attributes: tuple[str, ...]
    children: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()
    extensions: tuple[str, ...] = ()
    noted: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()

    def effect(self, tag: str) -> str:
        """Return "read", "noted", "refused" or "none" for a child; "" if it is unknown.

        The old Gazebo wrote types after a colon (`joint:hinge`, `sensor:camera`).
        """
        rows = {"read": self.children + self.extensions, "noted": self.noted, "refused": self.refused}
        rows["none"] = self.skipped
        for known in (tag, tag.partition(":")[0]):
            for effect, names in rows.items():
                if known in names:
                    return effect
        return ""


_CHECKED = ("self_filter", "collision_checking", "self_collision_checking")
_GRAVITY = ("gravity", "turnGravityOff")
_SPRING = ("springStiffness", "springReference", "spring_stiffness", "spring_reference", "damping", "friction")
_OF_DRIVES = {  # what is said of a drive, by name without prefix, underscores and capitals
    **dict.fromkeys(("rotorinertia", "motorinertia", "actuatorinertia"), "inertia"),
    **dict.fromkeys(("armature", "reflectedinertia"), "armature"),
    **dict.fromkeys(("mechanicalreduction", "gearratio", "reduction", "gearreduction", "reductionratio"), "ratio"),
}
_DRIVE = (
    "rotor_inertia", "rotorInertia", "motor_inertia", "motorInertia", "drake:rotor_inertia", "armature", "gear_ratio",
    "gearRatio", "drake:gear_ratio", "mechanicalReduction", "mechanical_reduction", "actuator",
)  # fmt: skip
_PARTS = ("joint", "passive_joint", "gap_joint", "rollJoint", "flexJoint", "actuator", "leftActuator", "rightActuator")
_WIRED = ("hardwareInterface", "role", "offset", "robotNamespace", "motorTorqueConstant", "pulsesPerRevolution")
_ENCODER = ("deadBandUpper", "deadBandLower", "saturationUpper", "saturationLower", "ignoreTransmissionAbsoluteEncoder")
VOCABULARY = {
    "robot": Vocabulary(
        ("name",),
        ("link", "joint", "drake:joint"),
        ("version", "material", "sensor", "frame", "drake:collision_filter_group", "drake:proximity_properties"),
        ("gazebo", "transmission", "ros2_control", "mujoco"),
        refused=(
            "constraint", "loop", "loop_joint", "coupling", "gearbox", "force_element", "drake:linear_bushing_rpy",
            "drake:ball_constraint", "drake:distance_constraint", "drake:weld_constraint", "drake:tendon_constraint",
            "drake:coupler_constraint",
        ),
    ),
    "link": Vocabulary(
        ("name",),
        ("inertial",),
        ("type", "visual", "collision", "contact", "surface", "concave", "sensor", *_CHECKED),
        _GRAVITY,
        ("kinematic", "velocity_decay", "dampingFactor"),
    ),
    "inertial": Vocabulary((), ("origin", "mass", "inertia")),
    "mass": Vocabulary(("value",)),
    "inertia": Vocabulary(("ixx", "ixy", "ixz", "iyy", "iyz", "izz", "iyx", "izx", "izy")),
    "origin": Vocabulary(("xyz", "rpy")),
    "joint": Vocabulary(
        ("name", "type"),
        ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic", "drake:mimic"),
        ("calibration", "safety_controller", "hardwareInterface", "dont_collapse"),
        _DRIVE,
    ),
    "parent": Vocabulary(("link",)),
    "child": Vocabulary(("link",)),
    "axis": Vocabulary(("xyz",)),
    "limit": Vocabulary(
        ("lower", "upper", "effort", "velocity"),
        (),
        ("acceleration", "deceleration", "jerk", "drake:acceleration", "drake:jerk"),
    ),
    "dynamics": Vocabulary(("damping", "friction", "spring_stiffness", "spring_reference", "armature")),
    "mimic": Vocabulary(("joint", "multiplier", "offset")),
    # SDF of Gazebo: about a link or joint with `reference`, and otherwise about the whole model
    "gazebo": Vocabulary(
        ("reference",),
        skipped=(
            "material", "visual", "collision", "sensor", "plugin", "controller", "light", "projector", "battery",
            "particle_emitter", "frame", "laserRetro", "laser_retro", "mu", "mu1", "mu2", "kp", "kd", "fdir1", "maxVel",
            "minDepth", "maxContacts", "max_contacts", "selfCollide", "self_collide", "rayIntersect", "genTexCoord",
            "canonicalBody", "pose", "interface", "verbose", "provideFeedback", "implicitSpringDamper", "cfmDamping",
            "stopKp", "stopKd", "stopCfm", "stopErp", "fudgeFactor", "initial_joint_position", "preserveFixedJoint",
            "disableFixedJointLumping", "must_be_base_link", "allow_auto_disable", "audio_source", "audio_sink",
        ),
        extensions=(*_GRAVITY, *_SPRING, *_DRIVE, "axis", "dynamics", "physics"),
        noted=(
            "kinematic", "static", "enable_wind", "wind", "velocity_decay", "dampingFactor", "inertial", "link",
            "model", "include", "actor", "world", "axis2", "screw_thread_pitch", "thread_pitch", "gearbox_ratio",
        ),
        refused=("joint", "gearbox"),
    ),
    "sdf axis": Vocabulary(
        (),
        skipped=("xyz", "limit", "use_parent_model_frame", "initial_position"),
        extensions=("dynamics",),
        refused=("mimic",),
    ),
    "sdf dynamics": Vocabulary((), extensions=_SPRING),
    "sdf physics": Vocabulary(
        (),
        skipped=(
            "ode", "simbody", "bullet", "dart", "limit", "suspension", "cfm", "erp", "cfm_damping", "fudge_factor",
            "implicit_spring_damper", "provide_feedback", "bounce", "velocity",
        ),
        extensions=_SPRING,
        noted=("max_force", "must_be_loop_joint"),
    ),
    # ROS, with Drake's rotors; ros2_control gives the same names as <param name="...">
    "transmission": Vocabulary(
        ("name", "type"),
        skipped=("type", "plugin", "use_simulated_gripper_joint", "simulated_actuated_joint", "param", *_WIRED),
        extensions=_PARTS,
        noted=("compensator",),
    ),
    "transmission part": Vocabulary(
        ("name",),
        skipped=("type", "param", "command_interface", "state_interface", *_WIRED, *_ENCODER),
        noted=("drake:controller_gains", "compensator"),
    ),
    "ros2_control": Vocabulary(
        ("name",),
        skipped=("hardware", "gpio", "sensor", "param", "rw_rate", "type", "is_async"),
        extensions=("joint", "transmission"),
    ),
    "mujoco": Vocabulary((), skipped=("option", "size"), extensions=("compiler",)),
    "mujoco compiler": Vocabulary(
        (), noted=("boundmass", "boundinertia", "settotalmass", "balanceinertia", "inertiafromgeom")
    ),
}  # fmt: skip
VOCABULARY["drake:joint"], VOCABULARY["drake:mimic"] = VOCABULARY["joint"], VOCABULARY["mimic"]


def unread_notes(element: Element) -> tuple[str, ...]:
    """Return notes on everything that is not read in an element of URDF and in those of its children that are read.

    Raises:
        SceneError: a name is misspelt or duplicate, or the file contains unexpanded xacro.
    """
    known = VOCABULARY[element.tag]
    unknown = ", ".join(unknown_attributes(element, known))
    notes = [element.message(f"{shortened(unknown)}: unknown, not read")] if unknown else []
    seen: dict[str, int] = {}
    for child in element.children:
        if child.tag in known.children:
            if element.tag != "robot" and child.tag in seen:
                raise child.refuse(f"expected one <{child.tag}>, got a second (first in line {seen[child.tag]})")
            seen[child.tag] = child.line
        elif not known.effect(child.tag):
            refuse_misspelt(child, known.children + known.skipped + known.extensions)
            notes.append(child.message("unknown element, not read"))
        elif known.effect(child.tag) == "noted" and not is_off(child):
            notes.append(child.message("not read"))
    if element.stray:
        notes.append(element.message(f"text {quoted(element.stray[0])}, not read"))
    if element.tag != "robot":
        notes += [note for child in element.children if child.tag in known.children for note in unread_notes(child)]
    return tuple(notes)


def extension_notes(element: Element, row: str) -> list[str]:
    """Return notes on children of an extension that act on the motion and are not read, or are unknown."""
    known, notes = VOCABULARY[row], []
    for child in element.children:
        effect = known.effect(child.tag)
        if not effect and not (row.startswith("transmission") and of_drive(child.tag)):
            notes.append(child.message("unknown element, not read"))
        elif effect == "noted" and not is_off(child):
            notes.append(child.message("acts on the motion, but is not read"))
    return notes


def hidden_notes(element: Element) -> list[str]:
    """Return notes on what acts on the motion within a sensor, where it is not read."""
    found, waiting = [], [child for child in element.children if child.tag not in ("plugin", "controller")]
    for one in waiting:  # the loop appends to this list
        acts = one.tag in (*_GRAVITY, *_SPRING) or of_drive(one.tag) or (one.tag == "joint" and one.first("child"))
        found += [one.message("not read within a sensor")] if acts and not is_off(one) else []
        waiting += one.children
    return found


def of_drive(name: str) -> str:
    """Return "inertia" for a name of a rotor's inertia, "ratio" for one of a gear ratio, "armature", or ""."""
    return _OF_DRIVES.get(name.removeprefix("drake:").replace("_", "").lower(), "")


def text_of(element: Element) -> str:
    """Return the text in an element, or its attribute `value`."""
    return element.attributes.get("value", element.stray[0] if element.stray else "").strip()


def is_off(element: Element) -> bool:
    """Return whether an element and those in it contain nothing but zeros and false."""
    words = " ".join([*element.attributes.values(), *element.stray]).lower().split()
    off = all(word == "false" or not word.strip("+-0.") for word in words)
    return off and bool(words or element.children) and all(map(is_off, element.children))


def unknown_attributes(element: Element, known: Vocabulary) -> list[str]:
    """Return the attributes that are neither read nor skipped."""
    unknown = []
    for attribute in element.attributes:
        if attribute in known.attributes or attribute in known.skipped or attribute.split(":")[0] == "xmlns":
            continue
        if near := _misspelt(attribute, known.attributes):
            raise element.refuse(f"{quoted(attribute)}: unknown attribute. Did you mean '{near}'?")
        unknown.append(attribute)
    return unknown


def refuse_misspelt(child: Element, known: tuple[str, ...]) -> None:
    """Refuse an unknown element that is misspelt or unexpanded."""
    if near := _misspelt(child.tag, known):
        raise child.refuse(f"unknown element. Did you mean <{near}>?")
    if child.tag.startswith("xacro:"):
        raise child.refuse("expected plain URDF, got unexpanded xacro; try a file name that ends in .xacro")


def _misspelt(word: str, known: tuple[str, ...]) -> str:
    """Return the known name of which this one seems to be a misspelling, or ''."""
    if len(word) > 40:
        return ""
    near = difflib.get_close_matches(word.lower(), known, n=1, cutoff=0.8 if len(word) > 3 else 0.6)
    return near[0] if near else ""
