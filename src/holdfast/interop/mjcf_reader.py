"""Arms from MJCF, by way of MuJoCo's own compiler: defaults, includes and geoms become what MuJoCo makes of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np

from holdfast.errors import SceneError
from holdfast.interop.mjcf_model import compiled_mjcf
from holdfast.interop.mjcf_tree import (
    bodies_between,
    body_name,
    drives_of,
    find_base,
    find_tip,
    joint_kind,
    joint_name,
    joints_of,
    require_plain,
    require_serial,
)
from holdfast.interop.mjcf_writer import ENDLESS
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.joint import UNBOUNDED, Joint
from holdfast.model.joint_types import JOINT_TYPES
from holdfast.model.link import Link
from holdfast.robots.urdf.bodies import welded
from holdfast.spatial import rotation
from holdfast.spatial.inertia import turned
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import product

KINDS: dict[str, Any] = {row.mjcf: kind for kind, row in JOINT_TYPES.items() if row.mjcf}  # of joints, by MJCF type


@dataclass(eq=False)
class _Moved:
    """Bodies that one joint moves as one, growing while the tree is walked.

    Attributes:
        joint: the joint.
        bodies: number and pose in the joint's frame of each.
    """

    joint: Joint
    bodies: list[tuple[int, Pose]] = field(default_factory=list)


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

    Bodies that are fixed to one another become one. What hangs on the base does not matter
    and is left out; what hangs on the arm belongs to it, so joints off the path from base to
    tip (fingers, another arm) must be held. Several joints in one body get massless links
    between them.

    Hinges and slides keep axis, range, damping, spring, armature and friction loss; the effort limit
    is the joint's `actuatorfrcrange`, or else the force range of its one actuator times the
    gear, the smaller side of each. MJCF has no rate limits. What belongs to the scene is not
    read: gravity, contacts, actuators and what they do, equalities with bodies that are not of
    the arm.

    Args:
        path_or_text: a file, or the text itself (it begins with `<`).
        base: name of the body that stands still; default: the world.
        tip: name of the site or body whose frame is the tip; default: the only end body.
        locked: positions to hold joints at [rad or m], by name.
        lock_others: hold every joint that hangs on the arm where the model has it.
        mount: pose of the base body in the world (a Pose or wxyz_xyz); default: where the model
            has it.

    Raises:
        SceneError: what MuJoCo refuses; free and ball joints on the path, springs, gravity
            compensation, couplings and loops within the arm, by name.
        ModelError: a mount that is no pose.
        MissingExtra: MuJoCo is not installed.
    """
    source, model = compiled_mjcf(path_or_text)
    start = find_base(source, model, base)
    end, tip_frame = find_tip(source, model, start, tip)
    path = bodies_between(source, model, start, end)
    held = _held(source, model, locked)
    moved, tip_pose = _along(source, model, path, held)
    if not moved:
        raise SceneError(f"{source}: expected a joint between base and tip, got none that moves")
    for group in moved:
        _add_branches(source, model, group, set(path), held, lock_others)
    bodies = {body for group in moved for body, _ in group.bodies}
    require_serial(source, model, bodies, set(joints_of(model, path)) - set(held))
    links = [_link(model, group) for group in moved]
    at = _world_pose(model, start) if mount is None else checks.pose(mount, "mount")
    name = base or body_name(model, path[0])
    return Arm([group.joint for group in moved], links, tip_pose @ tip_frame, at, name=name)


def _held(source: str, model: Any, locked: Mapping[str, float] | None) -> dict[int, float]:
    """Return the positions to hold joints at, by the joint's number."""
    names = {joint_name(model, j): j for j in range(model.njnt)}
    held = {}
    for name, position in (locked or {}).items():
        if name not in names:
            raise SceneError(f"{source}: locked: no joint '{name}'.{checks.did_you_mean(str(name), names)}")
        _require_one_freedom(source, model, names[name])
        held[names[name]] = float(checks.numbers(position, (), f"{source}: locked: {name}", SceneError))
    return held


