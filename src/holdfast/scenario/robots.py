"""Building the arms and the trunk of a scene: built-in robots, URDF files, joints defined in the scene, or anchors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.assembly.starts import preferred_configuration
from holdfast.errors import HoldfastError
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.arm import Anchor, Arm
from holdfast.model.joint import Joint
from holdfast.model.trunk import TRUNK, Trunk
from holdfast.robots import ROBOTS
from holdfast.robots.packages import given_packages
from holdfast.robots.urdf import UrdfChain, UrdfTrunkChain, urdf_chain, urdf_trunk
from holdfast.robots.urdf.source import UrdfSource, read_source
from holdfast.scenario.joints import body, joints_and_links, parents, pose
from holdfast.scenario.scene import ArmTable, TrunkTable, UrdfTable
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

ORIGIN_KEYS = ("robot", "urdf", "joints", "anchor")
PLACE_KEYS = ("mount", "base", "base_motion")  # keys that an arm from the trunk's file cannot have


@dataclass(frozen=True, eq=False)
class Robot:
    """An arm of a scene.

    Attributes:
        arm: the arm at its base pose, with its tool.
        q: (N,) initial guess of the joint positions [rad or m].
        source: URDF from which the arm is loaded; None if it is not from a file.
        links: how the links of the file map to the arm; None if it is not from a file.
    """

    arm: Arm
    q: Array
    source: UrdfSource | None = None
    links: UrdfChain | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on what in the file was changed or ignored when it was loaded."""
        return () if self.links is None else self.links.notes


@dataclass(frozen=True)
class RobotFiles:
    """Where the robot files of a scene are found.

    Attributes:
        folder: folder to which relative file names refer.
        trust_xacro: whether xacro files may be expanded, which runs the Python code in them.
        kept: URDFs to use instead of an arm's file, by arm name; "trunk" for the trunk.
        packages: folders of packages by name, relative to `folder`; also those of the scene.
    """

    folder: Path = Path()
    trust_xacro: bool = False
    kept: Mapping[str, UrdfSource] = field(default_factory=dict)
    packages: Mapping[str, str | PathLike[str]] = field(default_factory=dict)

    def source(self, data: UrdfTable, name: str) -> UrdfSource:
        """Return the URDF of an arm, or of the trunk.

        Raises:
            SceneError: the file cannot be read, it is a xacro file that is not trusted or cannot be expanded, or a
                package is no folder.
            MissingExtra: it is a xacro file, and xacrodoc is not installed.
        """
        if name in self.kept:
            return self.kept[name]
        folders = given_packages(self.packages, self.folder)
        return read_source(self.folder / data.file, data.xacro_args, self.trust_xacro, folders)


def robot(data: ArmTable, files: RobotFiles, at: Location) -> Robot:
    """Return an arm at its base pose, and an initial guess of its joint positions.

    Args:
        data: the arm in the scene.
        files: where its URDF is found, if it has one.
        at: location of the arm in the scene.

    Raises:
        SceneError: there is no robot of that name, the URDF or the joints do not give a valid arm, or the number of
            joint positions is wrong.
        MissingExtra: its file is a xacro file, and xacrodoc is not installed.
    """
    require_one_origin(data, at)
    base = Pose.identity() if data.base is None else pose(data.base, at / "base")
    source = links = None
    if data.urdf is not None:
        with file_refusals(at):
            source = files.source(data.urdf, data.name)
        links = chain_of_file(data.urdf, source, base, at)
        arm = links.arm
    elif data.joints is not None:
        parts = joints_and_links(data.joints, at / "joints")
        with at.refusals():
            arm = Arm(*parts, base=base, name=data.name, parents=parents(data.joints))
    else:
        arm = Anchor(base, data.name) if data.anchor else built_in(data.robot, base, at)
    return finished(Robot(arm, preferred_configuration(arm), source, links), data, at)


def require_one_origin(data: ArmTable | TrunkTable, at: Location) -> None:
    """Require exactly one of the keys that define an arm or a trunk; a floating trunk needs none of them.

    Raises:
        SceneError: none of these keys is given, or more than one.
    """
    given = [origin for origin in ORIGIN_KEYS if getattr(data, origin, None) not in (None, False)]
    floats = isinstance(data, TrunkTable) and data.floating is not None
    if len(given) > 1 or not (given or floats):
        *known, last = (origin for origin in ORIGIN_KEYS if hasattr(data, origin))
        also = " or floating" if isinstance(data, TrunkTable) else ""
        got = " and ".join(given) or "none of them"
        raise at.refuse(f"expected one of {', '.join(known)} and {last}{also}, got {got}")


