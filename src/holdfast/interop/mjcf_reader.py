"""Loading arms, and the trunk that they share, from MJCF with MuJoCo's own compiler.

The compiler resolves defaults, includes and geoms. A trunk consists of the joints that several arms share.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from os import PathLike
from typing import Any

from holdfast.errors import SceneError
from holdfast.interop.mjcf_bodies import (
    MJCF_KINDS,
    BodyGroup,
    MjcfRobot,
    add_branches,
    along,
    held_joints,
    link_of,
    pose_in_world,
)
from holdfast.interop.mjcf_branches import arm_with_branches
from holdfast.interop.mjcf_couplings import Moving, checked_couplings
from holdfast.interop.mjcf_model import compiled_mjcf
from holdfast.interop.mjcf_tree import bodies_between, body_name, find_base, find_tip, joint_kind, joint_name, joints_of
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.trunk import BASE, Trunk
from holdfast.robots.arms_on_trunk import ArmsOnTrunk, branching, mount_name, shared_counts
from holdfast.robots.notes import show_notes
from holdfast.spatial.pose import Pose


def load_mjcf(
    path_or_text: str | PathLike[str],
    *,
    base: str | None = None,
    tip: str | None = None,
    locked: Mapping[str, float] | None = None,
    lock_others: bool = False,
    branches: bool = False,
    mount: Any = None,
) -> Arm:
    """Return the arm between two bodies of an MJCF file. O(bodies).

    Bodies that are fixed to one another become one link. Other bodies on the base are left out, because they do not
    affect the arm. Other bodies on the arm are part of it, so that joints off the path from base to tip (fingers,
    another arm) must be locked. Several joints in one body are connected by massless links.

    Hinges and slides keep their axis, range, damping, spring, armature and friction loss. The effort limit is the
    joint's `actuatorfrcrange`, or otherwise the force range of its only actuator times the gear; of an asymmetric range
    it is the smaller side. MJCF has no rate limits. Properties of the scene are not read: contacts, controls, and
    equalities with bodies outside the arm. Gravity other than MuJoCo's default, fluids, servos, flexible bodies and
    equalities that are not active are noted. `load_mjcf_arms` and `load_mjcf_trunk` load several arms of one file.

    Args:
        path_or_text: a file, or the text itself (which begins with `<`).
        base: name of the fixed body; by default the world.
        tip: name of the site or body whose frame is the tip; by default the only end body.
        locked: positions at which to lock joints [rad or m], by name.
        lock_others: whether to lock all other joints on the arm at their positions in the model.
        branches: whether the other joints on the arm move, as branches of it (`Arm.parents`), for example those of
            fingers; without a tip, all joints beyond the base. Ball joints are read, connect and weld equalities become
            loops of the arm, and equalities of joints and of fixed tendons its couplings. Every body's and every site's
            frame has its name (`Arm.frames`). Such a chain answers `forward_dynamics`.
        mount: pose of the base body in the world (a Pose or wxyz_xyz); by default its pose in the model.

    Warns:
        ModelWarning: once, with all notes on what acts on the arm and was not read.

    Raises:
        SceneError: MuJoCo cannot compile the file; or the arm has free or ball joints on the path, nonlinear springs,
            gravity compensation, couplings or loops, which the message names.
        ModelError: `mount` is not a pose.
        MissingExtra: MuJoCo is not installed.
    """
    source, model, unknown = compiled_mjcf(path_or_text)
    start = find_base(source, model, base)
    robot = MjcfRobot(source, model, held_joints(source, model, locked), lock_others, unknown)
    at = pose_in_world(robot, start) if mount is None else checks.pose(mount, "mount")
    if branches and tip is None:
        arm = arm_with_branches(robot, start, [], Pose.identity(), at, base or source)
        show_notes(arm.notes)
        return arm
    end, tip_frame = find_tip(source, model, start, tip)
    path = bodies_between(source, model, start, end)
    if branches:
        arm = arm_with_branches(robot, start, path, tip_frame, at, base or body_name(model, path[0]))
        show_notes(arm.notes)
        return arm
    arm = _alone(robot, start, path, tip_frame, at, base or body_name(model, path[0]))
    show_notes(arm.notes)
    return arm


def load_mjcf_arms(
    path_or_text: str | PathLike[str],
    arms: Mapping[str, tuple[str, str]],
    *,
    locked: Mapping[str, float] | None = None,
    lock_others: bool = False,
    mount: Any = None,
) -> dict[str, Arm]:
    """Return several arms of one MJCF file, each at its base pose. O(arms bodies).

        load_mjcf_arms("robot.xml", {"left": ("torso", "left_hand"), "right": ("torso", "right_hand")})

    Arms may share static bodies. A joint that moves two arms or an arm's base must be locked, for the latter also by
    `lock_others`. To keep shared joints movable, use `load_mjcf_trunk`.

    Args:
        path_or_text: a file, or the text itself (which begins with `<`).
        arms: by arm, the names of the base body and of the site or body whose frame is the tip.
        locked: as for `load_mjcf`, for all arms.
        lock_others: as for `load_mjcf`; also locks joints below the bases that are on no arm's path.
        mount: pose of the model's world frame in the world (a Pose or wxyz_xyz); by default they coincide.

    Warns:
        ModelWarning: as for `load_mjcf`, once for all arms.

    Raises:
        SceneError: as for `load_mjcf`; or a joint that moves two arms or an arm's base is not locked.
        ModelError, MissingExtra: as for `load_mjcf`.
    """
    source, model, unknown = compiled_mjcf(path_or_text)
    robot = MjcfRobot(source, model, held_joints(source, model, locked), lock_others, unknown)
    if not isinstance(arms, Mapping) or not arms:
        raise SceneError(f"{source}: arms: expected (base, tip) by name, such as {{'left': ('torso', 'left_hand')}}")
    at = Pose.identity() if mount is None else checks.pose(mount, "mount")
    bases, paths, tips = {}, {}, {}
    for name, pair in arms.items():
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise SceneError(f"{source}: arm '{name}': expected names of base and tip, got {checks.short(pair)}")
        bases[name] = find_base(source, model, pair[0])
        end, tips[name] = find_tip(source, model, bases[name], pair[1])
        paths[name] = bodies_between(source, model, bases[name], end)
    _require_apart(robot, bases, paths)
    found = {
        name: _alone(robot, bases[name], paths[name], tips[name], at @ pose_in_world(robot, bases[name]), name)
        for name in arms
    }
    show_notes(note for arm in found.values() for note in arm.notes)
    return found


def _alone(robot: MjcfRobot, start: int, path: list[int], tip_frame: Pose, base: Pose, name: str) -> Arm:
    """Return the arm along a path of bodies, to which nothing outside of it is coupled; see `arm_of`."""
    groups, tip = groups_along(robot, path)
    bodies = [{b for b, _ in group.bodies} for group in groups]
    notes = checked_couplings(Moving(robot, bodies, {*robot.moving(path)}, start))
    return replace(arm_of(robot, groups, tip @ tip_frame, base, name), notes=(*robot.notes, *notes))


def groups_along(robot: MjcfRobot, path: list[int]) -> tuple[list[BodyGroup], Pose]:
    """Return the bodies along a path by the joint that moves them, and the last body's pose in the last group.

    Args:
        robot: the model.
        path: indices of the bodies, base outward.

    Raises:
        SceneError: no joint moves, or there are joints that an arm cannot have.
    """
    groups, tip = along(robot, path)
    if not groups:
        raise SceneError(f"{robot.source}: expected a joint between base and tip, got none that moves")
    for group in groups:
        add_branches(robot, group, set(path))
    return groups, tip


def arm_of(robot: MjcfRobot, groups: list[BodyGroup], tip: Pose, base: Pose, name: str) -> Arm:
    """Return the arm of some groups of bodies, with its tip in the last one and its base at a pose in the world."""
    joints = [group.joint for group in groups if group.joint is not None]
    return Arm(joints, [link_of(robot.model, group) for group in groups], tip, base, name=name)


def _require_apart(robot: MjcfRobot, bases: Mapping[str, int], paths: Mapping[str, list[int]]) -> None:
    """Refuse joints that move two arms, and joints below a base that are not locked."""
    source, model = robot.source, robot.model
    of_arm: dict[int, str] = {}
    for name, path in paths.items():
        for j in robot.moving(path):
            if j in of_arm:
                raise SceneError(
                    f"{source}: joint '{joint_name(model, j)}' moves both arm '{of_arm[j]}' and arm '{name}'; try"
                    f" locked={{'{joint_name(model, j)}': 0.0}}, or load_mjcf_trunk, which reads what arms share"
                )
            of_arm[j] = name
    for name, base in bases.items():
        below = robot.moving(bodies_between(source, model, 0, base)) if base else []
        loose = [j for j in below if j in of_arm or not robot.lock_others]
        if loose:
            held = f"locked={{'{joint_name(model, loose[0])}': 0.0}}"
            raise SceneError(
                f"{source}: joint '{joint_name(model, loose[0])}' moves the base of arm '{name}'; expected it to be"
                f" held, try {held}" + ("" if loose[0] in of_arm else " or lock_others=True")
            )


def load_mjcf_trunk(
    path_or_text: str | PathLike[str],
    tips: Mapping[str, str] | Iterable[str],
    *,
    base: str | None = None,
    floating: bool = False,
    locked: Mapping[str, float] | None = None,
    lock_others: bool = False,
    mount: Any = None,
) -> ArmsOnTrunk:
    """Return arms of one robot and the trunk that they share. O(arms bodies).

        load_mjcf_trunk("robot.xml", {"left": "left_hand", "right": "right_hand"}, lock_others=True)

    The trunk consists of the movable joints from the base that are on the paths to more than one tip; each arm begins
    at the first joint that moves it alone. Arms may be mounted on different bodies of the trunk or on the base, but the
    trunk must not branch. Bodies that are fixed to the trunk are part of it. Other joints on trunk and arms (a head,
    fingers, legs on a floating base) must be locked, as for `load_mjcf`.

    Args:
        path_or_text: a file, or the text itself (which begins with `<`).
        tips: by arm, the name of the site or body whose frame is the tip; or only these names, which are then also the
            names of the arms.
        base: name of the body that is fixed or floats; by default the world.
        floating: whether the base is a free body. It also is one if the model's first joint on the paths to the tips is
            a free joint. Its pose is then in the state. Other arms may be fixed in the world.
        locked: positions at which to lock joints [rad or m], by name.
        lock_others: whether to lock all other joints on trunk and arms at their positions in the model.
        mount: pose of the base in the world (a Pose or wxyz_xyz); by default its pose in the model.

    Warns:
        ModelWarning: as for `load_mjcf_arms`.

    Raises:
        SceneError: as for `load_mjcf`; or the base is fixed and no joint moves two arms, the trunk branches, an arm has
            no joint of its own, a floating base has a mount, or the world is to float.
        ModelError, MissingExtra: as for `load_mjcf`.
    """
    source, model, unknown = compiled_mjcf(path_or_text)
    robot = MjcfRobot(source, model, held_joints(source, model, locked), lock_others, unknown)
    root = find_base(source, model, base)
    ends = _ends(robot, root, tips)
    paths = {name: bodies_between(source, model, root, body) for name, (body, _) in ends.items()}
    free = _free_body(robot, root, paths, floating)
    if free is not None and mount is not None:
        raise SceneError(f"{source}: mount: expected none, since the base floats: its pose is in the state")
    paths = {name: path[path.index(free) + 1 :] if free in path else path for name, path in paths.items()}
    moving = {name: robot.moving(path) for name, path in paths.items()}
    counts = _shared(robot, moving)
    if free is None and not any(counts.values()):
        raise SceneError(
            f"{source}: tips: expected a joint that moves two of the arms, got none beyond"
            f" '{body_name(model, root)}'; try load_mjcf_arms, or floating=True"
        )
    own = {name: _own_path(robot, path, set(moving[name][: counts[name]])) for name, path in paths.items()}
    longest = max(counts, key=lambda name: counts[name])
    groups, _ = along(robot, [body for body in paths[longest] if body not in own[longest]])
    bodies = [BodyGroup(None, [] if free is None else [(free, Pose.identity())]), *groups]
    elsewhere = {body for path in own.values() for body in path} | {b for group in groups for b, _ in group.bodies}
    for group in bodies:
        add_branches(robot, group, elsewhere)
    inside = {body for group in bodies for body, _ in group.bodies}
    stand = pose_in_world(robot, root) if mount is None else checks.pose(mount, "mount")
    trunk = _trunk(model, bodies, stand)
    arms, mounts = {}, {}
    together = [group for group in bodies if group.bodies]
    for name, path in own.items():
        k, (_, tip_frame) = counts[name], ends[name]
        on = bodies[k].pose_of(int(model.body_parentid[path[0]]))
        if on is None:  # in the world
            path, on = paths[name], stand
        else:
            mounts[name] = mount_name(trunk, k - 1) if k > 0 else BASE
        groups, tip = groups_along(robot, path)
        arms[name] = arm_of(robot, groups, tip @ tip_frame, on, name)
        together += groups
    joints = set[int]().union(*moving.values())
    apart = [{b for b, _ in group.bodies} for group in together]
    notes = (*unknown, *checked_couplings(Moving(robot, apart, joints, root if free is None else 0)))
    show_notes(notes)
    trunk = replace(trunk, notes=notes)
    return ArmsOnTrunk(trunk, arms, mounts, _locked(robot, inside.union(*paths.values()), joints), notes)


def _ends(robot: MjcfRobot, root: int, tips: Mapping[str, str] | Iterable[str]) -> dict[str, tuple[int, Pose]]:
    """Return the index of the body of each arm's tip, and the tip's pose in its frame."""
    source = robot.source
    if not checks.is_listed(tips) or not (given := [*tips]):
        raise SceneError(f"{source}: tips: expected sites or bodies by arm, such as {{'left': 'left_hand', ...}}")
    named = tips if isinstance(tips, Mapping) else {str(tip): tip for tip in given}
    return {name: find_tip(source, robot.model, root, tip) for name, tip in named.items()}


def _free_body(robot: MjcfRobot, root: int, paths: Mapping[str, list[int]], floating: bool) -> int | None:
    """Return the floating body, which has a free joint or is the base by request; None if no body floats.

    Raises:
        SceneError: the world is to float, or the arms are on several floating bodies.
    """
    source, model = robot.source, robot.model
    jointed = {next((b for b in path if joints_of(model, [b])), 0) for path in paths.values()}
    free = [b for b in sorted(jointed) if "free" in [joint_kind(model, j) for j in joints_of(model, [b])]]
    if len(free) > 1:
        names = " and ".join(f"'{body_name(model, b)}'" for b in free)
        raise SceneError(f"{source}: tips: expected arms on one body that floats, got {names}; try fewer tips")
    if free:
        return free[0]
    if floating and root == 0:
        raise SceneError(f"{source}: floating: expected a base that is a body, got the world; try base=")
    return root if floating else None


def _trunk(model: Any, bodies: list[BodyGroup], stand: Pose) -> Trunk:
    """Return the trunk of a floating body, if any, and of the bodies that joints move; else with a fixed base pose."""
    base, *groups = bodies
    free = link_of(model, base) if base.bodies else None
    joints = [group.joint for group in groups if group.joint is not None]
    return Trunk(joints, [link_of(model, group) for group in groups], stand if free is None else Pose.identity(), free)


def _shared(robot: MjcfRobot, moving: Mapping[str, list[int]]) -> dict[str, int]:
    """Return the number of joints that each arm shares with another arm.

    Raises:
        SceneError: an arm has no joint of its own, or the trunk branches.
    """
    source, model, counts = robot.source, robot.model, shared_counts(moving)
    for name, joints in moving.items():
        if counts[name] == len(joints):
            raise SceneError(f"{source}: arm '{name}': expected a joint that moves no other arm, got none")
    if (found := branching(moving, counts)) is not None:
        (aside, ahead), (some, others) = found
        raise SceneError(
            f"{source}: joint '{joint_name(model, aside)}' moves arms {', '.join(some)}, while"
            f" '{joint_name(model, ahead)}' moves arms {', '.join(others)}: expected shared joints in one row, got a"
            " trunk that branches; try holding one of the branches, or fewer tips"
        )
    return counts


def _own_path(robot: MjcfRobot, path: list[int], shared: set[int]) -> list[int]:
    """Return the bodies of a path from the first joint that moves only this arm."""
    first = next(k for k, body in enumerate(path) if set(robot.moving([body])) - shared)
    return path[first:]


def _locked(robot: MjcfRobot, bodies: set[int], moving: set[int]) -> dict[str, float]:
    """Return the positions of locked joints on some bodies and their descendants, by name."""
    model, found = robot.model, {}
    within = set(bodies)
    for body in range(1, model.nbody):  # parents come before their children
        if int(model.body_parentid[body]) in within:
            within.add(body)
        if body in within:
            held = [j for j in joints_of(model, [body]) if j not in moving and joint_kind(model, j) in MJCF_KINDS]
            for j in held:
                found[joint_name(model, j)] = robot.held.get(j, float(model.qpos0[model.jnt_qposadr[j]]))
    return found
