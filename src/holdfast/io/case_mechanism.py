"""The chain and the state of a problem case, whatever it asks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.io import case_data, typed
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.trunk import BASE, Trunk
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


class CaseChain(NamedTuple):
    """A chain at a state.

    Attributes:
        chain: arms ('arm1', 'arm2', ..., or as they are named), object and grasps.
        state: positions and velocities.
        inputs: base motion and external wrenches.
        rates: relative rates W in the file, flat; None if it gives none.
    """

    chain: ClosedChain
    state: State
    inputs: Inputs
    rates: Array | None


class CaseChainData(Protocol):
    """What the data of every case have in common."""

    @property
    def gravity(self) -> list[float]:
        """Acceleration of a falling body."""
        ...

    @property
    def object(self) -> case_data.CaseObject:
        """The held object."""
        ...

    @property
    def arms(self) -> Sequence[Any]:
        """The arms."""
        ...

    @property
    def trunk(self) -> case_data.CaseTrunkMechanism | None:
        """The trunk."""
        ...

    @property
    def tags(self) -> Any:
        """Notes."""
        ...


def mechanism(data: CaseChainData, at: Location, grasp_of: Callable[[Any, Location], Grasp]) -> CaseChain:
    """Return the chain and the state of a case.

    The format gives no attitude to a tip: each tip frame is taken to agree with its contact frame at the case's state.

    Args:
        data: the case.
        at: its place in the file.
        grasp_of: function of a grasp's data and place that returns the grasp.

    Raises:
        SceneError: it is invalid; the message gives the JSON path of the first fault.
    """
    if not data.arms:
        raise (at / "arms").refuse("expected at least one arm, got none")
    arms, grasps, mounts = {}, {}, {}
    drives = _drives(data, at)
    trunk = None if data.trunk is None else _trunk(data.trunk, at / "trunk")
    for i, arm in enumerate(data.arms):
        name = arm.name or f"arm{i + 1}"
        if name in arms:
            raise (at / "arms" / i / "name").refuse(f"expected another name than {name!r}, which an arm before has")
        arms[name] = _arm(arm, at / "arms" / i, drives[i])
        if arm.grasp is not None:
            grasps[name] = grasp_of(arm.grasp, at / "arms" / i / "grasp")
        if arm.parent is not None:
            mounts[name] = _mount(arm.parent, trunk, at / "arms" / i / "parent")
    body = data.object
    with (at / "object").refusals():
        frame = Pose(checks.rotation_matrix(body.R, "object: R"), checks.numbers(body.p, (3,), "object: p"))
        held = HeldObject(body.mass, np.array(body.inertia), np.array(body.com))
    parts = [*([] if data.trunk is None else [data.trunk]), *data.arms]
    with at.refusals():
        chain = ClosedChain(arms, held, grasps, np.array(data.gravity), trunk, mounts)
        q, qd = (np.concatenate([getattr(part, key) for part in parts]) for key in ("q", "qd"))
        state = State(q, qd, frame.wxyz_xyz, np.array([*body.omega, *body.v]), *_floating(data.trunk, at / "trunk"))
        inputs = _inputs(data, at)
        inputs.shaped(chain)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs.shaped(chain))
    with at.refusals():
        chain = _with_tip_attitudes(motion)
    rates = None
    given = [arm.grasp.W for arm in data.arms if arm.grasp is not None]
    if any(given):  # a W left out is the one the velocities imply
        rates = np.concatenate([c.W if W is None else W for W, c in zip(given, motion.contacts, strict=True)])
    return CaseChain(chain, state, inputs, rates)


def _arm(data: case_data.CaseMechanism, at: Location, drives: dict[str, list[float]]) -> Arm:
    """Return an arm; `drives` holds what the tags say of its joints."""
    joints = [_joint(joint, at / "joints" / k) for k, joint in enumerate(data.joints)]
    for key, values in drives.items():
        joints = [replace(joint, **{key: value}) for joint, value in zip(joints, values, strict=True)]
    links = [_link(link, at / "links" / k) for k, link in enumerate(data.links)]
    if not joints:
        raise (at / "joints").refuse("expected at least one joint, got none")
    _require_lengths(data, ("links", "q", "qd", "tau"), len(joints), at)
    with at.refusals():
        return Arm(joints, links, Pose(np.eye(3), np.array(data.tip)), _pose(data.base, "base", at))


def _joint(data: case_data.CaseJoint, at: Location) -> Joint:
    with at.refusals():
        placement = Pose(checks.rotation_matrix(data.R0, "joint: R0"), np.array(data.p0))
        found = Joint(data.type, np.array(data.axis), placement, armature=data.armature, damping=data.damping)
        return found if data.effort is None else replace(found, effort_limit=data.effort)


def _link(data: case_data.CaseLink, at: Location) -> Link:
    with at.refusals():
        return Link(data.mass, np.array(data.com), np.array(data.inertia))


def _pose(data: Any, key: str, at: Location) -> Pose:
    with (at / key).refusals():
        return Pose(checks.rotation_matrix(data.R, f"{key}: R"), np.array(data.p))


def _require_lengths(
    data: case_data.CaseMechanism | case_data.CaseTrunkMechanism, keys: tuple[str, ...], count: int, at: Location
) -> None:
    for key in keys:
        if hasattr(data, key) and len(getattr(data, key)) != count:
            raise (at / key).refuse(f"expected {count} entries, one per joint, got {len(getattr(data, key))}")


def _floats(data: case_data.CaseTrunkMechanism) -> bool:
    """Return whether a trunk begins with a floating joint."""
    return bool(data.joints) and isinstance(data.joints[0], dict) and data.joints[0].get("type") == "floating"


def _trunk(data: case_data.CaseTrunkMechanism, at: Location) -> Trunk:
    """Return the trunk; a floating joint's link is its first."""
    floats = _floats(data)
    if floats:
        typed.convert(data.joints[0], case_data.CaseFloating, at.source, (at / "joints" / 0).path)
    joints = []
    for k, joint in enumerate(data.joints):
        if k or not floats:
            where = at / "joints" / k
            joints.append(_joint(typed.convert(joint, case_data.CaseJoint, where.source, where.path), where))
    links = [_link(link, at / "links" / k) for k, link in enumerate(data.links)]
    if len(links) != len(data.joints):
        raise (at / "links").refuse(f"expected {len(data.joints)} entries, one per joint, got {len(links)}")
    _require_lengths(data, ("q", "qd", "tau"), len(joints), at)
    for key, wanted in (("base", not floats), ("pose", floats), ("twist", floats)):
        if (getattr(data, key) is not None) != wanted:
            verb = "expected it" if wanted else "expected none"
            raise (at / key).refuse(f"{verb}, as the trunk's base is {'floating' if floats else 'in the world'}")
    with at.refusals():
        if floats:
            return Trunk(joints, links[1:], floating=links[0])
        return Trunk(joints, links, _pose(data.base, "base", at))