def finished(found: Robot, data: ArmTable, at: Location) -> Robot:
    """Return an arm with its tool and with the initial joint positions from the scene."""
    if data.frames:
        frames = {name: (one.link, pose(one, at / "frames" / name)) for name, one in data.frames.items()}
        with (at / "frames").refusals():
            found = replace(found, arm=replace(found.arm, frames={**found.arm.frames, **frames}))
    if data.tip is not None:
        arm, links = found.arm, found.links
        arm = arm.with_tip(arm.tip @ pose(data.tip, at / "tip"))
        if links is not None:  # the note is about the link's own frame, not the tool's
            links = replace(links, notes=tuple(note for note in links.notes if note != links.tip_note), tip_note="")
        found = replace(found, arm=arm, links=links)
    return replace(found, q=starting_positions(data.q, found.q, found.arm.name, at))


def starting_positions(given: list[float] | None, otherwise: Array, what: str, at: Location) -> Array:
    """Return the initial joint positions (N,) [rad or m]: those given, else `otherwise`.

    Raises:
        SceneError: the number of positions is wrong.
    """
    if given is None:
        return otherwise
    if len(given) != len(otherwise):
        raise (at / "q").refuse(f"expected {len(otherwise)} joint positions for a {what}, got {len(given)}")
    return np.array(given, dtype=float)


def built_in(name: str | None, base: Pose, at: Location) -> Arm:
    """Return a built-in robot by its name.

    Raises:
        SceneError: there is no robot of that name.
    """
    if name is None or name not in ROBOTS:
        raise (at / "robot").refuse(f"no robot '{name}'.{checks.did_you_mean(str(name), ROBOTS)}")
    return ROBOTS[name](base=base)


def chain_of_file(data: UrdfTable, source: UrdfSource, base: Pose, at: Location) -> UrdfChain:
    """Return the chain between two links of a file, with the armature and springs that the scene gives its joints.

    Raises:
        SceneError: the links between them are not a valid arm.
    """
    with file_refusals(at):
        links = urdf_chain(source, tip=data.tip, mount=base, **reading(data))
    (joints,) = with_drives(data, [links.arm.joints], at)
    return replace(links, arm=replace(links.arm, joints=joints))


def reading(data: UrdfTable) -> dict[str, Any]:
    """Return how the file of an arm or a trunk is read, as arguments of `load_urdf` and `load_urdf_trunk`."""
    closures = [tuple(one) for one in data.loop_closures]
    names = ("base", "locked", "lock_others", "branches")
    return {**{name: getattr(data, name) for name in names}, "loop_closures": closures}


@contextmanager
def file_refusals(at: Location) -> Iterator[None]:
    """Prefix errors in a robot's file with the location in the scene at which the file is named."""
    try:
        yield
    except HoldfastError as cause:  # its message names file and line
        raise type(cause)((at / "urdf").message(str(cause))) from cause


def with_drives(data: UrdfTable, chains: Sequence[Sequence[Joint]], at: Location) -> list[list[Joint]]:
    """Return the joints of chains with armature and springs from the scene instead of those of the file.

    Raises:
        SceneError: a joint does not exist, or a quantity is impossible.
    """
    found = [list(joints) for joints in chains]
    names = [joint.name for joints in found for joint in joints]
    for quantity in ("armature", "stiffness", "rest"):
        given, place = getattr(data, quantity), at / "urdf" / quantity
        for name in given:
            if name not in names:
                raise place.refuse(f"no moving joint '{name}'.{checks.did_you_mean(name, names)}")
        for joints in found:
            for k, joint in enumerate(joints):
                with (place / joint.name).refusals():
                    joints[k] = replace(joint, **{quantity: given.get(joint.name, getattr(joint, quantity))})
    return found


