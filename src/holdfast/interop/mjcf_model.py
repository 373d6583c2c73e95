"""MJCF files as MuJoCo compiles them."""

from __future__ import annotations

import warnings
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from holdfast.errors import MissingExtra, SceneError
from holdfast.interop.mjcf_bounds import bounded_mjcf, read_mjcf


def mujoco_module() -> Any:
    """Return MuJoCo's Python package, which has no types.

    Raises:
        MissingExtra: it is not installed.
    """
    try:
        import mujoco
    except ImportError as cause:
        raise MissingExtra("MJCF files need MuJoCo's compiler; try pip install 'holdfast[mjcf]'") from cause
    return mujoco


def compiled_mjcf(path_or_text: str | PathLike[str]) -> tuple[str, Any]:
    """Return a name for messages and MuJoCo's compiled model of an MJCF file or text (it begins with `<`).

    Bodies that stand still keep their names. Geoms whose files cannot be found are left out
    where the body's inertia does not depend on them.

    Raises:
        SceneError: what MuJoCo has to say, or a file that is no MJCF.
        MissingExtra: MuJoCo is not installed.
    """
    mujoco = mujoco_module()
    if not isinstance(path_or_text, str | PathLike):
        raise SceneError(f"MJCF: expected a path or the text of an MJCF file, got {type(path_or_text).__name__}")
    given = fspath(path_or_text)
    is_text = isinstance(given, str) and given.lstrip("\ufeff \t\r\n").startswith("<")
    source = "MJCF text" if is_text else str(given)
    _require_mjcf(given, is_text, source)

    def spec() -> Any:
        read = mujoco.MjSpec.from_string if is_text else mujoco.MjSpec.from_file
        found = read(str(given).lstrip("\ufeff") if is_text else str(given))
        found.compiler.fusestatic = False
        return found

    with warnings.catch_warnings(action="ignore"):  # of attributes that MuJoCo will drop one day: it still obeys them
        try:
            return source, spec().compile()
        except (ValueError, TypeError) as cause:
            reason = " ".join(str(cause).split())
        try:
            return source, _without_meshes(mujoco, spec()).compile()
        except (ValueError, TypeError) as cause:
            raise SceneError(f"{source}: MuJoCo cannot compile it: {reason}") from cause


def _require_mjcf(given: Any, is_text: bool, source: str) -> None:
    """Refuse what cannot be read, and other formats that MuJoCo would take for its own."""
    text = given.strip("\ufeff \t\r\n") if is_text else read_mjcf(given)
    try:
        root = bounded_mjcf(text, source, Path() if is_text else Path(given).parent)
    except RecursionError as cause:
        raise SceneError(f"{source}: expected an MJCF file: nested too deeply") from cause
    if root.tag != "mujoco":
        hint = "; try load_urdf" if root.tag == "robot" else ""
        raise SceneError(f"{source}: expected <mujoco> as the outermost element, got <{root.tag}>{hint}")


def _without_meshes(mujoco: Any, spec: Any) -> Any:
    """Return the specification without meshes, on bodies whose inertia is given."""
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
