"""Arms with branches from MJCF: fingers, ball joints, and equalities as loops and couplings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.errors import SceneError
from holdfast.interop.mjcf_bodies import MjcfRobot, link_of, pose_in_world, tree_of
from holdfast.interop.mjcf_couplings import STANDING, Moving, binds, checked_couplings
from holdfast.interop.mjcf_model import is_disabled, mujoco_module
from holdfast.interop.mjcf_tree import body_name, joint_name
from holdfast.model.arm import Arm
from holdfast.model.closure import Closure
from holdfast.model.coupling import Coupling
from holdfast.model.grasp import Grasp
from holdfast.model.grasp_kinds import GRASP_KINDS, GraspKind
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


def _freest_last(item: tuple[str, GraspKind]) -> tuple[int, bool]:
    return len(item[1].free), item[1].friction is None


# the kind of grasp that an equality stands for: a connect is a ball, not a soft finger, and a weld rigid, not a sole
GRASP_OF: dict[str | None, Any] = {
    row.equality: kind for kind, row in sorted(GRASP_KINDS.items(), key=_freest_last) if row.equality
}


def arm_with_branches(robot: MjcfRobot, start: int, path: list[int], tip_frame: Pose, base: Pose, name: str) -> Arm:
    """Return the arm along a path with everything that hangs on it; without a path all that hangs on the base.

    Args:
        robot: the model.
        start: index of the base body.
        path: indices of the bodies from the base to the tip.
        tip_frame: pose of the tip in the frame of the last of them.
        base: pose of the base body in the world.
        name: name of the arm.

    Raises:
        SceneError: there is no joint that moves, or some of what couples the arm's bodies cannot be read; the message
            names all of it.
    """
    model = robot.model
    groups, tip = tree_of(robot, start, path)
    if not groups:
        raise SceneError(f"{robot.source}: expected a joint beyond the base, got none that moves")
    joints = [group.joint for group in groups if group.joint is not None]
    inside = [{b for b, _ in group.bodies} for group in groups]
    names = {joint.name for joint in joints}
    moving = Moving(robot, inside, {j for j in range(model.njnt) if joint_name(model, j) in names}, start)
    read, faults = dict[int, Closure | Coupling](), list[str]()
    for e in (e for e in range(model.neq) if binds(moving, e) and _is_active(moving, e)):
        try:
            read[e] = _equality(moving, e)
        except SceneError as fault:
            faults.append(str(fault))
    if faults:
        raise SceneError("; ".join(faults))
    notes = (*robot.notes, *checked_couplings(moving, read))
    frames = {body_name(model, b): (k, at) for k, group in enumerate(groups) for b, at in group.bodies}
    places = {b: (k, at) for k, group in enumerate(groups) for b, at in group.bodies}
    for s in range(model.nsite):
        if model.site(s).name and int(model.site_bodyid[s]) in places:
            k, at = places[int(model.site_bodyid[s])]
            frames.setdefault(model.site(s).name, (k, at @ _site(model, s)))
    arm = Arm(
        joints,
        [link_of(model, group) for group in groups],
        base=base,
        name=name,
        notes=notes,
        parents=[group.parent for group in groups],
        frames=frames,
        couplings=[one for one in read.values() if isinstance(one, Coupling)],
        loops={_name(model, e): one for e, one in read.items() if isinstance(one, Closure)},
    )
    return arm if arm.parents or not path else arm.with_tip(tip @ tip_frame)


def _is_active(moving: Moving, e: int) -> bool:
    model = moving.robot.model
    return bool(model.eq_active0[e]) and not is_disabled(model, "EQUALITY")


def _name(model: Any, e: int) -> str:
    return model.equality(e).name or f"equality {e}"


def _site(model: Any, s: int) -> Pose:
    return Pose.from_wxyz_xyz(np.r_[model.site_quat[s], model.site_pos[s]])


def _equality(moving: Moving, e: int) -> Closure | Coupling:
    """Return an equality as a closure or a coupling.

    Raises:
        SceneError: it is none, or acts between an arm and what moves beside it.
    """
    model, mujoco = moving.robot.model, mujoco_module()
    kind = mujoco.mjtEq(int(model.eq_type[e])).name.removeprefix("mjEQ_").lower()
    lengths = {"joint": _of_joint, "tendon": _of_tendon}.get(kind)
    if lengths is not None:
        return _coupling(moving, e, [lengths(moving, e, int(one)) for one in (model.eq_obj1id[e], model.eq_obj2id[e])])
    if kind not in GRASP_OF:
        raise _refused(moving, e, f"expected a connect, weld, joint or tendon equality, got {kind}")
    return _closure(moving, e, GRASP_OF[kind])


def _refused(moving: Moving, e: int, why: str) -> SceneError:
    robot = moving.robot
    return SceneError(
        f"{robot.source}: '{_name(robot.model, e)}': {why}; try locking the joints that it couples (locked=)"
    )


@np.errstate(all="ignore")  # what overflows is refused
def _coupling(moving: Moving, e: int, sides: list[tuple[Mapping[str, float], float]]) -> Coupling:
    """Return x - x0 = c0 + c1 (y - y0) of lengths x and y, each a sum of joints with its value at the reference."""
    degree = moving.robot.model.eq_data[e][:5]
    if np.any(degree[2:]):
        raise _refused(moving, e, f"polycoef: expected the first degree, got {' '.join(f'{c:g}' for c in degree)}")
    (x, x0), (y, y0) = sides
    terms = dict(x)
    for name, c in y.items():
        terms[name] = terms.get(name, 0.0) - float(degree[1]) * c
    return Coupling({name: c for name, c in terms.items() if c}, float(x0 + degree[0] - degree[1] * y0))


def _of_joint(moving: Moving, e: int, j: int) -> tuple[dict[str, float], float]:
    """Return a joint's position as a sum, and its value at the reference; nothing without a joint."""
    model = moving.robot.model
    if j < 0:
        return {}, 0.0
    if j not in moving.joints:
        raise _refused(moving, e, f"expected joints of the arm that move, got '{joint_name(model, j)}'")
    return {joint_name(model, j): 1.0}, float(model.qpos0[model.jnt_qposadr[j]])


