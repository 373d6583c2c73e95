"""Arms from a URDF file, with information on the other links and joints of the robot."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, Unpack

import holdfast.robots.urdf.chain_checks as chain_checks
from holdfast.errors import CallError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.names import did_you_mean
from holdfast.robots.notes import show_notes
from holdfast.robots.urdf.arm_parts import LoopClosures, UrdfOptions, joints_and_links, plain
from holdfast.robots.urdf.bodies import FoldedChain
from holdfast.robots.urdf.branches import folded_arm, leaving_free, mimicry
from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.loops import loops_within, with_loop_closures
from holdfast.robots.urdf.path import (
    Locks,
    PassedJoint,
    checked_locks,
    ends,
    known_link,
    path_between,
    resting_position,
)
from holdfast.robots.urdf.reader import read_urdf
from holdfast.robots.urdf.robot import UrdfRobot
from holdfast.robots.urdf.source import UrdfSource
from holdfast.robots.urdf.visuals import visuals_of_bodies
from holdfast.spatial.pose import Pose


@dataclass(frozen=True, eq=False)
class UrdfChain:
    """An arm with information on the other links and joints of the robot.

    Attributes:
        arm: the arm; its joints and links have the names in the file.
        robot: the links and joints in the file.
        base: name of the base link.
        tip: name of the link whose frame is the tip frame.
        locked: positions of locked joints within the arm and its base [rad or m], by name.
        bodies: N + 1 mappings from link name to pose: first the links on the base in the base's
            frame, then the links welded to arm link k in its frame.
        elsewhere: names of the links that move relative to the base by joints off the path.
        notes: notes, with line numbers, on what was not read, or was interpreted differently from the file; on links
            without mass and shape; and on a tip whose z axis does not point out of the hand. `load_urdf` warns of the
            first, which are the notes of the arm, too.
        tip_note: the last of these notes alone; "" if there is none.
    """

    arm: Arm
    robot: UrdfRobot
    base: str
    tip: str
    locked: Mapping[str, float]
    bodies: tuple[Mapping[str, Pose], ...]
    elsewhere: tuple[str, ...]
    notes: tuple[str, ...]
    tip_note: str = ""


def load_urdf(
    path_or_text: str | PathLike[str],
    *,
    base: str | None = None,
    tip: str | None = None,
    locked: Mapping[str, float] | None = None,
    lock_others: bool = False,
    branches: bool = False,
    mount: Any = None,
    physical: bool = True,
    xacro_args: Mapping[str, str] | None = None,
    trust_xacro: bool = False,
    packages: Mapping[str, str | PathLike[str]] | None = None,
    loop_closures: LoopClosures | None = None,
) -> Arm:
    """Return the arm between two links of a URDF or SDF file. O(links).

    Links that are fixed to one another are combined. Other links on the base are left out, because they do not affect
    the arm. Other links on the arm are part of it, so joints off the path from base to tip (of fingers, or of another
    arm) must be locked. `urdf_chain` also returns the assignment of each link.

    Joints keep the sign, axis, limits, damping and friction in the file. The base need not be the root, and joints may
    be passed from child to parent. A rate or effort limit of 0, and a position range of 0, mean that there is no limit.
    Angles within 1e-12 rad of a multiple of pi/2 are rounded to that multiple. A link without <inertial> is massless,
    and must be fixed to one that has mass.

    Args:
        path_or_text: a URDF or SDF file, the text itself, or a `.xacro` file (see `read_urdf`).
        base: name of the base link; by default the root.
        tip: name of the link whose frame is the tip frame; by default the only end link.
        locked: positions of joints to lock [rad or m], by name. A joint that mimics a locked one is locked, too.
        lock_others: lock every other joint on the arm at 0, or at its limit nearest to 0.
        branches: let the other joints on the arm move, as branches of it (`Arm.parents`), for example those of fingers;
            without a tip, all joints beyond the base. A joint that mimics another is coupled to it (`Arm.couplings`),
            and every link's frame has its name (`Arm.frames`). Such a chain answers `forward_dynamics`.
        mount: pose of the base link in the world (a Pose or wxyz_xyz); by default the world frame.
        physical: False accepts principal moments that no mass distribution has, and gives weight to links for which the
            file switches gravity off.
        xacro_args: values of the file's <xacro:arg> elements by name.
        trust_xacro: whether to expand a `.xacro` file, which runs the Python code in it.
        packages: folders of packages by name, for `$(find name)` and `package://name` (see `read_urdf`).
        loop_closures: loops that the file does not state, with `branches`: a list of (a, b) or (a, b, kind), of links
            whose frames a grasp kind brings together, a ball by default; or of closures between links; or these by
            name. They become `Arm.loops`.

    Warns:
        ModelWarning: once, with all notes on what was not read, or was interpreted differently from the file.

    Raises:
        SceneError: the file has an error or does not contain such an arm; the message gives file, line, element and
            advice.
        ModelError: the mount is not a pose.
        MissingExtra: the file is a `.xacro` file, and xacrodoc is not installed.
    """
    options: UrdfOptions = {"locked": locked, "lock_others": lock_others, "mount": mount, "physical": physical}
    options |= {"branches": branches, "xacro_args": xacro_args, "trust_xacro": trust_xacro, "packages": packages}
    options |= {"loop_closures": loop_closures}
    chain = urdf_chain(path_or_text, base=base, tip=tip, **options)
    show_notes(chain.arm.notes)
    return chain.arm


def load_urdf_arms(
    path_or_text: str | PathLike[str],
    arms: Mapping[str, tuple[str, str]],
    *,
    locked: Mapping[str, float] | None = None,
    lock_others: bool = False,
    branches: bool = False,
    mount: Any = None,
    physical: bool = True,
    xacro_args: Mapping[str, str] | None = None,
    trust_xacro: bool = False,
    packages: Mapping[str, str | PathLike[str]] | None = None,
    loop_closures: LoopClosures | None = None,
) -> dict[str, Arm]:
    """Return several arms of one robot, each with its base at its place on the robot. O(arms links).

        load_urdf_arms("robot.urdf", {"left": ("torso", "left_hand"), "right": ("torso", "right_hand")})

    Arms may share fixed links. A joint that moves two arms, or the base of an arm, must be locked: `lock_others` locks
    those that are not on the path of an arm (for example a torso below both bases) at 0 or at their limit nearest to 0;
    `locked` locks any joint at a given position. One error lists all joints that still have to be locked.

    Args:
        path_or_text: a file, the text itself, or a `.xacro` file (see `read_urdf`).
        arms: names of base and tip link, by arm.
        locked: as for `load_urdf`, for all arms.
        lock_others: as for `load_urdf`; joints that are branches of an arm are not locked.
        branches: as for `load_urdf`.
        mount: pose of the file's root link in the world (a Pose or wxyz_xyz); by default the world frame.
        physical: as for `load_urdf`.
        xacro_args: as for `load_urdf`.
        trust_xacro: as for `load_urdf`.
        packages: as for `load_urdf`.
        loop_closures: as for `load_urdf`; each within one arm.

    Warns:
        ModelWarning: as for `load_urdf`, once for all arms.

    Raises:
        SceneError, ModelError, MissingExtra: as for `load_urdf`.
    """
    options: UrdfOptions = {"locked": locked, "lock_others": lock_others, "mount": mount, "physical": physical}
    options |= {"branches": branches, "xacro_args": xacro_args, "trust_xacro": trust_xacro, "packages": packages}
    options |= {"loop_closures": loop_closures}
    chains = urdf_chains(path_or_text, arms, **options)
    show_notes(note for chain in chains.values() for note in chain.arm.notes)
    return {name: chain.arm for name, chain in chains.items()}


def urdf_chain(
    path_or_text: str | PathLike[str] | UrdfSource,
    *,
    base: str | None = None,
    tip: str | None = None,
    **options: Unpack[UrdfOptions],
) -> UrdfChain:
    """Return the arm of `load_urdf` with the assignment of every link and with notes. O(links).

    Args:
        path_or_text: as for `load_urdf`.
        base: as for `load_urdf`.
        tip: as for `load_urdf`.
        **options: as for `load_urdf`.

    Raises:
        SceneError, ModelError, MissingExtra: as for `load_urdf`.
    """
    robot = read_robot(path_or_text, options)
    branches = bool(options.get("branches"))
    if branches and tip is None:
        start = end = robot.root if base is None else known_link(robot, base, "base")
    else:
        start, end = ends(robot, base, tip, checked_locks(robot, options.get("locked")))
    path = path_between(robot, start, end)
    locks = locks_of(robot, [path], options)
    if branches:
        locks = leaving_free(locks, [(start, path)] if path else None)
    folded = folded_arm(start, path, locks, branches=branches)
    chain_checks.refuse_loose(locks, chain_checks.hanging(locks, folded))
    return _alone(locks, folded, mount_of(options), options)


def urdf_chains(
    path_or_text: str | PathLike[str], arms: Mapping[str, tuple[str, str]], **options: Unpack[UrdfOptions]
) -> dict[str, UrdfChain]:
    """Return the arms of `load_urdf_arms` with the assignment of every link and with notes. O(arms links).

    Args:
        path_or_text: as for `load_urdf_arms`.
        arms: as for `load_urdf_arms`.
        **options: as for `load_urdf_arms`.

    Raises:
        SceneError, ModelError, MissingExtra: as for `load_urdf_arms`.
    """
    robot = read_robot(path_or_text, options)
    ends_of = _ends_of_arms(robot, arms)
    paths = {name: path_between(robot, *ends) for name, ends in ends_of.items()}
    locks = locks_of(robot, paths.values(), options)
    loose = chain_checks.shared(locks, ends_of)
    resting = {joint.name: resting_position(joint) for joint, _ in loose}
    held_too = replace(locks, given={**resting, **locks.given})  # so that one error lists all that still moves
    branches = bool(options.get("branches"))
    if branches:
        held_too = leaving_free(held_too, [(base, paths[name]) for name, (base, _) in ends_of.items()])
    folds = {name: folded_arm(base, paths[name], held_too, branches=branches) for name, (base, _) in ends_of.items()}
    loose += [one for folded in folds.values() for one in chain_checks.hanging(held_too, folded)]
    chain_checks.refuse_loose(locks, loose)
    mount, chains = mount_of(options), {}
    for name, folded in folds.items():
        at, notes = _standing(locks, folded.base)
        chain = _alone(locks, folded, mount @ at, options)
        arm = replace(chain.arm, notes=(*notes, *chain.arm.notes))
        chains[name] = replace(chain, arm=arm, notes=(*notes, *chain.notes))
    return chains


def _ends_of_arms(robot: UrdfRobot, arms: Mapping[str, tuple[str, str]]) -> dict[str, tuple[str, str]]:
    """Return the checked names of the base and tip link of each arm."""
    if not isinstance(arms, Mapping) or not arms:
        raise robot.element.refuse("arms: expected (base, tip) by name, such as {'left': ('torso', 'left_hand')}")
    found = {}
    for name, pair in arms.items():
        if not isinstance(pair, (tuple, list)) or len(pair) != 2:
            raise robot.element.refuse(
                f"arm '{name}': expected the names of base and tip link, got {quoted(str(pair))}"
            )
        base, tip = pair
        found[name] = known_link(robot, base, f"arm '{name}': base"), known_link(robot, tip, f"arm '{name}': tip")
    return found


def _standing(locks: Locks, base: str) -> tuple[Pose, list[str]]:
    """Return the pose of an arm's base link in the root link's frame, and notes on joints locked automatically."""
    at, notes = Pose.identity(), []
    for joint, _ in path_between(locks.robot, locks.robot.root, base):
        across, q = locks.pose(joint), locks.position(joint)
        assert across is not None
        at = at @ across
        if q is not None and joint.name not in locks.given:
            notes.append(joint.element.message(f"locked at {q:g}, since it moves the base {quoted(base)}"))
    return at, notes


def read_robot(path_or_text: str | PathLike[str] | UrdfSource, options: UrdfOptions) -> UrdfRobot:
    """Return the links and joints in a file.

    Raises:
        CallError: there is no such option.
        SceneError, MissingExtra: as for `load_urdf`.
    """
    known = UrdfOptions.__annotations__
    if unknown := options.keys() - known.keys():
        hint = did_you_mean(min(unknown), known)
        raise CallError(f"URDF: got an unexpected keyword argument '{min(unknown)}'.{hint}")
    robot = read_urdf(
        path_or_text,
        xacro_args=options.get("xacro_args"),
        trust_xacro=options.get("trust_xacro", False),
        packages=options.get("packages"),
    )
    return with_loop_closures(robot, options.get("loop_closures"))


def locks_of(robot: UrdfRobot, paths: Collection[list[PassedJoint]], options: UrdfOptions) -> Locks:
    """Return the joints that the options lock; those on the paths to the tips must be joints of arms."""
    passed = frozenset(step.joint.name for path in paths for step in path)
    locks = Locks(robot, checked_locks(robot, options.get("locked")), bool(options.get("lock_others")), passed)
    for path in paths:
        chain_checks.refuse_unsupported(locks, path, coupled=bool(options.get("branches")))
    return locks


def mount_of(options: UrdfOptions) -> Pose:
    """Return the option `mount` as a pose; by default the world frame."""
    mount = options.get("mount")
    return Pose.identity() if mount is None else checks.pose(mount, "mount")


def _alone(locks: Locks, folded: FoldedChain, mount: Pose, options: UrdfOptions) -> UrdfChain:
    """Return an arm to which nothing outside of it is coupled."""
    chain = chain_of(locks, folded, mount, options)
    loops = chain.arm.loops if options.get("branches") else None
    moving = [joint.name for joint in chain.arm.joints]
    notes = chain_checks.coupling_notes(locks.robot, chain.bodies, moving, loops=loops)
    arm = replace(chain.arm, notes=(*notes, *chain.arm.notes))
    return replace(chain, arm=arm, notes=(*notes, *chain.notes))


def chain_of(locks: Locks, folded: FoldedChain, mount: Pose, options: UrdfOptions) -> UrdfChain:
    """Return the arm with its base link at a pose; all other joints on it must be locked."""
    robot, base = locks.robot, folded.base
    tip = folded.path[-1].beyond if folded.path else base
    if not folded.bodies:
        raise robot.element.refuse(
            f"expected a joint that moves between base {quoted(base)} and tip {quoted(tip)}, got none"
        )
    bodies = (folded.on_base, *(body.links for body in folded.bodies))
    visuals, unread = visuals_of_bodies(robot, bodies)
    joints, links, changed = joints_and_links(robot, folded, options)
    inside = {name for links in bodies for name in links}
    locked, notes, massless = chain_checks.read_within(locks, folded)
    notes += [*changed, *unread]
    arm = Arm(joints, links, Pose.identity(), mount, robot.name, visuals, notes, folded.parents)
    if options.get("branches"):
        frames = {name: (k, plain(at)) for k, body in enumerate(folded.bodies) for name, at in body.links.items()}
        arm = replace(arm, frames=frames, couplings=mimicry(robot, folded.joints), loops=loops_within(robot, folded))
    if not arm.parents:
        arm = arm.with_tip(plain(folded.tip))
    tip_note = chain_checks.tip_note_of(robot, arm, tip, folded)
    return UrdfChain(
        arm=arm,
        robot=robot,
        base=base,
        tip=tip,
        locked=locked,
        bodies=bodies,
        elsewhere=tuple(name for name in robot.links if name not in inside),
        notes=(*notes, *massless, *([tip_note] if tip_note else [])),
        tip_note=tip_note,
    )
