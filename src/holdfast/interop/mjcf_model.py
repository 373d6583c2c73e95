"""Compiling MJCF files with MuJoCo, after checking the sizes in them, for which MuJoCo allocates memory unchecked.

A table says what every element does to the motion of an arm; elements without a row are noted by name. MuJoCo's
compiler resolves files, defaults and geoms, so most of what is read is read from the compiled model.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from holdfast.errors import MissingExtra, SceneError
from holdfast.io.files import read_bounded, reason_of
from holdfast.robots.urdf.document import LARGEST_URDF, Element, parse_document

READ_ELEMENTS = (
    "mujoco", "mujocoinclude", "include", "compiler", "default", "worldbody", "body", "frame", "replicate", "attach",
    "model", "asset", "mesh", "inertial", "joint", "freejoint", "geom", "site", "contact", "equality", "tendon",
    "actuator", "extension",
)  # fmt: skip
# forces and settings that are not read; noted where they act on the arm
NOTED_ELEMENTS = (
    "option", "flag", "deformable", "flex", "flexcomp", "composite", "elasticity", "edge", "plugin", "general",
    "position", "velocity", "intvelocity", "orientation", "pid", "damper", "cylinder", "muscle", "dcmotor", "adhesion",
)  # fmt: skip
# couplings; refused where they act on the arm
REFUSED_ELEMENTS = ("connect", "weld", "distance", "flexstrain", "flexvert", "fixed", "spatial", "pulley")
# inputs, sensors, contacts, pictures and sizes
NONE_ELEMENTS = (
    "motor", "exclude", "pair", "size", "statistic", "custom", "numeric", "text", "tuple", "element", "key",
    "keyframe", "visual", "global", "quality", "headlight", "map", "scale", "rgba", "texture", "material", "layer",
    "hfield", "skin", "bone", "camera", "light", "config", "instance", "lengthrange", "pin", "sensor",
    "accelerometer", "actuatorfrc", "actuatorpos", "actuatorvel", "ballangvel", "ballquat", "camprojection", "clock",
    "e_kinetic", "e_potential", "force", "frameangacc", "frameangvel", "framelinacc", "framelinvel", "framepos",
    "framequat", "framexaxis", "frameyaxis", "framezaxis", "fromto", "gyro", "insidesite", "jointactuatorfrc",
    "jointlimitfrc", "jointlimitpos", "jointlimitvel", "jointpos", "jointvel", "magnetometer", "normal",
    "rangefinder", "subtreeangmom", "subtreecom", "subtreelinvel", "tactile", "tendonactuatorfrc", "tendonlimitfrc",
    "tendonlimitpos", "tendonlimitvel", "tendonpos", "tendonvel", "torque", "touch", "user", "velocimeter",
)  # fmt: skip
EFFECTS = {
    **dict.fromkeys(READ_ELEMENTS, "read"),
    **dict.fromkeys(NOTED_ELEMENTS, "noted"),
    **dict.fromkeys(REFUSED_ELEMENTS, "refused"),
    **dict.fromkeys(NONE_ELEMENTS, "none"),
}
MOST_COUNTED = 2**24  # largest count in an element: pixels, heights, copies, keys
MOST_COPIES = 10_000
MOST_INCLUDED = 1000
# the count of an element is the largest of these products of its attributes
COUNTS = {
    "texture": [("width", "height")],
    "hfield": [("nrow", "ncol")],
    "composite": [("count",)],
    "flexcomp": [("count",)],
    "size": [(name,) for name in ("njmax", "nconmax", "nstack", "nuserdata", "nkey")]
    + [(f"nuser_{name}",) for name in ("body", "jnt", "geom", "site")],
}


def mujoco_module() -> Any:
    """Return MuJoCo's Python package, which has no types.

    Raises:
        MissingExtra: MuJoCo is not installed.
    """
    try:
        import mujoco
    except ImportError as cause:
        raise MissingExtra("MJCF files need MuJoCo's compiler; try pip install 'holdfast[mjcf]'") from cause
    return mujoco


def is_disabled(model: Any, flag: str) -> bool:
    """Return whether a flag of the model, such as "SPRING", is disabled."""
    return bool(model.opt.disableflags & int(getattr(mujoco_module().mjtDisableBit, f"mjDSBL_{flag}")))


def compiled_mjcf(path_or_text: str | PathLike[str]) -> tuple[str, Any, tuple[str, ...]]:
    """Return a name for messages, MuJoCo's compiled model of an MJCF file or text (which begins with `<`), and notes.

    The notes are on elements that MuJoCo knows and this library does not.

    Static bodies keep their names. Geoms whose files cannot be found are left out if the body's inertia does not depend
    on them.

    Raises:
        SceneError: MuJoCo cannot compile the file, or it is not MJCF.
        MissingExtra: MuJoCo is not installed.
    """
    mujoco = mujoco_module()
    if not isinstance(path_or_text, str | PathLike):
        raise SceneError(f"MJCF: expected a path or the text of an MJCF file, got {type(path_or_text).__name__}")
    given = fspath(path_or_text)
    is_text = isinstance(given, str) and given.lstrip("\ufeff \t\r\n").startswith("<")
    source = "MJCF text" if is_text else str(given)
    unknown = _require_mjcf(given, is_text, source)

    def spec() -> Any:
        read = mujoco.MjSpec.from_string if is_text else mujoco.MjSpec.from_file
        found = read(str(given).lstrip("\ufeff") if is_text else str(given))
        found.compiler.fusestatic = False
        return found

    with warnings.catch_warnings(action="ignore"), _warned(mujoco) as said:  # deprecated attributes that still work
        try:
            compiled = spec().compile()
        except (ValueError, TypeError) as cause:
            reason = " ".join(str(cause).split())
            try:
                compiled = _without_meshes(mujoco, spec()).compile()
            except (ValueError, TypeError):
                raise SceneError(f"{source}: MuJoCo cannot compile it: {reason}") from cause
    if any("NaN" in one for one in said):
        raise SceneError(f"{source}: expected numbers, got NaN in an attribute")
    return source, compiled, (*unknown, *(f"{source}: MuJoCo: {' '.join(one.split())}" for one in said))


@contextmanager
def _warned(mujoco: Any) -> Iterator[list[str]]:
    """Yield MuJoCo's warnings, which it would print and append to MUJOCO_LOG.TXT in the working directory."""
    said, before = list[str](), mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        yield said
    finally:
        mujoco.set_mju_user_warning(before)


