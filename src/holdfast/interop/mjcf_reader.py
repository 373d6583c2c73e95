"""Loading arms from MJCF with MuJoCo's own compiler, which resolves defaults, includes and geoms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from typing import Any

from holdfast.errors import SceneError
from holdfast.interop.mjcf_bodies import (
    BodyGroup,
    MjcfRobot,
    add_branches,
    along,
    held_joints,
    link_of,
    pose_in_world,
)
from holdfast.interop.mjcf_couplings import Moving, checked_couplings
from holdfast.interop.mjcf_model import compiled_mjcf
from holdfast.interop.mjcf_tree import (
    bodies_between,
    body_name,
    find_base,
    find_tip,
    joint_name,
)
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.robots.notes import show_notes
from holdfast.spatial.pose import Pose


def load_mjcf(
    path_or_text: str | PathLike[str],
    *,
    base: str | None = None,
    tip: str | None = None,
    locked: Mapping[str, float] | None = None,
    lock_others: bool = False,
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
    end, tip_frame = find_tip(source, model, start, tip)
    path = bodies_between(source, model, start, end)
    at = pose_in_world(robot, start) if mount is None else checks.pose(mount, "mount")
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
