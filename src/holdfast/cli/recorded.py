"""A result folder's run together with the scenario that it is of."""

from __future__ import annotations

from pathlib import Path

from holdfast.cli import complain
from holdfast.errors import ResultError
from holdfast.io.fingerprint import fingerprint
from holdfast.io.result_reader import Result, load_result
from holdfast.scenario.build import Scenario, load_scene


def recorded(folder: Path) -> tuple[Scenario, Result]:
    """Return scenario and result of a folder; say on stderr what is missing of an incomplete run.

    Raises:
        ResultError: no result, or its scene.toml is of another chain.
        SceneError, ClosureError: as for `scenario_of`.
    """
    result = load_result(folder)
    scenario = scenario_of(result)
    if result.note:
        complain(f"{folder}: {result.note}")
    return scenario, result


def scenario_of(result: Result) -> Scenario:
    """Return a result's scenario; say on stderr if it has another model now, since a robot file was changed.

    Raises:
        ResultError: scene.toml is of another chain.
        SceneError, ClosureError: it, or a robot file that it names, cannot be read any more.
    """
    scene, meta = result.folder / "scene.toml", result.meta
    scenario = load_scene(scene, meta.scene_folder or None)
    joints = scenario.chain.joint_names()
    if joints != meta.joints:
        raise ResultError(
            f"{scene}: not the scene of this run: expected the joints {', '.join(meta.joints)}, got {', '.join(joints)}"
        )
    if fingerprint(scenario.chain) != meta.model_sha256:
        complain(f"{scene}: describes another model now than was simulated; is a robot file another one?")
    return scenario
