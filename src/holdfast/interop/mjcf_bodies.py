"""Grouping the bodies of a compiled MuJoCo model by the joint that moves them; each group becomes one link."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import SceneError
from holdfast.interop.mjcf_model import is_disabled
from holdfast.interop.mjcf_tree import body_name, drives_of, joint_kind, joint_name, joints_of, require_plain
from holdfast.interop.mjcf_writer import ENDLESS
from holdfast.model import checks
from holdfast.model.joint import UNBOUNDED, Joint
from holdfast.model.joint_types import JOINT_TYPES
from holdfast.model.link import Link
from holdfast.spatial import rotation
from holdfast.spatial.inertia import turned, welded
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import product

# kinds of joints by MJCF type: those with one degree of freedom, and those that only arms with branches may have
MJCF_KINDS: dict[str, Any] = {row.mjcf: kind for kind, row in JOINT_TYPES.items() if row.mjcf and not row.quaternion}
MJCF_BALLS: dict[str, Any] = {row.mjcf: kind for kind, row in JOINT_TYPES.items() if row.mjcf and row.quaternion}


class MjcfRobot(NamedTuple):
    """A compiled model with some locked joints.

    Attributes:
        source: name of the model, for messages.
        model: MuJoCo's `MjModel`.
        held: positions of the locked joints [rad or m], by joint index.
        lock_others: whether joints that are on no path are locked at their positions in the model.
        notes: notes on elements that are unknown.
    """

    source: str
    model: Any
    held: Mapping[int, float]
    lock_others: bool
    notes: tuple[str, ...] = ()

    def moving(self, bodies: Iterable[int]) -> list[int]:
        """Return the indices of the joints of some bodies that are not locked, in their order."""
        return [j for j in joints_of(self.model, bodies) if j not in self.held]


@dataclass(eq=False)
class BodyGroup:
    """Bodies that move together; the group is filled while the tree is traversed.

    Attributes:
        joint: the joint that moves them; None for bodies that float or are fixed in the world.
        bodies: index and pose of each body, in the joint's frame, or without a joint in the frame of the first body.
        parent: index of the group on which the joint is; None for the base.
    """

    joint: Joint | None
    bodies: list[tuple[int, Pose]] = field(default_factory=list)
    parent: int | None = None

    def pose_of(self, body: int) -> Pose | None:
        """Return the pose of a body; None if it is not of this group."""
        return next((at for b, at in self.bodies if b == body), None)


def held_joints(source: str, model: Any, locked: Mapping[str, float] | None) -> dict[int, float]:
    """Return the positions of locked joints, by joint index.

    Raises:
        SceneError: a joint does not exist or cannot be locked, or a position is not a number.
    """
    checks.instance(locked, (Mapping, type(None)), f"{source}: locked", SceneError)
    names = {joint_name(model, j): j for j in range(model.njnt)}
    held = {}
    for name, position in (locked or {}).items():
        if name not in names:
            raise SceneError(f"{source}: locked: no joint '{name}'.{checks.did_you_mean(str(name), names)}")
        _require_one_freedom(source, model, names[name])
        held[names[name]] = float(checks.numbers(position, (), f"{source}: locked: {name}", SceneError))
    return held


def along(robot: MjcfRobot, path: list[int], *, balls: bool = False) -> tuple[list[BodyGroup], Pose]:
    """Return the body groups along a path, without side branches, and the last body's pose in the last group.

    Args:
        robot: the model.
        path: indices of the bodies, base outward.
        balls: whether ball joints are read.

    Raises:
        SceneError: a joint has a type that an arm cannot have.
    """
    at, on, groups = Pose.identity(), None, list[BodyGroup]()
    for body in path:
        on, at = _add(robot, body, at, on, groups, balls=balls)
    return groups, at


def tree_of(robot: MjcfRobot, start: int, path: list[int]) -> tuple[list[BodyGroup], Pose]:
    """Return the body groups along a path and all that hang on them by joints that move; without a path on the base.

    Raises:
        SceneError: a joint has a type that an arm cannot have.
    """
    groups, tip = along(robot, path, balls=True)
    waiting: list[tuple[int | None, int, Pose]] = [(k, *one) for k, group in enumerate(groups) for one in group.bodies]
    waiting += [] if path else [(None, start, Pose.identity())]
    for on, parent, at in waiting:  # the loop appends to this list
        for body in np.flatnonzero(robot.model.body_parentid == parent).tolist():
            if body not in (0, *path):
                group, there = _add(robot, body, at, on, groups, balls=True)
                waiting.append((group, body, there))
    return groups, tip


def _add(
    robot: MjcfRobot, body: int, at: Pose, on: int | None, groups: list[BodyGroup], *, balls: bool
) -> tuple[int | None, Pose]:
    """Add a body, and a group for each of its joints that moves; return its group and its pose there.

    Args:
        robot: the model.
        body: the body.
        at: pose of its parent in the group `on`, or in the base's frame.
        on: index of the parent's group; None for the base.
        groups: the groups.
        balls: whether ball joints are read.
    """
    model, at = robot.model, at @ _placed(robot.model, body)
    for j in joints_of(model, [body]):
        if j in robot.held:
            at = at @ _turned(model, j, robot.held[j])
            continue
        if not (balls and joint_kind(model, j) in MJCF_BALLS):
            _require_one_freedom(robot.source, model, j)
        require_plain(robot.source, model, j)
        anchor = Pose.translation(*model.jnt_pos[j])
        reference = _turned(model, j, 0.0)  # the body is given at the reference position, our frame at q = 0
        groups.append(BodyGroup(_joint(model, j, at @ reference @ anchor), parent=on))
        on, at = len(groups) - 1, anchor.inverse()
    if on is not None:
        groups[on].bodies.append((body, at))
    return on, at


def add_branches(robot: MjcfRobot, group: BodyGroup, elsewhere: Container[int]) -> None:
    """Add to a group its descendants, except for the bodies in `elsewhere` and their descendants.

    Raises:
        SceneError: a joint in a side branch is not locked.
    """
    model, waiting = robot.model, list(group.bodies)
    while waiting:
        parent, at = waiting.pop()
        for body in np.flatnonzero(model.body_parentid == parent).tolist():
            if body in elsewhere or body == 0:
                continue
            there = at @ _placed(model, body)
            for j in joints_of(model, [body]):
                if j in robot.held:
                    there = there @ _turned(model, j, robot.held[j])
                elif not robot.lock_others:
                    raise SceneError(
                        f"{robot.source}: joint '{joint_name(model, j)}' hangs on the arm and is on no way to the tip;"
                        f" expected it to be held, try locked={{'{joint_name(model, j)}': 0.0}} or lock_others=True"
                    )
            group.bodies.append((body, there))
            waiting.append((body, there))


@np.errstate(all="ignore")  # what overflows is refused
def link_of(model: Any, group: BodyGroup) -> Link:
    """Return the bodies of a group as one link."""
    parts: list[tuple[float, Array, Array]] = []
    for body, at in group.bodies:
        own = at @ Pose.from_wxyz_xyz(np.r_[model.body_iquat[body], model.body_ipos[body]])
        parts.append((float(model.body_mass[body]), own.p, turned(np.diag(model.body_inertia[body]), own.R)))
    name = body_name(model, group.bodies[0][0]) if group.bodies else ""
    if not any(mass for mass, _, _ in parts):
        return Link(0.0, name=name)
    mass, com, inertia = welded(parts)
    return Link(mass, com, 0.5 * (inertia + inertia.T), name=name)


def pose_in_world(robot: MjcfRobot, body: int) -> Pose:
    """Return the pose of a body in the world, with joints that are not locked at their positions in the model."""
    model, pose = robot.model, Pose.identity()
    while body:
        at = _placed(model, body)
        for j in joints_of(model, [body]):
            at = at @ _turned(model, j, robot.held[j]) if j in robot.held else at
        pose = at @ pose
        body = int(model.body_parentid[body])
    return pose


def _placed(model: Any, body: int) -> Pose:
    """Return the pose of a body in its parent's frame, in the model's reference configuration."""
    return Pose.from_wxyz_xyz(np.r_[model.body_quat[body], model.body_pos[body]])


def _turned(model: Any, j: int, q: float) -> Pose:
    """Return the displacement of a body by its joint at q, body axes: a rotation about the anchor or a shift."""
    if joint_kind(model, j) in MJCF_BALLS:
        return Pose.identity()  # at the reference, where its quaternion is one
    axis, travel = model.jnt_axis[j], q - model.qpos0[model.jnt_qposadr[j]]
    if not JOINT_TYPES[MJCF_KINDS[joint_kind(model, j)]].turns:
        return Pose(np.eye(3), travel * axis)
    R, anchor = rotation.exp(travel * axis), model.jnt_pos[j]
    return Pose(R, anchor - product(R, anchor))


def _joint(model: Any, j: int, placement: Pose) -> Joint:
    dof = model.jnt_dofadr[j]

    def unless(flag: str, value: float) -> float:
        return 0.0 if is_disabled(model, flag) else float(value)

    limits, kind = UNBOUNDED, joint_kind(model, j)
    if model.jnt_limited[j]:
        low, high = model.jnt_range[j].tolist()
        limits = (-np.inf if low <= -ENDLESS else low, np.inf if high >= ENDLESS else high)
    return Joint(
        {**MJCF_KINDS, **MJCF_BALLS}[kind],
        np.array(model.jnt_axis[j]),
        placement,
        name=joint_name(model, j),
        position_limits=limits,
        effort_limit=_effort_limit(model, j),
        armature=float(model.dof_armature[dof]),
        damping=unless("DAMPER", model.dof_damping[dof]),
        friction=unless("FRICTIONLOSS", model.dof_frictionloss[dof]),
        stiffness=unless("SPRING", model.jnt_stiffness[j]),
        rest=float(model.qpos_spring[model.jnt_qposadr[j]]),
    )


def _effort_limit(model: Any, j: int) -> float:
    """Return the largest effort in either direction [N m or N]."""
    if model.jnt_actfrclimited[j]:
        return float(np.abs(model.jnt_actfrcrange[j]).min()) or np.inf
    drives = drives_of(model, j)
    if len(drives) == 1 and model.actuator_forcelimited[drives[0]]:
        gear = abs(float(model.actuator_gear[drives[0], 0]))
        return gear * float(np.abs(model.actuator_forcerange[drives[0]]).min()) or np.inf
    return np.inf


def _require_one_freedom(source: str, model: Any, j: int) -> None:
    kind = joint_kind(model, j)
    if kind not in MJCF_KINDS:
        raise SceneError(
            f"{source}: joint '{joint_name(model, j)}': expected a hinge or a slide, got a {kind} joint; try a base"
            " beyond it"
        )
