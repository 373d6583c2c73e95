"""Sweeps of scenes: the plan of a `[sweep]` table, and a folder that also contains the scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from os import PathLike
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.control.controller import ControlLaw
from holdfast.control.sampled import sampled
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.control.traced_law import law_of
from holdfast.errors import HoldfastError, SceneError
from holdfast.io.files import file_path
from holdfast.io.result_meta import SCENE, RobotRecord, kept_files, kept_robots
from holdfast.io.store import Damage, advising, read_manifest, stored
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.scenario.build import Scenario, parse_scene
from holdfast.scenario.robots import RobotFiles
from holdfast.scenario.scene import NearPoseTable, NormalTable, UniformTable
from holdfast.simulation.run_record import EVERYTHING
from holdfast.sweeps.distributions import NearPose, Normal, Uniform
from holdfast.sweeps.plan import OUTPUTS, Plan, plan_of
from holdfast.sweeps.result import Sweep
from holdfast.sweeps.store import ROBOTS_FILE, SWEEP, SweepMeta, differences
from holdfast.sweeps.sweep import Progress, carry_out

OF_INSTALLATION = {"versions", "processor", "model_sha256", "law_sha256", "state_sha256"}  # may change its last bits
# keys of `[simulation]` that rollouts support, and the names of their arguments
STEADY = {"on_singular": "stop", "record": EVERYTHING, "every": 1}
LEAST_MARGIN = {"stop": 0.0, "record": -float("inf")}
AT_LIMITS = {"stop": True, "record": False}


def sweep_scene(
    scenario: Scenario,
    store: str | PathLike[str],
    *,
    workers: int | Executor = 1,
    cluster: str | None = None,
    ahead: int = 16,
    progress: bool | Callable[[Progress], object] | None = None,
) -> Sweep:
    """Compute the missing runs of the sweep that a scene's `[sweep]` describes; the scene is stored in the folder.

    Args:
        scenario: the result of `load_scene`.
        store: the folder, which is created if it does not exist.
        workers: as for `sweep`.
        cluster: as for `sweep`.
        ahead: as for `sweep`.
        progress: as for `sweep`.

    Returns:
        The sweep, with summaries of its runs.

    Raises:
        SceneError: there is no `[sweep]`, it is invalid, or rollouts do not support the scene.
        StateError, ResultError, MissingExtra: as for `sweep`.
    """
    checks.instance(scenario, Scenario, "sweep_scene: scenario", SceneError)
    plan = scene_plan(scenario)
    how: dict[str, Any] = {"workers": workers, "cluster": cluster, "ahead": ahead, "progress": progress}
    records, files = kept_files(scenario.sources)
    files = {SCENE: scenario.text.encode(), ROBOTS_FILE: msgspec.json.encode(records) + b"\n", **files}
    return carry_out(plan, store, files=files, **how)


def load_sweep(folder: str | PathLike[str]) -> Sweep:
    """Return the sweep of a scene from its folder, as far as it has been computed, without writing anything.

    A sweep by another version of holdfast or its libraries can be read; its runs cannot be repeated.

    Args:
        folder: a folder written by `sweep_scene` or `holdfast sweep`.

    Raises:
        ResultError: there is no sweep, it was made in Python, or its scene has changed.
        SceneError, ClosureError: its scene cannot be read.
    """
    place = file_path(folder, "folder")
    plan, meta = scene_plan(kept_scene(place)), read_manifest(place, SWEEP, SweepMeta)
    differing = differences(place, meta, plan.description(), OF_INSTALLATION)
    return Sweep(plan.settled(meta.generic_rank), place, meta.files, differing)


def kept_scene(folder: Path) -> Scenario:
    """Return the scenario of the scene in a sweep's folder, with the robots stored there.

    Raises:
        ResultError: there is no scene, or a file is damaged.
        SceneError, ClosureError: the scene cannot be read.
    """
    try:
        files = read_manifest(folder, SWEEP, SweepMeta).files
    except Damage:  # chunks tell whether the scene is theirs
        if not SWEEP.strays(folder, 0):
            raise
        files = {ROBOTS_FILE: None, SCENE: None}
    with advising(folder, SWEEP.again):
        try:
            records = msgspec.json.decode(stored(folder, ROBOTS_FILE, files), type=dict[str, RobotRecord])
        except (msgspec.MsgspecError, UnicodeDecodeError) as cause:
            raise Damage(f"{ROBOTS_FILE} is damaged: expected which arm is out of which file: {cause}") from cause
        robots, text = kept_robots(folder, records), stored(folder, SCENE, files)
    return parse_scene(text, str(folder / SCENE), folder.name, RobotFiles(folder, False, robots))


def scene_plan(scenario: Scenario) -> Plan:
    """Return the plan that a scene's `[sweep]` describes.

    Raises:
        SceneError: there is none, it is invalid, or rollouts do not support the scene.
    """
    at, data = Location(scenario.name), scenario.sweep
    if data is None:
        raise (at / "sweep").refuse(
            "expected a table that says how many runs and what differs, got none; try [sweep] with count = 100 and"
            ' parameters.object_mass = { type = "uniform", low = 2.0, high = 4.0 }'
        )
    how = scenario.options
    _require_steady(scenario, at)
    law, torques = _law(scenario, at / "controller")
    parameters = {
        name: _sample(name, one, scenario, at / "sweep" / "parameters") for name, one in data.parameters.items()
    }
    try:
        plan = plan_of(
            scenario.chain,
            law,
            state=scenario.state,
            parameters=torques | parameters,
            count=data.count,
            duration=scenario.duration,
            step=scenario.step,
            outputs=OUTPUTS if data.outputs is None else data.outputs,
            seed=data.seed,
            chunk=data.chunk,
            scheme=how["scheme"],
            least_margin=LEAST_MARGIN[how["on_slip"]],
            stop_at_limits=AT_LIMITS[how["on_limit"]],
            largest_drift=how["largest_drift"],
        )
    except HoldfastError as cause:
        raise (at / "sweep").refuse(str(cause)) from cause
    return plan


def _require_steady(scenario: Scenario, at: Location) -> None:
    """Refuse scenes with events during a run, and everything that rollouts do not support.

    Raises:
        SceneError: there is such an entry; the message gives the location of the first.
    """
    how = scenario.options
    if how["inputs"] is not None:
        raise (at / "wrenches").refuse("expected none in a sweep; try sweep.parameters.object_wrench, for whole runs")
    if how["base_motion"]:
        moving = ", ".join(how["base_motion"])
        raise (at / "base_motion").refuse(f"expected bases that stand still in a sweep, got {moving} moving")
    for name in ("events", "breakpoints"):
        if how[name]:
            raise (at / name).refuse(f"expected none in a sweep, got {len(how[name])}; try `holdfast simulate`")
    known = {"scheme": ("rk4", "midpoint"), "on_slip": LEAST_MARGIN, "on_limit": AT_LIMITS, **STEADY}
    for name, choices in known.items():
        choices = choices if isinstance(choices, Mapping | tuple) else (choices,)
        if how[name] not in choices:
            words = " or ".join(f"'{one}'" for one in choices if one is not None) or "none"
            raise (at / "simulation" / name).refuse(f"expected {words} in a sweep, got {how[name]!r}")


def _law(scenario: Scenario, at: Location) -> tuple[ControlLaw | None, dict[str, Any]]:
    """Return the law of a scene's controller and its parameters; None and the torques if these are constant.

    Raises:
        SceneError: the controller cannot be compiled.
    """
    drive = scenario.controller
    if isinstance(drive, TorqueSchedule):
        (first, *more), table = drive.knots, drive.coefficients[0]
        if drive.beside is None and not more and first <= 0.0 and not table[:, 1:].any():
            return None, {"tau": table[:, 0]}
        raise at.refuse(
            "expected gravity_compensation, object_tracking, or torques that are the same all the time, got a"
            " torque_schedule that changes"
        )
    try:
        law = law_of(drive, scenario.chain)
    except HoldfastError as cause:
        raise at.refuse(str(cause)) from cause
    if law is None:
        raise at.refuse("expected a controller that becomes machine code, got one that cannot be traced")
    how = scenario.options
    if how["sample_time"] is not None:
        law = sampled(law, scenario.chain, sample_time=how["sample_time"], delay=how["delay"])
    return law, {}


def _sample(name: str, data: Any, scenario: Scenario, at: Location) -> Any:
    """Return the distribution of a parameter, or its value for all runs."""
    if isinstance(data, UniformTable):
        return Uniform(data.low, data.high)
    if isinstance(data, NormalTable):
        return Normal(data.mean, data.deviation)
    if not isinstance(data, NearPoseTable):
        return data
    chain, state = scenario.chain, scenario.state
    poses = {
        "grasp_pose": lambda: np.array([grasp.frame.wxyz_xyz for grasp in chain.grasps.values()]),
        "base_pose": lambda: np.array([arm.base.wxyz_xyz for arm in chain.arms.values()]),
        "object_pose": lambda: state.object_pose,
        "floating_pose": lambda: state.base_pose,
    }
    if name not in poses or (pose := poses[name]()) is None or not pose.size:
        there = ", ".join(poses)
        raise (at / name).refuse(f"near_pose: expected one of the scene's poses ({there}), got a parameter without")
    return NearPose(pose, data.turn, data.shift)