def _of_tendon(moving: Moving, e: int, t: int) -> tuple[dict[str, float], float]:
    """Return the length of a fixed tendon as a sum of joints, and its value at the reference; nothing without one."""
    model, terms, rest = moving.robot.model, dict[str, float](), 0.0
    if t < 0:
        return terms, rest
    for w in range(int(model.tendon_adr[t]), int(model.tendon_adr[t] + model.tendon_num[t])):
        if mujoco_module().mjtWrap(int(model.wrap_type[w])).name != "mjWRAP_JOINT":
            raise _refused(moving, e, f"expected a fixed tendon, got '{model.tendon(t).name}', which runs over sites")
        (joint,), own = _of_joint(moving, e, int(model.wrap_objid[w]))
        terms[joint] = terms.get(joint, 0.0) + float(model.wrap_prm[w])
        rest += float(model.wrap_prm[w]) * own
    return terms, rest


def _closure(moving: Moving, e: int, kind: Any) -> Closure:
    """Return a connect or a weld: the frame on the second body coincides with one on the first."""
    model, data = moving.robot.model, np.array(moving.robot.model.eq_data[e])
    pair = [int(model.eq_obj1id[e]), int(model.eq_obj2id[e])]
    if mujoco_module().mjtObj(int(model.eq_objtype[e])).name == "mjOBJ_SITE":
        bodies, frames = [int(model.site_bodyid[s]) for s in pair], [_site(model, s) for s in pair]
    else:
        bodies, frames = pair, _frames(data, turned=bool(GRASP_KINDS[kind].closed_angles))
    ends = [(_end(moving, e, body), at) for body, at in zip(bodies, frames, strict=True)]
    if ends[1][0] is None:  # only the first end may be the base
        ends.reverse()
    (a, tip), (b, frame) = ends
    if a is None:
        stands = bodies[0] if ends[0][1] is frames[0] else bodies[1]
        tip = pose_in_world(moving.robot, moving.base).inverse() @ pose_in_world(moving.robot, stands) @ tip
    return Closure(a, b, Grasp(kind, frame), tip)


def _frames(data: Array, *, turned: bool) -> list[Pose]:
    """Return the frames on both bodies: of a connect its two anchors, of a weld the relative pose and the anchor."""
    if not turned:
        return [Pose.translation(*data[0:3]), Pose.translation(*data[3:6])]
    return [Pose.from_wxyz_xyz(np.r_[data[6:10] / np.linalg.norm(data[6:10]), data[3:6]]), Pose.translation(*data[0:3])]


def _end(moving: Moving, e: int, body: int) -> str | None:
    """Return the name of a body of the arm; None for one that stands with the base."""
    place = moving.place(body)
    if place == STANDING:
        return None
    if place < 0:
        raise _refused(moving, e, f"expected bodies of the arm, got '{body_name(moving.robot.model, body)}'")
    return body_name(moving.robot.model, body)
