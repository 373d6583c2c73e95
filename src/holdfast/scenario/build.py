"""From a scene's data to a chain, its closed initial state, and a controller."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np

from holdfast.assembly.assemble import assemble
from holdfast.control.controller import Controller
from holdfast.dynamics.closing import close
from holdfast.errors import ClosureError, SceneError
from holdfast.io import typed
from holdfast.io.files import LONGEST_NAME, file_path, one_line
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.robots.urdf.source import Source
from holdfast.scenario import parts
from holdfast.scenario.parts import Robot, RobotFiles
from holdfast.scenario.scene import ReleaseData, SceneData
from holdfast.scenario.surroundings import pushes, swaying_base
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.events import Attach, Event, Release, holding_after
from holdfast.simulation.stops import step_times
from holdfast.state import State

LARGEST = 1e9
LARGEST_FILE = 2 * 2**20  # [bytes]; seconds of reading
DEEPEST = 20  # levels; a scene needs seven
MOST_ARMS, MOST_JOINTS = 64, 1000
OPTIONS = ("on_slip", "on_limit", "on_singular", "scheme", "rtol", "atol", "largest_drift")  # passed on to `simulate`
ARM_NAME = re.compile(r"\w[\w.-]{0,63}")


@dataclass(frozen=True, eq=False)
class Scenario:
    """A scene ready to simulate.

    Attributes:
        name: of the scene.
        text: the scene file's own text.
        chain: arms, object and grasps.
        state: initial state at rest, every grasp closed.
        controller: torques.
        duration, step: [s].
        robots: what the arms are made from, by name.
        options: the other arguments of `simulate`, by keyword.
    """

    name: str
    text: str
    chain: ClosedChain
    state: State
    controller: Controller
    duration: float
    step: float
    robots: dict[str, Robot]
    options: dict[str, Any] = field(default_factory=dict)


def load_scene(
    path: str | PathLike[str],
    folder: str | PathLike[str] | None = None,
    *,
    trust_xacro: bool = False,
    robots: Mapping[str, Source] | None = None,
) -> Scenario:
    """Return the scenario of a TOML file.

    Args:
        path: the file.
        folder: that relative names of robot files in it start from; None: the one that it is in.
        trust_xacro: whether to expand xacro files that it names, which runs the Python in them.
        robots: URDFs to take instead of the files that it names, by the arm's name.

    Raises:
        SceneError: unreadable or invalid, with the path of the first fault; a xacro file without `trust_xacro`.
        ClosureError: an arm cannot reach its grasp.
        MissingExtra: it names a xacro file, and xacrodoc is not installed.
    """
    file = file_path(path, "path", SceneError)
    source = str(file)
    text = typed.read_bytes(file, LARGEST_FILE)
    raw = typed.parse_toml(text, source)
    require_sensible(raw, Location(source))
    data = typed.convert(raw, SceneData, source)
    home = file.parent if folder is None else file_path(folder, "folder", SceneError)
    name = data.name or one_line(file.stem, LONGEST_NAME)
    return build_scene(data, source, text.decode("utf-8"), name, RobotFiles(home, trust_xacro, robots or {}))


@np.errstate(all="ignore")  # what overflows is refused where it is found
def build_scene(
    data: SceneData, source: str = "scene", text: str = "", name: str = "scene", files: RobotFiles | None = None
) -> Scenario:
    """Return the scenario of a scene's data.

    Raises:
        SceneError: with the path of the first fault.
        ClosureError: an arm cannot reach its grasp.
    """
    at = Location(source)
    if one_line(data.name, LONGEST_NAME) != data.name:
        raise (at / "name").refuse(
            f"expected up to {LONGEST_NAME} printable characters on one line, got '{one_line(data.name, 60)}'"
        )
    with (at / "simulation").refusals():
        step_times(data.simulation.duration, data.simulation.step)
    robots = build_robots(data, files or RobotFiles(), at)
    chain, guess = build_chain(data, robots, at)
    search = any(arm.q is None and arm.name in chain.grasps for arm in data.arms)
    try:
        state = closed(chain, guess, search)
    except ClosureError as cause:
        raise ClosureError((at / "object" / "pose").message(str(cause))) from cause
    controller = parts.controller(data.controller, chain, state, at / "controller")
    options = build_options(data, chain, at)
    how = data.simulation
    return Scenario(name, text, chain, state, controller, how.duration, how.step, robots, options)


def build_robots(data: SceneData, files: RobotFiles, at: Location) -> dict[str, Robot]:
    """Return what the arms are made from, by name.

    Raises:
        SceneError: with the path of the first fault.
    """
    if not data.arms:
        raise (at / "arms").refuse("expected at least one arm, got none")
    if len(data.arms) > MOST_ARMS:
        raise (at / "arms").refuse(f"expected at most {MOST_ARMS} arms, got {len(data.arms)}")
    _require_names((arm.name for arm in data.arms), at / "arms", "name")
    robots, joints = {}, 0
    for i, arm in enumerate(data.arms):
        robots[arm.name] = parts.robot(arm, files, at / "arms" / i)
        joints += robots[arm.name].arm.joint_count
        if joints > MOST_JOINTS:
            raise (at / "arms" / i).refuse(f"expected at most {MOST_JOINTS} joints in all, got {joints} up to here")
    return robots


def closed(chain: ClosedChain, guess: State, search: bool) -> State:
    """Return the state with every grasp closed around the object where it is; `search` tries other postures too.

    Raises:
        ClosureError: an arm cannot reach its grasp.
    """
    try:
        return close(chain, guess, hold_object=True)
    except ClosureError:
        if not search:
            raise
    q = {name: guess.q[chain.joints[name]] for name in chain.names}
    return assemble(
        chain.arms, chain.held_object, chain.grasps, object_pose=guess.object_pose, q=q, gravity=chain.gravity
    ).state


def build_chain(data: SceneData, robots: Mapping[str, Robot], at: Location) -> tuple[ClosedChain, State]:
    """Return the chain and the state that it is to be closed from, at rest.

    Raises:
        SceneError: with the path of the first fault.
    """
    _require_names((grasp.arm for grasp in data.grasps), at / "grasps", "arm")
    arms = {name: robot.arm for name, robot in robots.items()}
    grasps = {}
    for i, grasp in enumerate(data.grasps):
        if grasp.arm not in arms:
            raise (at / "grasps" / i / "arm").refuse(f"no arm '{grasp.arm}'.{checks.did_you_mean(grasp.arm, arms)}")
        grasps[grasp.arm] = parts.grasp(grasp, at / "grasps" / i)
    held = parts.held_object(data.object, at / "object")
    pose = parts.pose(data.object.pose, at / "object" / "pose")
    springs = [parts.spring(spring, arms, at / "springs" / i) for i, spring in enumerate(data.springs)]
    with at.refusals():
        chain = ClosedChain(arms, held, grasps, np.array(data.gravity), springs=springs)
    q = np.concatenate([robot.q for robot in robots.values()])
    return chain, State(q, 0 * q, pose.wxyz_xyz)


def build_options(data: SceneData, chain: ClosedChain, at: Location) -> dict[str, Any]:
    """Return the keyword arguments of `simulate`: events, surroundings, scheme, policies.

    Raises:
        SceneError: with the path of the first fault.
    """
    how = data.simulation
    pushed = pushes(data.wrenches, at / "wrenches")
    swaying = {
        arm.name: swaying_base(arm.base_motion, chain.arms[arm.name].base, at / "arms" / i / "base_motion")
        for i, arm in enumerate(data.arms)
        if arm.base_motion is not None
    }
    with (at / "simulation").refusals():
        Tolerance(how.rtol, how.atol)
        if how.largest_drift is not None:
            checks.number(how.largest_drift, "simulation: largest_drift", above=0.0)
    return {
        "events": build_events(data, chain, at / "events"),
        "base_motion": swaying,
        "inputs": pushed if data.wrenches else None,
        # a base that has set out moves on with another jerk
        "breakpoints": [*how.breakpoints, *pushed.breakpoints, *(base.smooth_start for base in swaying.values())],
        **{name: getattr(how, name) for name in OPTIONS},
    }


def build_events(data: SceneData, chain: ClosedChain, at: Location) -> list[Event]:
    """Return the events, each checked against those before it.

    Raises:
        SceneError: with the path of the event at fault.
    """
    made: list[tuple[int, Event]] = []
    for i, one in enumerate(data.events):
        if isinstance(one, ReleaseData):
            made.append((i, Release(one.t, one.arm)))
        else:
            made.append((i, Attach(one.t, one.arm, parts.grasp(one, at / i), one.here)))
    made.sort(key=lambda placed: placed[1].t)
    holding = frozenset(chain.grasps)
    for i, event in made:
        with (at / i).refusals():
            holding = holding_after(event, holding, chain, data.simulation.duration)
    return [event for _, event in made]


def require_sensible(raw: Any, at: Location, levels: int = DEEPEST) -> None:
    """Refuse NaN, infinity, astronomical numbers and depths: TOML can express them, but no scene has them.

    Args:
        raw: what the file contains.
        at: its place.
        levels: how deep it may go.

    Raises:
        SceneError: with the path of the first one.
    """
    if not levels:
        raise at.refuse(f"expected at most {DEEPEST} levels of tables and arrays")
    if isinstance(raw, float) and not math.isfinite(raw):
        raise at.refuse(f"expected a finite number, got {raw}")
    if isinstance(raw, int | float) and abs(raw) > LARGEST:
        raise at.refuse(f"expected a number up to {LARGEST:g} in SI units, got a larger one")
    if isinstance(raw, dict):
        for key, value in raw.items():
            require_sensible(value, at / str(key), levels - 1)
    if isinstance(raw, list):
        for i, value in enumerate(raw):
            require_sensible(value, at / i, levels - 1)


def _require_names(names: Iterable[str], at: Location, key: str) -> None:
    """Refuse names that repeat, or that would not fit on a line or in a path 'arm/joint'."""
    first: dict[str, int] = {}
    for i, name in enumerate(names):
        if not ARM_NAME.fullmatch(name):
            raise (at / i / key).refuse(
                f"expected letters, digits, '_', '-' and '.', at most 64, got '{one_line(name, 60)}'"
            )
        if name in first:
            raise (at / i / key).refuse(f"'{name}' stands already at {(at / first[name] / key).path}")
        first[name] = i