def _floating(data: case_data.CaseTrunkMechanism | None, at: Location) -> tuple[Array | None, Array | None]:
    """Return pose and twist of a floating base, None without one."""
    if data is None or data.pose is None or data.twist is None:
        return None, None
    return _pose(data.pose, "pose", at).wxyz_xyz, np.array([*data.twist.omega, *data.twist.v])


def _mount(parent: int, trunk: Trunk | None, at: Location) -> int | str:
    """Return where an arm stands, as `ClosedChain.mounts` says it, from an index of the trunk's links in the file."""
    bodies = 0 if trunk is None else len(trunk.bodies)
    if not 0 <= parent < bodies:
        listed = f"0 .. {bodies - 1}, or null" if bodies else "null, as there is no trunk"
        raise at.refuse(f"expected an index of the trunk's links, {listed}, got {parent}")
    assert trunk is not None
    first = bodies - len(trunk.links)
    return BASE if parent < first else parent - first


def _inputs(data: CaseChainData, at: Location) -> Inputs:
    """Return base motion and external wrenches."""
    wrench = data.object.wrench
    if isinstance(data.tags, dict) and "object_wrench" in data.tags:
        wrench = typed.convert(data.tags["object_wrench"], list[float], at.source, (at / "tags" / "object_wrench").path)
    of_arms = [link.wrench for arm in data.arms for link in arm.links]
    trunk: dict[str, Any] = {}
    if data.trunk is not None:
        trunk = {"trunk_link_wrenches": _wrenches([link.wrench for link in data.trunk.links])}
        if data.trunk.base is not None:
            base = data.trunk.base
            trunk["trunk_base_twist"] = np.array([*base.omega, *base.v])
            trunk["trunk_base_acceleration"] = np.array([*base.omega_dot, *base.v_dot])
    return Inputs(
        object_wrench=wrench,
        link_wrenches=_wrenches(of_arms) if any(of_arms) else None,
        base_twists=np.array([[*a.base.omega, *a.base.v] for a in data.arms]),
        base_accelerations=np.array([[*a.base.omega_dot, *a.base.v_dot] for a in data.arms]),
        **trunk,
    )


def _wrenches(given: list[list[float] | None]) -> Array:
    return np.array([[0.0] * 6 if one is None else one for one in given])


def _drives(data: CaseChainData, at: Location) -> list[dict[str, list[float]]]:
    """Return per arm what the tags say of its drives: `armature` and `damping`, per arm and joint."""
    found: list[dict[str, list[float]]] = [{} for _ in data.arms]
    for key in ("armature", "damping"):
        if not isinstance(data.tags, dict) or key not in data.tags:
            continue
        where = at / "tags" / key
        given = typed.convert(data.tags[key], list[list[float]], where.source, where.path)
        counts = [len(arm.joints) for arm in data.arms]
        if [len(part) for part in given] != counts:
            raise where.refuse(f"expected a list per arm of {counts} numbers, got {[len(part) for part in given]}")
        for own, values in zip(found, given, strict=True):
            own[key] = values
    return found


def _with_tip_attitudes(motion: ChainMotion) -> ClosedChain:
    """Return the chain with every tip frame turned to its contact frame."""
    arms, given = {}, motion.chain.arms
    for name, c in zip(motion.chain.grasps, motion.contacts, strict=True):
        arms[name] = given[name].with_tip(Pose(motion.arms[name].at.end.T @ c.frame, given[name].tip.p))
    return replace(motion.chain, arms={**given, **arms})
