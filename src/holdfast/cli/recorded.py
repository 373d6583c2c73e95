"""A result folder's run together with the scenario that it is of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from holdfast.cli import complain
from holdfast.errors import ResultError, SceneError
from holdfast.io.result_meta import ResultMeta, kept_robots
from holdfast.io.result_reader import Result, load_result
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import fingerprint
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.scenario.build import Scenario, load_scene
from holdfast.spatial.pose import Pose


def recorded(folder: Path, trust_xacro: bool = False) -> tuple[Scenario, Result]:
    """Return scenario and result of a folder; say on stderr what is missing of an incomplete run.

    Raises:
        ResultError: no result, or its scene.toml is of another chain.
        SceneError, ClosureError: as for `scenario_of`.
    """
    result = load_result(folder)
    scenario = scenario_of(result, trust_xacro)
    if result.note:
        complain(f"{folder}: {result.note}")
    return scenario, result


def scenario_of(result: Result, trust_xacro: bool = False) -> Scenario:
    """Return a result's scenario, of the robots that it keeps; say on stderr if it has another model now.

    Robots of a folder that holdfast 0.1 wrote are read where they were then.

    Args:
        result: the run.
        trust_xacro: expand xacro files of a folder that keeps no robots.

    Raises:
        ResultError: scene.toml is of another chain, or a robot is not the one that was simulated.
        SceneError, ClosureError: it, or a robot file that it names, cannot be read any more.
    """
    scene, meta = result.folder / "scene.toml", result.meta
    robots = kept_robots(result.folder, meta)
    scenario = load_scene(scene, meta.scene_folder or None, trust_xacro=trust_xacro, robots=robots)
    joints = scenario.chain.joint_names()
    if joints != meta.joints:
        raise ResultError(
            f"{scene}: not the scene of this run: expected the joints {', '.join(meta.joints)}, got {', '.join(joints)}"
        )
    if fingerprint(scenario.chain) != meta.model_sha256:
        complain(f"{scene}: describes another model now than was simulated; is a robot file another one?")
    return scenario


def chain_for_figures(folder: Path, trust_xacro: bool = False) -> tuple[ClosedChain, Result]:
    """Return the chain of a run and the run; where no robot is to be had, a chain of its names alone.

    Raises:
        ResultError: no result, or its scene.toml is of another chain.
    """
    result = load_result(folder)
    try:
        chain = scenario_of(result, trust_xacro).chain
    except SceneError as cause:
        if result.meta.robots or not result.meta.scene_folder:
            raise
        complain(f"{cause}; drawn without the robots' limits")
        chain = _named(result.meta)
    if result.note:
        complain(f"{folder}: {result.note}")
    return chain, result


def _named(meta: ResultMeta) -> ClosedChain:
    """Return a chain with the arms, joints and grasps of a run by name and kind: all that figures need of it.

    Raises:
        ResultError: meta.json contradicts itself.
    """
    arms = {}
    for name in meta.arms:
        kinds: list[tuple[str, Any]] = [  # a kind that is none is refused by Joint
            (joint.removeprefix(f"{name}/"), kind)
            for joint, kind in zip(meta.joints, meta.joint_kinds, strict=False)
            if joint.startswith(f"{name}/")
        ]
        joints = [Joint(kind, np.array([0.0, 0.0, 1.0]), Pose.identity(), name=joint) for joint, kind in kinds]
        arms[name] = Arm(joints, [Link(1.0, np.zeros(3), np.eye(3))] * len(joints), Pose.identity(), Pose.identity())
    grasp_kinds: dict[str, Any] = dict(meta.grasps)
    grasps = {name: Grasp(kind, Pose.identity()) for name, kind in grasp_kinds.items()}
    return ClosedChain(arms, HeldObject(1.0, np.eye(3)), grasps)
