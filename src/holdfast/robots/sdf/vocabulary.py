"""What every element of an SDF file does to the motion of its model: read, noted, refused, or nothing."""

from __future__ import annotations

from holdfast.robots.urdf.document import Element, shortened
from holdfast.robots.urdf.vocabulary import Vocabulary, is_off, refuse_misspelt, unknown_attributes

_POSE = ("pose",)
SDF_VOCABULARY = {
    "sdf": Vocabulary(("version",), ("model", "world"), ("light",)),
    "world": Vocabulary(
        ("name",),
        ("model",),
        (
            "physics", "scene", "light", "atmosphere", "magnetic_field", "spherical_coordinates", "audio", "gui",
            "namespace", "plugin", "state", "road", "frame", "population",
        ),
        noted=("gravity", "wind", "actor"),
        refused=("include", "joint"),
    ),
    "model": Vocabulary(
        ("name", "canonical_link"),
        ("link", "joint", "frame", "pose", "static"),
        ("namespace", "placement_frame", "self_collide", "allow_auto_disable", "plugin", "gripper"),
        noted=("enable_wind",),
        refused=("model", "include"),
    ),
    "link": Vocabulary(
        ("name",),
        ("pose", "inertial", "gravity"),
        (
            "visual", "collision", "sensor", "light", "self_collide", "must_be_base_link", "audio_sink",
            "audio_source", "battery", "particle_emitter", "projector",
        ),
        noted=("kinematic", "velocity_decay", "enable_wind"),
    ),
    "frame": Vocabulary(("name", "attached_to"), _POSE),
    "pose": Vocabulary(("relative_to", "rotation_format", "degrees"), skipped=("frame",)),
    "inertial": Vocabulary(
        ("auto",), ("pose", "mass", "inertia"), ("auto_inertia_params",), refused=("fluid_added_mass", "density")
    ),
    "inertia": Vocabulary((), ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "joint": Vocabulary(
        ("name", "type"),
        ("parent", "child", "pose", "axis", "axis2", "screw_thread_pitch"),
        ("sensor", "physics"),
        refused=("thread_pitch", "gearbox_ratio", "gearbox_reference_body"),
    ),
    "axis": Vocabulary(
        (), ("xyz", "limit", "dynamics", "mimic", "use_parent_model_frame"), ("initial_position",)
    ),
    "xyz": Vocabulary(("expressed_in",)),
    "limit": Vocabulary((), ("lower", "upper", "effort", "velocity"), ("stiffness", "dissipation")),
    "dynamics": Vocabulary((), ("damping", "friction", "spring_reference", "spring_stiffness")),
    "mimic": Vocabulary(("joint", "axis"), ("multiplier", "offset", "reference")),
}  # fmt: skip
SDF_VOCABULARY["axis2"] = SDF_VOCABULARY["axis"]
SEVERAL = {("sdf", "model"), ("sdf", "world"), ("world", "model"), ("model", "link"), ("model", "joint")}
SEVERAL |= {("model", "frame")}
WHY_REFUSED = {
    "include": "a model of another file; try a file in which it is included, as `gz sdf -p` writes",
    "model": "a nested model; try one model, with the joints between its links",
    "joint": "a joint of the world; try the joints of one model",
    "fluid_added_mass": "no fluids are modelled",
    "density": "inertia of the shapes is not computed; try <mass> and <inertia>",
    "thread_pitch": "an angle per length of the opposite sign; try <screw_thread_pitch>, the travel of a turn [m]",
}


def sdf_notes(element: Element) -> list[str]:
    """Return notes on what is not read in an element and in those of its children that are read.

    Raises:
        SceneError: a name is misspelt or given twice, or something cannot be read and acts on the motion.
    """
    known = SDF_VOCABULARY.get(element.tag, Vocabulary(()))
    unknown = ", ".join(unknown_attributes(element, known))
    notes = [element.message(f"{shortened(unknown)}: unknown, not read")] if unknown else []
    seen: dict[str, int] = {}
    for child in element.children:
        effect = known.effect(child.tag)
        if effect == "refused":
            why = WHY_REFUSED.get(child.tag, "acts on the motion, and is not read")
            raise child.refuse(f"expected none, since it is {why}" if why.startswith(("a ", "an ")) else why)
        if effect == "read":
            if child.tag in seen and (element.tag, child.tag) not in SEVERAL:
                raise child.refuse(f"expected one <{child.tag}>, got a second (first in line {seen[child.tag]})")
            seen[child.tag] = child.line
            if (element.tag, child.tag) not in SEVERAL:
                notes += sdf_notes(child)
        elif not effect:
            refuse_misspelt(child, known.children + known.skipped)
            notes.append(child.message("unknown element, not read"))
        elif effect == "noted" and not is_off(child):
            notes.append(child.message("acts on the motion, but is not read"))
    return notes
