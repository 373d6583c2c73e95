"""Building the arms of a scene: built-in robots, URDF files, joints defined in the scene, or anchors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path

import numpy as np

from holdfast.assembly.starts import preferred_configuration
from holdfast.errors import HoldfastError
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.arm import Anchor, Arm
from holdfast.model.joint import Joint
from holdfast.robots import ROBOTS
from holdfast.robots.packages import given_packages
from holdfast.robots.urdf import UrdfChain, urdf_chain
from holdfast.robots.urdf.source import Source, read_source
from holdfast.scenario.joints import joints_and_links
from holdfast.scenario.poses import pose
from holdfast.scenario.scene import ArmData, TrunkData, UrdfData
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

ORIGINS = ("robot", "urdf", "joints", "anchor")


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
    source: Source | None = None
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
    kept: Mapping[str, Source] = field(default_factory=dict)
    packages: Mapping[str, str | PathLike[str]] = field(default_factory=dict)

    def source(self, data: UrdfData, name: str) -> Source:
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


def robot(data: ArmData, files: RobotFiles, at: Location) -> Robot:
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
    if data.urdf is not None:
        with file_refusals(at):
            source = files.source(data.urdf, data.name)
        links = chain_of_file(data.urdf, source, base, at)
        found = Robot(links.arm, preferred_configuration(links.arm), source, links)
    elif data.joints is not None:
        parts = joints_and_links(data.joints, at / "joints")
        with at.refusals():
            found = _standing(Arm(*parts, base=base, name=data.name))
    elif data.anchor:
        found = Robot(Anchor(base, data.name), np.zeros(0))
    else:
        found = _standing(built_in(data.robot, base, at))
    return finished(found, data, at)


def require_one_origin(data: ArmData | TrunkData, at: Location) -> None:
    """Require exactly one of the keys that define an arm or a trunk; a floating trunk needs none of them.

    Raises:
        SceneError: none of these keys is given, or more than one.
    """
    given = [origin for origin in ORIGINS if getattr(data, origin, None) not in (None, False)]
    floats = isinstance(data, TrunkData) and data.floating is not None
    if len(given) > 1 or not (given or floats):
        *known, last = (origin for origin in ORIGINS if hasattr(data, origin))
        also = " or floating" if isinstance(data, TrunkData) else ""
        got = " and ".join(given) or "none of them"
        raise at.refuse(f"expected one of {', '.join(known)} and {last}{also}, got {got}")


def finished(found: Robot, data: ArmData, at: Location) -> Robot:
    """Return an arm with its tool and with the initial joint positions from the scene."""
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


def chain_of_file(data: UrdfData, source: Source, base: Pose, at: Location) -> UrdfChain:
    """Return the chain between two links of a file, with the armature and springs that the scene gives its joints.

    Raises:
        SceneError: the links between them are not a valid arm.
    """
    with file_refusals(at):
        links = urdf_chain(
            source, base=data.base, tip=data.tip, locked=data.locked, lock_others=data.lock_others, mount=base
        )
    (joints,) = with_drives(data, [links.arm.joints], at)
    return replace(links, arm=replace(links.arm, joints=joints))


@contextmanager
def file_refusals(at: Location) -> Iterator[None]:
    """Prefix errors in a robot's file with the location in the scene at which the file is named."""
    try:
        yield
    except HoldfastError as cause:  # its message names file and line
        raise type(cause)((at / "urdf").message(str(cause))) from cause


def with_drives(data: UrdfData, chains: Sequence[Sequence[Joint]], at: Location) -> list[list[Joint]]:
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


def _standing(arm: Arm) -> Robot:
    return Robot(arm, preferred_configuration(arm))
