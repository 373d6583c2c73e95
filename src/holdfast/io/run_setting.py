"""What the run in a result folder is a run of: from the model that it keeps, or from its scene."""

from __future__ import annotations

from pathlib import Path

from holdfast.errors import ResultError, StateError
from holdfast.io.model_data import model_of
from holdfast.io.result_chunk import Damage, read_arrays
from holdfast.io.result_meta import BASES, MODEL, ResultMeta, kept_robots, read_bytes
from holdfast.model.fingerprint import fingerprint
from holdfast.simulation.setting import RecordedBase, Setting


def setting_of(folder: Path, meta: ResultMeta) -> Setting:
    """Return the setting of a run; a scene is read anew, of the robots that the folder keeps.

    Raises:
        ResultError: the model, or how bases moved, cannot be read, or is of other joints.
        SceneError, ClosureError: the scene, or a robot file that it names, cannot be read any more.
    """
    if (folder / MODEL).exists():
        chain, moved = model_of(read_bytes(folder / MODEL), str(folder / MODEL)), _bases(folder)
    else:
        from holdfast.scenario.build import load_scene

        robots = kept_robots(folder, meta.robots)
        scenario = load_scene(folder / "scene.toml", meta.scene_folder or None, robots=robots)
        chain, moved = scenario.chain, scenario.options.get("base_motion", {})
    if (joints := chain.joint_names()) != meta.joints:
        raise ResultError(
            f"{folder}: not the chain of this run: expected the joints {', '.join(meta.joints)}, got"
            f" {', '.join(joints)}"
        )
    if (folder / MODEL).exists() and fingerprint(chain) != meta.model_sha256:
        raise ResultError(f"{folder / MODEL}: expected the model that was simulated, got another one")
    return Setting(chain, moved, meta.scene, meta.duration, meta.step, meta.options)


def _bases(folder: Path) -> dict[str, RecordedBase]:
    """Return how bases moved, by name; nothing where none did."""
    path = folder / BASES
    if not path.exists():
        return {}
    try:
        arrays, names = read_arrays(path, "bases")
        parts = ("t", "R", "p", "twist", "acceleration")
        return {name: RecordedBase(*(arrays[f"{name}.{part}"] for part in parts)) for name in names}
    except (Damage, KeyError, TypeError, StateError) as cause:
        raise ResultError(f"{path}: cannot be read: {cause}") from cause