def _along(source: str, model: Any, path: list[int], held: Mapping[int, float]) -> tuple[list[_Moved], Pose]:
    """Return what each joint on the path moves, without side branches, and the last body's pose in the last link."""
    at, moved = Pose.identity(), []
    for body in path:
        at = at @ Pose.from_wxyz_xyz(np.r_[model.body_quat[body], model.body_pos[body]])
        for j in joints_of(model, [body]):
            if j in held:
                at = at @ _turned(model, j, held[j])
                continue
            _require_one_freedom(source, model, j)
            require_plain(source, model, j)
            anchor = Pose.translation(*model.jnt_pos[j])
            reference = _turned(model, j, 0.0)  # q counts from 0, the body stands at its reference
            moved.append(_Moved(_joint(model, j, at @ reference @ anchor)))
            at = anchor.inverse()
        if moved:
            moved[-1].bodies.append((body, at))
    return moved, at


def _turned(model: Any, j: int, q: float) -> Pose:
    """Return what a joint at position q does to its body, in body axes: a turn about its anchor, or a shift."""
    axis, travel = model.jnt_axis[j], q - model.qpos0[model.jnt_qposadr[j]]
    if _slides(model, j):
        return Pose(np.eye(3), travel * axis)
    R, anchor = rotation.exp(travel * axis), model.jnt_pos[j]
    return Pose(R, anchor - product(R, anchor))


def _slides(model: Any, j: int) -> bool:
    return not JOINT_TYPES[KINDS[joint_kind(model, j)]].turns


def _joint(model: Any, j: int, placement: Pose) -> Joint:
    dof = model.jnt_dofadr[j]
    limits = UNBOUNDED
    if model.jnt_limited[j]:
        low, high = model.jnt_range[j].tolist()
        limits = (-np.inf if low <= -ENDLESS else low, np.inf if high >= ENDLESS else high)
    return Joint(
        KINDS[joint_kind(model, j)],
        np.array(model.jnt_axis[j]),
        placement,
        name=joint_name(model, j),
        position_limits=limits,
        effort_limit=_effort_limit(model, j),
        armature=float(model.dof_armature[dof]),
        damping=float(model.dof_damping[dof]),
        friction=float(model.dof_frictionloss[dof]),
        stiffness=float(model.jnt_stiffness[j]),
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


def _add_branches(
    source: str, model: Any, group: _Moved, path: set[int], held: Mapping[int, float], lock_others: bool
) -> None:
    """Add to a group the bodies that hang on it off the path.

    Raises:
        SceneError: a joint there that is not held.
    """
    waiting = list(group.bodies)
    while waiting:
        parent, at = waiting.pop()
        for body in np.flatnonzero(model.body_parentid == parent).tolist():
            if body in path or body == 0:
                continue
            there = at @ Pose.from_wxyz_xyz(np.r_[model.body_quat[body], model.body_pos[body]])
            for j in joints_of(model, [body]):
                if j in held:
                    there = there @ _turned(model, j, held[j])
                elif not lock_others:
                    raise SceneError(
                        f"{source}: joint '{joint_name(model, j)}' hangs on the arm and is on no way to the tip;"
                        f" expected it to be held, try locked={{'{joint_name(model, j)}': 0.0}} or lock_others=True"
                    )
            group.bodies.append((body, there))
            waiting.append((body, there))


def _link(model: Any, group: _Moved) -> Link:
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


def _require_one_freedom(source: str, model: Any, j: int) -> None:
    kind = joint_kind(model, j)
    if kind not in KINDS:
        raise SceneError(
            f"{source}: joint '{joint_name(model, j)}': expected a hinge or a slide, got a {kind} joint; try a base"
            " beyond it"
        )


def _world_pose(model: Any, body: int) -> Pose:
    """Return where a body stands in the model's reference posture."""
    pose = Pose.identity()
    while body:
        pose = Pose.from_wxyz_xyz(np.r_[model.body_quat[body], model.body_pos[body]]) @ pose
        body = int(model.body_parentid[body])
    return pose