def _require_mjcf(given: Any, is_text: bool, source: str) -> tuple[str, ...]:
    """Return notes on unknown elements; refuse files that cannot be read, and formats that MuJoCo would accept."""
    try:
        text = given.strip("\ufeff \t\r\n") if is_text else read_bounded(Path(given), LARGEST_URDF)
    except OSError as cause:
        name = source if source.isprintable() else repr(source)
        raise SceneError(f"{name}: cannot be read: {reason_of(cause)}") from cause
    try:
        root, *included = _bounded_mjcf(text, source, Path() if is_text else Path(given).parent)
    except RecursionError as cause:
        raise SceneError(f"{source}: expected an MJCF file, got elements nested too deeply") from cause
    if root.tag != "mujoco":
        hint = "; try load_urdf" if root.tag == "robot" else ""
        raise SceneError(f"{source}: expected <mujoco> as the outermost element, got <{root.tag}>{hint}")
    elements = [element for document in (root, *included) for element, _ in _with_copies(document)]
    return tuple(one.message("unknown element, not read") for one in elements if one.tag not in EFFECTS)


def _without_meshes(mujoco: Any, spec: Any) -> Any:
    """Return the specification without the meshes of bodies whose inertia is given."""
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        return spec
    kept = set()
    for geom in list(spec.geoms):
        if not geom.meshname:
            continue
        if geom.parent.explicitinertial or geom.parent.name == "world":
            spec.delete(geom)
        else:
            kept.add(geom.meshname)
    for mesh in list(spec.meshes):
        if mesh.name not in kept:
            spec.delete(mesh)
    return spec


def _bounded_mjcf(text: bytes | str, source: str, folder: Path) -> list[Element]:
    """Return the root elements of an MJCF file and of all files that it includes, after checking them.

    Raises:
        SceneError: the XML is not well-formed, has a DOCTYPE or is too large, or a count exceeds its bound.
    """
    documents = [parse_document(text, source)]
    for document in documents:  # the loop appends to this list
        for element, copies in _with_copies(document):
            if copies > MOST_COPIES:
                raise element.refuse(f"expected at most {MOST_COPIES:,} copies of it (replicate), got {copies:g}")
            count = max((_product(element, names) for names in COUNTS.get(element.tag, ())), default=0.0)
            if count > MOST_COUNTED:
                raise element.refuse(f"expected counts up to {MOST_COUNTED:,}, got {count:g}")
            path = folder / element.attributes.get("file", "")
            if element.tag != "include" or not os.path.isfile(path):  # MuJoCo reports missing files
                continue
            if len(documents) == MOST_INCLUDED:
                raise element.refuse(f"expected at most {MOST_INCLUDED} included files, got more")
            documents.append(parse_document(read_bounded(path, LARGEST_URDF), str(path)))
    return documents


def _with_copies(root: Element) -> list[tuple[Element, float]]:
    """Return every element and the number of copies of it that replicate elements make."""
    found = [(root, _replicas(root))]
    for element, copies in found:  # the loop appends to this list
        found += [(child, copies * _replicas(child)) for child in element.children]
    return found


def _replicas(element: Element) -> float:
    return max(_product(element, ("count",)), 1.0) if element.tag == "replicate" else 1.0


def _product(element: Element, names: tuple[str, ...]) -> float:
    """Return the product of all numbers in some attributes, or 0 if one is not a number, which MuJoCo reports."""
    words = [word for name in names for word in element.attributes.get(name, "").split()[:10]]
    try:
        product = math.prod(abs(float(word)) for word in words) if words else 0.0
    except ValueError:
        return 0.0
    return 0.0 if math.isnan(product) else product