@dataclass(frozen=True, eq=False)
class SceneTrunk:
    """The trunk of a scene.

    Attributes:
        trunk: the trunk at its base pose.
        q: (n_t,) initial positions of its joints [rad or m].
        base_pose: initial pose of a floating base; None if the base does not float.
        base_twist: (6,) initial twist of a floating base; None if the base does not float.
        mounts: trunk links on which the arms from its file are mounted, by arm name; arms fixed in the world are
            missing.
        arms: the arms from its file, by name.
        source: URDF from which the trunk is loaded; None if it is not from a file.
        links: how the links of the file map to the trunk; None if it is not from a file.
    """

    trunk: Trunk
    q: Array
    base_pose: Pose | None = None
    base_twist: Array | None = None
    mounts: Mapping[str, str | int] = field(default_factory=FrozenDict)
    arms: Mapping[str, Robot] = field(default_factory=FrozenDict)
    source: UrdfSource | None = None
    links: UrdfTrunkChain | UrdfChain | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on what in the file was changed or ignored when it was loaded."""
        found = self.links.found if isinstance(self.links, UrdfTrunkChain) else self.links
        return () if found is None else found.notes


def scene_trunk(data: TrunkTable, arms: Sequence[ArmTable], files: RobotFiles, at: Location) -> SceneTrunk:
    """Return the trunk at its initial pose.

    Args:
        data: the trunk in the scene.
        arms: arms of the scene, some of which may be loaded from the trunk's file.
        files: where its URDF is found, if it has one.
        at: location of the scene.

    Raises:
        SceneError: with the path of the first fault.
        MissingExtra: its file is a xacro file, and xacrodoc is not installed.
    """
    here = at / TRUNK
    require_one_origin(data, here)
    base = pose(data.base, here / "base")
    floating = None if data.floating is None else body(data.floating, here / "floating")
    if floating is not None and floating.mass == 0.0:
        raise (here / "floating" / "mass").refuse(
            "expected > 0, since nothing else gives the floating body inertia, got 0"
        )
    if data.urdf is not None:
        found = _of_file(data, base, floating is not None, arms, files, at)
    elif data.joints is not None:
        if parents(data.joints):
            raise (here / "joints").refuse("expected a trunk in series, without parent; try branches in an arm")
        parts = joints_and_links(data.joints, here / "joints")
        with here.refusals():
            found = _at_rest(Trunk(*parts, base=base))
    elif data.robot is not None:
        found = _at_rest(_carrying(built_in(data.robot, base, here)))
    else:
        found = _at_rest(Trunk(base=base, floating=floating))
    if floating is not None:
        found = replace(found, trunk=replace(found.trunk, floating=floating))
    found = replace(found, q=starting_positions(data.q, found.q, TRUNK, here))
    return _where_it_floats(found, data, base, here)


def _where_it_floats(found: SceneTrunk, data: TrunkTable, base: Pose, at: Location) -> SceneTrunk:
    """Return the trunk with pose and twist of a floating base; refuse keys that do not apply to its base."""
    if found.trunk.floating is None:
        if data.twist is not None:
            raise (at / "twist").refuse(
                "expected none, as the trunk's base is fixed in the world; try floating, or base_motion"
            )
        return found
    if data.base_motion is not None:
        raise (at / "base_motion").refuse("expected none, as the trunk's base floats; try twist, its initial motion")
    return replace(found, base_pose=base, base_twist=np.zeros(6) if data.twist is None else np.array(data.twist))


def _at_rest(trunk: Trunk) -> SceneTrunk:
    """Return a trunk with its joints at the preferred configuration."""
    return SceneTrunk(trunk, np.zeros(0) if trunk.serial is None else preferred_configuration(trunk.serial))


def _carrying(arm: Arm) -> Trunk:
    return Trunk(arm.joints, arm.links, arm.base, visuals=arm.visuals)


def _of_file(
    data: TrunkTable, base: Pose, floats: bool, arms: Sequence[ArmTable], files: RobotFiles, at: Location
) -> SceneTrunk:
    """Return a trunk from a URDF file; see `scene_trunk`."""
    urdf, here = data.urdf, at / TRUNK
    assert urdf is not None
    with file_refusals(here):
        source = files.source(urdf, TRUNK)
    if not urdf.tips:
        if urdf.floating:
            raise (here / "urdf" / "floating").refuse("expected tips of arms with it, got none; try trunk.floating")
        links = chain_of_file(urdf, source, base, here)
        return replace(_at_rest(_carrying(links.arm)), source=source, links=links)
    if urdf.tip is not None:
        raise (here / "urdf").refuse("expected tip or tips, got both")
    if floats:
        raise (here / "floating").refuse("expected none together with tips of a file; try urdf.floating")
    _require_arms_of_file(urdf.tips, arms, at)
    with file_refusals(here):
        mount = None if urdf.floating else base
        links = urdf_trunk(source, urdf.tips, floating=urdf.floating, mount=mount, **reading(urdf))
    found = links.found
    names = list(found.arms)
    own, *others = with_drives(urdf, [found.trunk.joints, *(arm.joints for arm in found.arms.values())], here)
    trunk = replace(found.trunk, joints=own)
    carried = {}
    for name, joints in zip(names, others, strict=True):
        (i,) = (i for i, arm in enumerate(arms) if arm.name == name)
        arm = replace(found.arms[name], joints=joints)
        alone = Robot(arm, preferred_configuration(arm), source, links.chains[name])
        carried[name] = finished(alone, arms[i], at / "arms" / i)
        if data.base_motion is not None and name not in found.mounts:
            raise (here / "base_motion").refuse(
                f"expected none, as arm '{name}' is mounted on the base that would move"
            )
    return replace(_at_rest(trunk), mounts=found.mounts, arms=FrozenDict(carried), source=source, links=links)


def _require_arms_of_file(tips: Mapping[str, str], arms: Sequence[ArmTable], at: Location) -> None:
    """Refuse tips of arms that the scene does not have, and arms that are also defined outside the trunk's file."""
    places = {arm.name: i for i, arm in enumerate(arms)}
    for name in tips:
        if name not in places:
            raise (at / TRUNK / "urdf" / "tips").refuse(f"no arm '{name}'.{checks.did_you_mean(name, places)}")
        arm = arms[places[name]]
        for key in (*ORIGIN_KEYS, *PLACE_KEYS):
            if getattr(arm, key) not in (None, False):
                where = at / "arms" / places[name] / key
                raise where.refuse(f"expected none, as the arm is from the file of the trunk, {TRUNK}.urdf.tips")
