"""Arms on a common trunk from a URDF file; the trunk consists of the joints that several arms share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import Unpack

from holdfast.model import checks
from holdfast.model.trunk import BASE, Trunk
from holdfast.robots.arms_on_trunk import ArmsOnTrunk, branching, mount_name, shared_counts
from holdfast.robots.notes import show_notes
from holdfast.robots.urdf.arm_parts import UrdfOptions, joints_and_links
from holdfast.robots.urdf.bodies import FoldedChain, fold, welded_link
from holdfast.robots.urdf.branches import folded_arm, leaving_free
from holdfast.robots.urdf.chain import (
    UrdfChain,
    chain_of,
    locks_of,
    mount_of,
    read_robot,
)
from holdfast.robots.urdf.chain_checks import coupling_notes, hanging, read_within, refuse_loose
from holdfast.robots.urdf.document import listed, quoted
from holdfast.robots.urdf.loops import loops_within
from holdfast.robots.urdf.path import Locks, PassedJoint, known_link, path_between
from holdfast.robots.urdf.robot import UrdfRobot
from holdfast.robots.urdf.source import UrdfSource
from holdfast.robots.urdf.visuals import visuals_of_bodies
from holdfast.spatial.pose import Pose

TrunkPath = list[PassedJoint]


@dataclass(frozen=True, eq=False)
class UrdfTrunkChain:
    """The result of `load_urdf_trunk`, with the assignment of the file's links.

    Attributes:
        found: trunk, arms and mounts.
        robot: the links and joints in the file.
        bodies: mappings from link name to pose, one more than the trunk has links: first the links on its base, which
            is fixed or floats, in the base's frame, then those welded to link k in its frame.
        chains: each arm by name, without the links of the trunk.
    """

    found: ArmsOnTrunk
    robot: UrdfRobot
    bodies: tuple[Mapping[str, Pose], ...]
    chains: Mapping[str, UrdfChain]


def load_urdf_trunk(
    path_or_text: str | PathLike[str],
    tips: Mapping[str, str] | Iterable[str],
    *,
    base: str | None = None,
    floating: bool = False,
    **options: Unpack[UrdfOptions],
) -> ArmsOnTrunk:
    """Return arms of one robot, and the joints that they share as the trunk on which they are mounted. O(arms links).

        load_urdf_trunk("robot.urdf", {"left": "left_hand", "right": "right_hand"}, lock_others=True)

    The trunk consists of the movable joints, from the base on, that are on the paths to more than one tip. Each arm
    begins where its path is not shared. Arms may be mounted on different links of the trunk, or on the base; a trunk
    that branches is refused. Links that are fixed to the trunk are part of it. Other joints on the trunk and the arms
    (of a head, of fingers, or of legs on a floating base) must be locked, as for `load_urdf_arms`.

    Args:
        path_or_text: a file, the text itself, or a `.xacro` file (see `read_urdf`).
        tips: name of the link whose frame is the tip frame, by arm; or a list of such names, which are then the names
            of the arms, too.
        base: name of the base link, which is fixed or floats; by default the root.
        floating: whether the base is a free body. It also is one if the first joint on the path to all tips is a
            floating joint; its frame is then that of the link after this joint. The pose of a free body is part of the
            state.
        **options: as for `load_urdf_arms`, with `mount` the pose of the base link in the world.

    Raises:
        SceneError: as for `load_urdf_arms`; or no joint moves two arms and the base is fixed, the trunk branches, an
            arm has no joint of its own, or a mount is given for a floating base.
        ModelError, MissingExtra: as for `load_urdf_arms`.

    Warns:
        ModelWarning: as for `load_urdf_arms`.
    """
    chain = urdf_trunk(path_or_text, tips, base=base, floating=floating, **options)
    show_notes([*chain.found.trunk.notes, *(note for one in chain.chains.values() for note in one.arm.notes)])
    return chain.found


def urdf_trunk(
    path_or_text: str | PathLike[str] | UrdfSource,
    tips: Mapping[str, str] | Iterable[str],
    *,
    base: str | None = None,
    floating: bool = False,
    **options: Unpack[UrdfOptions],
) -> UrdfTrunkChain:
    """Return the result of `load_urdf_trunk` with the assignment of every link. O(arms links).

    Args:
        path_or_text: as for `load_urdf_trunk`.
        tips: as for `load_urdf_trunk`.
        base: as for `load_urdf_trunk`.
        floating: as for `load_urdf_trunk`.
        **options: as for `load_urdf_trunk`.

    Raises:
        SceneError, ModelError, MissingExtra: as for `load_urdf_trunk`.
    """
    robot = read_robot(path_or_text, options)
    ends = _ends(robot, tips)
    start = robot.root if base is None else known_link(robot, base, "base")
    start, floats = _base(robot, start, ends, floating)
    if floats and options.get("mount") is not None:
        raise robot.element.refuse("mount: expected none, since the base floats: its pose is in the state")
    paths = {name: path_between(robot, start, tip) for name, tip in ends.items()}
    locks = locks_of(robot, paths.values(), options)
    shared = _shared(locks, paths)
    if not floats and not any(shared.values()):
        pairs = ", ".join(f"{name!r}: ({quoted(start)}, {quoted(tip)})" for name, tip in ends.items())
        raise robot.element.refuse(
            f"tips: expected a joint that moves two of the arms, got none between base {quoted(start)} and the tips;"
            f" try load_urdf_arms with {{{pairs}}}, or floating=True"
        )
    if options.get("branches"):
        own = {name: path[len(_until(path, shared[name])) :] for name, path in paths.items()}
        roots = {name: shared[name][-1].beyond if shared[name] else start for name in paths}
        locks = leaving_free(locks, [(roots[name], path) for name, path in own.items()])
    longest = max(shared, key=lambda name: len(shared[name]))
    common = fold(start, _until(paths[longest], shared[longest]), locks, floats=floats)
    folds = {
        name: folded_arm(
            shared[name][-1].beyond if shared[name] else start,
            path[len(_until(path, shared[name])) :],
            locks,
            branches=bool(options.get("branches")),
        )
        for name, path in paths.items()
    }
    loose = hanging(locks, common, "trunk", locks.on_path | _floating_above(robot, start))
    refuse_loose(locks, loose + [one for folded in folds.values() for one in hanging(locks, folded)])
    return _on_trunk(locks, common, folds, {name: len(steps) for name, steps in shared.items()}, options)


def _ends(robot: UrdfRobot, tips: Mapping[str, str] | Iterable[str]) -> dict[str, str]:
    """Return the checked name of the tip link of each arm."""
    if not checks.is_listed(tips) or not (given := [*tips]):
        raise robot.element.refuse("tips: expected links by arm, such as {'left': 'left_hand', 'right': 'right_hand'}")
    named = tips if isinstance(tips, Mapping) else {str(tip): tip for tip in given}
    return {name: known_link(robot, tip, f"arm '{name}': tip") for name, tip in named.items()}


def _base(robot: UrdfRobot, start: str, ends: Mapping[str, str], floating: bool) -> tuple[str, bool]:
    """Return the base and whether it floats; a floating joint that is first on all paths moves the base beyond it."""
    paths = [path_between(robot, start, tip) for tip in ends.values()]
    first = {next((step for step in path if not step.joint.is_fixed), None) for path in paths}
    step = first.pop()
    free = not first and step is not None and step.joint.name in _floating_above(robot, step.beyond)
    return (step.beyond, True) if free and step is not None else (start, bool(floating))


def _floating_above(robot: UrdfRobot, link: str) -> set[str]:
    """Return the name of the joint above a link if it is a floating joint, which does not constrain a free body."""
    above = robot.joint_above.get(link)
    return {above.name} if above is not None and above.kind == "floating" else set()


def _shared(locks: Locks, paths: Mapping[str, TrunkPath]) -> dict[str, TrunkPath]:
    """Return the moving joints that each arm shares with another, which are the first ones on the path to its tip.

    Raises:
        SceneError: an arm has no joint of its own, or the trunk branches.
    """
    moving = {name: [step for step in path if locks.pose(step.joint) is None] for name, path in paths.items()}
    counts = shared_counts(moving)
    for name, steps in moving.items():
        if counts[name] == len(steps):
            raise locks.robot.element.refuse(f"arm '{name}': expected a joint that moves no other arm, got none")
    if (found := branching(moving, counts)) is not None:
        (aside, ahead), (left, right) = found
        raise aside.joint.element.refuse(
            f"moves arms {listed(left)}, while {quoted(ahead.joint.name)} moves arms {listed(right)}: expected"
            f" shared joints in series, got a branching trunk; try locking one of the branches, or fewer tips"
        )
    return {name: steps[: counts[name]] for name, steps in moving.items()}


def _until(path: TrunkPath, shared: TrunkPath) -> TrunkPath:
    """Return the path up to the last shared joint."""
    return path[: path.index(shared[-1]) + 1] if shared else []


def _on_trunk(
    locks: Locks, common: FoldedChain, folds: Mapping[str, FoldedChain], shared: Mapping[str, int], options: UrdfOptions
) -> UrdfTrunkChain:
    """Return trunk and arms; `shared` contains the number of trunk joints below each arm."""
    robot, floats = locks.robot, common.floats
    joints, links, notes = joints_and_links(robot, common, options)
    free = welded_link(robot, common.on_base, "it floats", options.get("physical", True), notes) if floats else None
    bodies = (common.on_base, *(body.links for body in common.bodies))
    visuals, unread = visuals_of_bodies(robot, bodies)
    locked, within, frames = read_within(locks, common)
    parts = [*bodies, *(body.links for folded in folds.values() for body in folded.bodies)]
    moving = {body.step.joint.name for folded in (common, *folds.values()) for body in folded.bodies}
    loops = {name for folded in folds.values() for name in loops_within(robot, folded)}
    closed = loops if options.get("branches") else None
    notes += [*coupling_notes(robot, parts, moving, floats, closed), *within, *unread]
    trunk = Trunk(joints, links, mount_of(options), free, visuals, notes)
    notes += frames
    chains, mounts = {}, {}
    for name, folded in folds.items():
        k = shared[name]
        if k > 0:
            mounts[name], at = mount_name(trunk, k - 1), common.bodies[k - 1].links[folded.base]
        elif floats:
            mounts[name], at = BASE, common.on_base[folded.base]
        else:
            at = trunk.base
        chain = chain_of(locks, folded, at, options)
        visuals = chain.arm.visuals  # the link below the arm belongs to the trunk
        own = replace(
            chain.arm, visuals=None if visuals is None else replace(visuals, bodies=((), *visuals.bodies[1:]))
        )
        chains[name] = replace(chain, arm=own, bodies=({}, *chain.bodies[1:]))
        locked |= chain.locked
        notes += chain.notes
    arms = {name: chain.arm for name, chain in chains.items()}
    found = ArmsOnTrunk(trunk, arms, mounts, locked, tuple(dict.fromkeys(notes)))
    return UrdfTrunkChain(found, robot, bodies, chains)
