"""A result folder's run together with the scenario that it is of."""

from __future__ import annotations

from pathlib import Path

from holdfast.cli import complain
from holdfast.errors import ResultError
from holdfast.io.result_reader import Result, load_result
from holdfast.scenario.build import Scenario, load_scene


def recorded(folder: Path) -> tuple[Scenario, Result]:
    """Return scenario and result of a folder; say on stderr what is missing of an incomplete run.

    Raises:
        ResultError: no result, or its scene.toml is of another chain.
        SceneError, ClosureError: its scene.toml cannot be read any more.
    """
    result = load_result(folder)
    scenario = load_scene(folder / "scene.toml")
    joints = scenario.chain.joint_names()
    if joints != result.meta.joints:
        raise ResultError(
            f"{folder / 'scene.toml'}: not the scene of this run: expected the joints {', '.join(result.meta.joints)},"
            f" got {', '.join(joints)}"
        )
    if result.note:
        complain(f"{folder}: {result.note}")
    return scenario, result
