"""Building a chain, its closed initial state and a controller from a scene's data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from holdfast.assembly.assemble import assemble, with_slack_bushings
from holdfast.assembly.plausibility import plausibility_notes
from holdfast.control.controller import Controller
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closing import close
from holdfast.dynamics.consistency import require_closed
from holdfast.dynamics.tree.forest_gaps import require_closed as require_closed_forest
from holdfast.dynamics.tree.mechanism_terms import mechanism_arguments
from holdfast.dynamics.trunk.trunk_motion import base_kinematics
from holdfast.errors import ClosureError, SceneError, StateError
from holdfast.io import typed
from holdfast.io.files import LONGEST_NAME, file_path, one_line
from holdfast.io.recording_table import RecordingTable
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.force_element import HELD_OBJECT
from holdfast.model.held_object import HeldObject
from holdfast.model.trunk import TRUNK, Trunk
from holdfast.robots.packages import given_packages
from holdfast.robots.urdf.source import UrdfSource
from holdfast.scenario import controllers, parts
from holdfast.scenario.controllers import Controlled
from holdfast.scenario.joints import pose, require_names
from holdfast.scenario.overrides import overridden, toml_text
from holdfast.scenario.robots import Robot, RobotFiles, SceneTrunk, robot, scene_trunk
from holdfast.scenario.run_options import simulation_options
from holdfast.scenario.scene import ArmTable, SceneTable, SweepTable
from holdfast.scenario.table import Twist
from holdfast.simulation.stops import step_times
from holdfast.spatial.pose import Pose
from holdfast.state import Inputs, State

LARGEST_NUMBER = 1e9
LARGEST_SCENE = 2 * 2**20  # [bytes]; takes seconds to read
MOST_LEVELS = 20  # levels of nesting; a scene needs seven
MOST_ARMS, MOST_JOINTS = 64, 1000


@dataclass(frozen=True, eq=False)
class Scenario:
    """A scene ready to simulate.

    Attributes:
        name: name of the scene.
        text: text of the scene file.
        chain: arms, object and grasps.
        state: initial state with every grasp closed. The chain is at rest, unless the scene gives the object or a
            floating base an initial twist.
        controller: controller of the joint torques.
        duration: duration of the simulation [s].
        step: its step [s].
        robots: the arms as built, with the files they come from, by arm name.
        options: the other arguments of `simulate`, by keyword.
        trunk: the trunk as built, with the file it comes from; None without a trunk.
        sweep: the scene's sweep table, which lists what varies between runs; None without one.
        recording: the scene's table of a recording's columns, for `load_recording`; None without one.
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
    trunk: SceneTrunk | None = None
    sweep: SweepTable | None = None
    recording: RecordingTable | None = None

    def __repr__(self) -> str:
        """Return the name, the chain, and how long and in which steps it is simulated."""
        return f"<Scenario '{self.name}': {self.duration:g} s in steps of {self.step:g} s\n{self.chain!r}>"

    @property
    def made(self) -> dict[str, Robot | SceneTrunk]:
        """The robots of the scene by name: the arms and, under "trunk", the trunk if there is one."""
        return {**({} if self.trunk is None else {TRUNK: self.trunk}), **self.robots}

    @property
    def sources(self) -> dict[str, UrdfSource]:
        """The URDFs from which arms and trunk are loaded, by name."""
        return {name: one.source for name, one in self.made.items() if one.source is not None}

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on what in these files was changed or ignored, and on numbers of the scene that are unlikely."""
        of_files = (note for one in self.made.values() for note in one.notes)
        return tuple(dict.fromkeys([*of_files, *plausibility_notes(self.chain, self.state.object_frames)]))


def load_scene(
    path: str | PathLike[str],
    folder: str | PathLike[str] | None = None,
    *,
    trust_xacro: bool = False,
    robots: Mapping[str, UrdfSource] | None = None,
    packages: Mapping[str, str | PathLike[str]] | None = None,
) -> Scenario:
    """Return the scenario of a TOML file.

    Args:
        path: the scene file.
        folder: folder to which the file names of robots in the scene are relative; None for the scene's own folder.
        trust_xacro: whether to expand the xacro files that the scene names, which runs the Python code in them.
        robots: URDFs to use instead of the files that the scene names, by arm name; "trunk" for the trunk.
        packages: folders of packages by name, in addition to those of the scene, for `$(find name)` and
            `package://name` in the robots' files.

    Raises:
        SceneError: the file is unreadable or invalid, with the path of the first fault, or it names a xacro file
            without `trust_xacro`.
        ClosureError: an arm cannot reach its grasp.
        MissingExtra: the scene names a xacro file, and xacrodoc is not installed.
    """
    file = file_path(path, "path", SceneError)
    home = file.parent if folder is None else file_path(folder, "folder", SceneError)
    text = typed.read_bytes(file, LARGEST_SCENE)
    return parse_scene(
        text, str(file), file.stem, RobotFiles(home, trust_xacro, robots or {}, given_packages(packages))
    )


def parse_scene(text: bytes, source: str, name: str, files: RobotFiles, changes: Sequence[str] = ()) -> Scenario:
    """Return the scenario of a scene's text.

    Args:
        text: the scene in TOML.
        source: where the text comes from, for messages.
        name: name of the scene, unless the text has one.
        files: where robot files are looked for.
        changes: changes `key=value`, see `overridden`; the text of the returned scenario includes them.

    Raises:
        SceneError: the scene is invalid, with the path of the first fault.
        ClosureError: an arm cannot reach its grasp.
        MissingExtra: the scene names a xacro file, and xacrodoc is not installed.
    """
    raw = typed.parse_toml(text, source)
    require_sensible(raw, Location(source))
    if changes:
        raw = overridden(raw, changes)
        require_sensible(raw, Location(source))
    data = typed.convert(raw, SceneTable, source)
    kept = toml_text(raw) if changes else text.decode("utf-8")
    return build_scene(data, source, kept, data.name or one_line(name, LONGEST_NAME), files)


@np.errstate(all="ignore")  # overflows are reported by the checks that find them
def build_scene(
    data: SceneTable, source: str = "scene", text: str = "", name: str = "scene", files: RobotFiles | None = None
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
    trunk, robots = build_robots(data, files or RobotFiles(), at)
    chain, guess = build_chain(data, trunk, robots, at)
    search = any(arm.q is None and arm.name in chain.grasps for arm in data.arms) and not chain.beyond_serial
    moved = [arm.name for arm in data.arms if not arm.anchor]  # to where their bushings are unloaded; anchors stay
    try:
        state = closed(with_slack_bushings(chain, moved), guess, search)
    except ClosureError as cause:
        raise ClosureError((at / "object" / "pose").message(str(cause))) from cause
    _require_velocities(chain, state, at)
    options = simulation_options(data, chain, at)
    how = data.simulation
    controlled = Controlled(chain, state, how.sample_time)
    controller = controllers.controller(data.controller, controlled, at / "controller")
    others: dict[str, Any] = {"trunk": trunk, "sweep": data.sweep, "recording": data.recording}
    return Scenario(name, text, chain, state, controller, how.duration, how.step, robots, options, **others)


def build_robots(data: SceneTable, files: RobotFiles, at: Location) -> tuple[SceneTrunk | None, dict[str, Robot]]:
    """Build the trunk, None if the scene has none, and the arms by name.

    Raises:
        SceneError: with the path of the first fault.
    """
    if not data.arms and not data.world:
        raise (at / "arms").refuse("expected at least one arm, or shapes in [[world]] for a free object, got none")
    if len(data.arms) > MOST_ARMS:
        raise (at / "arms").refuse(f"expected at most {MOST_ARMS} arms, got {len(data.arms)}")
    require_names((arm.name for arm in data.arms), at / "arms", "name")
    files = replace(files, packages={**data.packages, **files.packages})
    trunk = None if data.trunk is None else scene_trunk(data.trunk, data.arms, files, at)
    robots, joints = {}, 0 if trunk is None else trunk.trunk.joint_count
    for i, arm in enumerate(data.arms):
        out_of_file = None if trunk is None else trunk.arms.get(arm.name)
        robots[arm.name] = robot(arm, files, at / "arms" / i) if out_of_file is None else out_of_file
        joints += robots[arm.name].arm.joint_count
        if joints > MOST_JOINTS:
            raise (at / "arms" / i).refuse(f"expected at most {MOST_JOINTS} joints in all, got {joints} up to here")
    return trunk, robots


def closed(chain: ClosedChain, guess: State, search: bool) -> State:
    """Return the state in which the arms close their grasps; with `search`, other configurations are tried too.

    Object and trunk keep their poses and twists.

    Raises:
        ClosureError: an arm cannot reach its grasp.
    """
    try:
        return close(chain, guess, hold_object=True)
    except ClosureError:
        if not search:
            raise
    arms = base_kinematics(chain, guess, Inputs().shaped(chain)).arms
    q = {name: guess.q[chain.joints[name]] for name in chain.names}
    found = assemble(arms, chain.held_object, chain.grasps, object_pose=guess.object_pose, q=q, gravity=chain.gravity)
    first = chain.joint_count - len(found.state.q)
    return close(chain, replace(guess, q=np.concatenate([guess.q[:first], found.state.q])), hold_object=True)


def _require_velocities(chain: ClosedChain, state: State, at: Location) -> None:
    """Refuse initial twists of object and trunk that the arms between them cannot follow."""
    try:
        if chain.beyond_serial:
            given = mechanism_arguments(chain, state)
            require_closed_forest(given.motion({}), given.q, given.qd)
        else:
            require_closed(chain_motion(chain, state, np.zeros(chain.joint_count), Inputs().shaped(chain)), state)
    except StateError as cause:
        raise (at / "object" / "twist").refuse(
            f"expected a motion of object and trunk that the arms can follow: {cause}"
        ) from cause


def build_chain(
    data: SceneTable, trunk: SceneTrunk | None, robots: Mapping[str, Robot], at: Location
) -> tuple[ClosedChain, State]:
    """Return the chain, and the state from which its grasps are to be closed, with joints at rest.

    Raises:
        SceneError: with the path of the first fault.
    """
    require_names((grasp.arm for grasp in data.grasps if grasp.frame is None), at / "grasps", "arm")
    arms = {name: robot.arm for name, robot in robots.items()}
    grasps = {}
    for i, grasp in enumerate(data.grasps):
        if grasp.arm not in arms:
            raise (at / "grasps" / i / "arm").refuse(f"no arm '{grasp.arm}'.{checks.did_you_mean(grasp.arm, arms)}")
        if (key := parts.grasp_key(grasp)) in grasps:
            raise (at / "grasps" / i / "frame").refuse(f"'{grasp.frame}' of arm '{grasp.arm}' has a grasp already")
        grasps[key] = parts.grasp(grasp, at / "grasps" / i, grasp.of)
    require_names((loop.name for loop in data.loops), at / "loops", "name")
    loops = {loop.name: parts.loop(loop, at / "loops" / i) for i, loop in enumerate(data.loops)}
    couplings = [parts.coupling(one, at / "couplings" / i) for i, one in enumerate(data.couplings)]
    objects = build_objects(data, at)
    below = None if trunk is None else trunk.trunk
    for arm in data.arms:
        if arm.anchor and arm.base is None and arm.mount is None and arm.name in grasps:
            of = grasps[arm.name].of
            place = objects[of if of in objects else next(iter(objects))].pose
            arms[arm.name] = arms[arm.name].at(place @ grasps[arm.name].frame @ arms[arm.name].tip.inverse())
    springs = [parts.spring(spring, arms, below, at / "springs" / i) for i, spring in enumerate(data.springs)]
    mounts = build_mounts(data.arms, below, at / "arms")
    touching = parts.touching(data, at)
    bodies = {name: one.body for name, one in objects.items()}
    held: dict[str, Any] = {"held_object": bodies.pop(HELD_OBJECT)} if data.object is not None else {}
    with at.refusals():
        chain = ClosedChain(
            arms,
            grasps=grasps,
            gravity=np.array(data.gravity),
            trunk=below,
            mounts=mounts if trunk is None else {**trunk.mounts, **mounts},
            springs=springs,
            objects=bodies,
            loops=loops,
            couplings=couplings,
            touching=touching,
            **held,
        )
    q = np.concatenate([[], *([] if trunk is None else [trunk.q]), *(robot.q for robot in robots.values())])
    places, twists = [one.pose.wxyz_xyz for one in objects.values()], [one.twist for one in objects.values()]
    several = len(objects) != 1
    of_objects = (places, np.reshape(twists, (-1, 6))) if several else (places[0], np.array(twists[0]))
    base = (None, None) if trunk is None else (trunk.base_pose, trunk.base_twist)
    return chain, State(q, np.zeros(chain.joint_count), *of_objects, *base)


class PlacedObject(NamedTuple):
    """An object of a scene at its initial pose, with its initial twist (6,)."""

    body: HeldObject
    pose: Pose
    twist: Twist


def build_objects(data: SceneTable, at: Location) -> dict[str, PlacedObject]:
    """Return the objects by name in the order of the chain, of which "object" is the first.

    Raises:
        SceneError: with the path of the first fault.
    """
    require_names(data.objects, at / "objects")
    if data.object is not None and HELD_OBJECT in data.objects:
        raise (at / "objects" / HELD_OBJECT).refuse(f"expected another name beside the table [{HELD_OBJECT}]")
    tables = {} if data.object is None else {HELD_OBJECT: (data.object, at / HELD_OBJECT)}
    tables |= {name: (one, at / "objects" / name) for name, one in data.objects.items()}
    return {
        name: PlacedObject(parts.held_object(one, here), pose(one.pose, here / "pose"), one.twist)
        for name, (one, here) in tables.items()
    }


def build_mounts(arms: Sequence[ArmTable], trunk: Trunk | None, at: Location) -> dict[str, str | int]:
    """Return the trunk links on which arms are mounted, by the names of these arms.

    Raises:
        SceneError: a mount without a trunk, a mount on a link that the trunk does not have, or a key that a mounted
            arm cannot have.
    """
    mounts = {}
    for i, arm in enumerate(arms):
        if trunk is not None and arm.name == TRUNK:
            raise (at / i / "name").refuse(f"'{TRUNK}' is reserved for the trunk in flat arrays; try another")
        if arm.mount is None:
            continue
        if trunk is None:
            raise (at / i / "mount").refuse("expected none, as the scene has no trunk")
        with (at / i / "mount").refusals():
            trunk.body(arm.mount, arm.name)
        if arm.base_motion is not None:
            raise (at / i / "base_motion").refuse(
                f"expected none, as the arm is mounted on the trunk and moves with it; try {TRUNK}.base_motion"
            )
        mounts[arm.name] = arm.mount
    return mounts


def require_sensible(raw: Any, at: Location, levels: int = MOST_LEVELS) -> None:
    """Refuse NaN, infinity, huge numbers and deep nesting, which are valid TOML but make no sense in a scene.

    Args:
        raw: parsed content of the file, or of a part of it.
        at: location of `raw` in the scene.
        levels: largest allowed depth of nesting.

    Raises:
        SceneError: a value that is refused, with the path of the first one.
    """
    if not levels:
        raise at.refuse(f"expected at most {MOST_LEVELS} levels of tables and arrays")
    if isinstance(raw, float) and not math.isfinite(raw):
        raise at.refuse(f"expected a finite number, got {raw}")
    if isinstance(raw, int | float) and abs(raw) > LARGEST_NUMBER:
        raise at.refuse(f"expected a number up to {LARGEST_NUMBER:g} in SI units, got a larger one")
    if isinstance(raw, dict):
        for key, value in raw.items():
            require_sensible(value, at / str(key), levels - 1)
    if isinstance(raw, list):
        for i, value in enumerate(raw):
            require_sensible(value, at / i, levels - 1)
