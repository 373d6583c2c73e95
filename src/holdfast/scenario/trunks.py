"""Building the trunk of a scene, and the arms that are loaded from its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from holdfast.assembly.starts import preferred_configuration
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import TRUNK
from holdfast.model.trunk import Trunk
from holdfast.robots.urdf import UrdfChain, UrdfTrunkChain, urdf_trunk
from holdfast.robots.urdf.source import UrdfSource
from holdfast.scenario import robots
from holdfast.scenario.joints import body, joints_and_links
from holdfast.scenario.poses import pose
from holdfast.scenario.scene import ArmData, TrunkData
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

OWN_PLACE = ("mount", "base", "base_motion")  # keys that an arm from the trunk's file cannot have


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
    arms: Mapping[str, robots.Robot] = field(default_factory=FrozenDict)
    source: UrdfSource | None = None
    links: UrdfTrunkChain | UrdfChain | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on what in the file was changed or ignored when it was loaded."""
        found = self.links.found if isinstance(self.links, UrdfTrunkChain) else self.links
        return () if found is None else found.notes


def scene_trunk(data: TrunkData, arms: Sequence[ArmData], files: robots.RobotFiles, at: Location) -> SceneTrunk:
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
    robots.require_one_origin(data, here)
    base = pose(data.base, here / "base")
    floating = None if data.floating is None else body(data.floating, here / "floating")
    if floating is not None and floating.mass == 0.0:
        raise (here / "floating" / "mass").refuse(
            "expected > 0, since nothing else gives the floating body inertia, got 0"
        )
    if data.urdf is not None:
        found = _of_file(data, base, floating is not None, arms, files, at)
    elif data.joints is not None:
        parts = joints_and_links(data.joints, here / "joints")
        with here.refusals():
            found = _at_rest(Trunk(*parts, base=base))
    elif data.robot is not None:
        found = _at_rest(_carrying(robots.built_in(data.robot, base, here)))
    else:
        found = _at_rest(Trunk(base=base, floating=floating))
    if floating is not None:
        found = replace(found, trunk=replace(found.trunk, floating=floating))
    found = replace(found, q=robots.starting_positions(data.q, found.q, TRUNK, here))
    return _where_it_floats(found, data, base, here)


def _where_it_floats(found: SceneTrunk, data: TrunkData, base: Pose, at: Location) -> SceneTrunk:
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
    data: TrunkData, base: Pose, floats: bool, arms: Sequence[ArmData], files: robots.RobotFiles, at: Location
) -> SceneTrunk:
    """Return a trunk from a URDF file; see `scene_trunk`."""
    urdf, here = data.urdf, at / TRUNK
    assert urdf is not None
    with robots.file_refusals(here):
        source = files.source(urdf, TRUNK)
    if not urdf.tips:
        if urdf.floating:
            raise (here / "urdf" / "floating").refuse("expected tips of arms with it, got none; try trunk.floating")
        links = robots.chain_of_file(urdf, source, base, here)
        return replace(_at_rest(_carrying(links.arm)), source=source, links=links)
    if urdf.tip is not None:
        raise (here / "urdf").refuse("expected tip or tips, got both")
    if floats:
        raise (here / "floating").refuse("expected none together with tips of a file; try urdf.floating")
    _require_arms_of_file(urdf.tips, arms, at)
    with robots.file_refusals(here):
        links = urdf_trunk(
            source,
            urdf.tips,
            base=urdf.base,
            floating=urdf.floating,
            locked=urdf.locked,
            lock_others=urdf.lock_others,
            mount=None if urdf.floating else base,
        )
    found = links.found
    names = list(found.arms)
    own, *others = robots.with_drives(urdf, [found.trunk.joints, *(arm.joints for arm in found.arms.values())], here)
    trunk = replace(found.trunk, joints=own)
    carried = {}
    for name, joints in zip(names, others, strict=True):
        (i,) = (i for i, arm in enumerate(arms) if arm.name == name)
        arm = replace(found.arms[name], joints=joints)
        alone = robots.Robot(arm, preferred_configuration(arm), source, links.chains[name])
        carried[name] = robots.finished(alone, arms[i], at / "arms" / i)
        if data.base_motion is not None and name not in found.mounts:
            raise (here / "base_motion").refuse(
                f"expected none, as arm '{name}' is mounted on the base that would move"
            )
    return replace(_at_rest(trunk), mounts=found.mounts, arms=FrozenDict(carried), source=source, links=links)


def _require_arms_of_file(tips: Mapping[str, str], arms: Sequence[ArmData], at: Location) -> None:
    """Refuse tips of arms that the scene does not have, and arms that are also defined outside the trunk's file."""
    places = {arm.name: i for i, arm in enumerate(arms)}
    for name in tips:
        if name not in places:
            raise (at / TRUNK / "urdf" / "tips").refuse(f"no arm '{name}'.{checks.did_you_mean(name, places)}")
        arm = arms[places[name]]
        for key in (*robots.ORIGINS, *OWN_PLACE):
            if getattr(arm, key) not in (None, False):
                where = at / "arms" / places[name] / key
                raise where.refuse(f"expected none, as the arm is from the file of the trunk, {TRUNK}.urdf.tips")
