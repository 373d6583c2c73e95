"""Problem cases: closed-chain forward dynamics problems in JSON, with or without answers.

Arms list joints and links base to tip; matrices are row-major; SI units. `tags`, `debug`,
`oracle` and `see` are free-form, everything else is strict.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.errors import SceneError
from holdfast.io import typed
from holdfast.io.files import file_path
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp, GraspName
from holdfast.model.grasp_kinds import GRASP_KINDS
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import cross
from holdfast.state import Inputs, State

Vector3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
Matrix3 = Annotated[list[Vector3], msgspec.Meta(min_length=3, max_length=3)]


class _Strict(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Base of the file's structures."""


class BaseData(_Strict):
    """Pose and prescribed motion of an arm's base, world axes."""

    R: Matrix3
    p: Vector3
    omega: Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])
    v: Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])
    omega_dot: Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])
    v_dot: Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class JointData(_Strict):
    """A joint; its link's frame at q = 0 is (R0, p0) in the parent frame."""

    type: Literal["revolute", "prismatic"]
    axis: Vector3
    R0: Matrix3
    p0: Vector3


class LinkData(_Strict):
    """A link; inertia about the mass centre, link axes."""

    mass: float
    com: Vector3
    inertia: Matrix3


class GraspData(_Strict):
    """A grasp; point and free axes in object axes, W the relative rates."""

    type: GraspName
    point_object: Vector3
    h_object: list[Vector3] = []
    W: list[float] | None = None


class ArmData(_Strict):
    """An arm with its positions, rates and torques, base to tip."""

    base: BaseData
    joints: list[JointData]
    links: list[LinkData]
    tip: Vector3
    q: list[float]
    qd: list[float]
    tau: list[float]
    grasp: GraspData


class ObjectData(_Strict):
    """The object, its pose (R, p of point C) and velocity."""

    mass: float
    com: Vector3
    inertia: Matrix3
    R: Matrix3
    p: Vector3
    omega: Vector3
    v: Vector3


class ExpectedData(_Strict):
    """The answer: per arm, and alpha(C)."""

    qdd: list[list[float]]
    f: list[list[float]]
    alpha_C: list[float]
    W_dot: list[list[float]]


class CaseData(_Strict):
    """One problem."""

    name: str
    gravity: Vector3
    object: ObjectData
    arms: list[ArmData]
    expected: ExpectedData | None = None
    tags: Any = None
    debug: Any = None
    oracle: Any = None
    see: Any = None


class CaseFileData(_Strict):
    """A file of many problems."""

    cases: list[Any]
    format: str = ""
    version: Any = None
    units: Any = None
    see: Any = None


@dataclass(frozen=True, eq=False)
class Case:
    """A problem ready to solve.

    Attributes:
        name: its name.
        chain: arms ('arm1', 'arm2', ...), object and grasps.
        state: positions and velocities.
        tau: (n,) joint torques.
        inputs: base motion.
        rates: W as the file gives it, flat; None if it does not.
        expected: the answer, if the file has one.
    """

    name: str
    chain: ClosedChain
    state: State
    tau: Array
    inputs: Inputs
    rates: Array | None
    expected: ExpectedData | None


def load_cases(path: str | PathLike[str]) -> list[Case]:
    """Return the problems of a JSON file: one case, a list, or an object with `cases`.

    Args:
        path: the file.

    Raises:
        SceneError: unreadable or invalid, with the JSON path of the first fault.
    """
    file = file_path(path, "path", SceneError)
    source = str(file)
    data = typed.parse_json(typed.read_bytes(file), source)
    if isinstance(data, dict) and ("cases" in data or not data.keys() & {"name", "object", "arms"}):
        items = typed.convert(data, CaseFileData, source).cases
        listed = [(f"$.cases[{i}]", item) for i, item in enumerate(items)]
    elif isinstance(data, list):
        listed = [(f"$[{i}]", item) for i, item in enumerate(data)]
    else:
        listed = [("$", data)]
    if not listed:
        raise Location(source).refuse("expected at least one case, got none")
    cases = []
    first: dict[str, str] = {}
    for root, item in listed:
        case = build_case(typed.convert(item, CaseData, source, root), source, root)
        if case.name in first:
            raise Location(source, root + ".name").refuse(
                f"duplicate name {case.name!r}, first used at {first[case.name]}"
            )
        first[case.name] = root
        cases.append(case)
    return cases


def build_case(data: CaseData, source: str = "case", root: str = "$") -> Case:
    """Return a case from its typed data.

    The format gives no attitude to a tip: each tip frame is taken to agree with its
    contact frame at the case's state.

    Raises:
        SceneError: with the JSON path of the first fault.
    """
    # numbers near the end of float64's range overflow below: what comes of it is refused, not warned of
    with np.errstate(all="ignore"):
        return _build(data, Location(source, root))


def _build(data: CaseData, at: Location) -> Case:
    if not data.arms:
        raise (at / "arms").refuse("expected at least one arm, got none")
    arms, grasps = {}, {}
    for i, arm in enumerate(data.arms):
        arms[f"arm{i + 1}"], grasps[f"arm{i + 1}"] = _arm(arm, at / "arms" / i)
    body = data.object
    with (at / "object").refusals():
        frame = Pose(checks.rotation_matrix(body.R, "object: R"), checks.numbers(body.p, (3,), "object: p"))
        held = HeldObject(body.mass, np.array(body.inertia), np.array(body.com))
    with at.refusals():
        chain = ClosedChain(arms, held, grasps, np.array(data.gravity))
        q, qd, tau = (np.concatenate([getattr(arm, key) for arm in data.arms]) for key in ("q", "qd", "tau"))
        state = State(q, qd, frame.wxyz_xyz, np.array([*body.omega, *body.v]))
    inputs = Inputs(
        base_twists=np.array([[*a.base.omega, *a.base.v] for a in data.arms]),
        base_accelerations=np.array([[*a.base.omega_dot, *a.base.v_dot] for a in data.arms]),
    )
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs.shaped(chain))
    with at.refusals():
        chain = _with_tip_attitudes(motion)
    rates = None
    if any(arm.grasp.W for arm in data.arms):  # a W left out is the one the velocities imply
        given = [arm.grasp.W for arm in data.arms]
        rates = np.concatenate([c.W if W is None else W for W, c in zip(given, motion.contacts, strict=True)])
    _check_expected(data, at / "expected")
    return Case(data.name, chain, state, tau, inputs, rates, data.expected)


def _arm(data: ArmData, at: Location) -> tuple[Arm, Grasp]:
    joints, links = [], []
    for k, joint in enumerate(data.joints):
        with (at / "joints" / k).refusals():
            placement = Pose(checks.rotation_matrix(joint.R0, "joint: R0"), np.array(joint.p0))
            joints.append(Joint(joint.type, np.array(joint.axis), placement))
    for k, link in enumerate(data.links):
        with (at / "links" / k).refusals():
            links.append(Link(link.mass, np.array(link.com), np.array(link.inertia)))
    if not joints:
        raise (at / "joints").refuse("expected at least one joint, got none")
    for key in ("links", "q", "qd", "tau"):
        if len(getattr(data, key)) != len(joints):
            raise (at / key).refuse(f"expected {len(joints)} entries, one per joint, got {len(getattr(data, key))}")
    with (at / "base").refusals():
        base = Pose(checks.rotation_matrix(data.base.R, "base: R"), np.array(data.base.p))
    with at.refusals():
        arm = Arm(joints, links, Pose(np.eye(3), np.array(data.tip)), base)
    return arm, _grasp(data.grasp, at / "grasp")


def _grasp(data: GraspData, at: Location) -> Grasp:
    """Return the grasp with its contact frame: hinge axis along x, soft finger's tangents x, y."""
    listed = GRASP_KINDS[data.type].listed_axes
    if len(data.h_object) != listed:
        raise (at / "h_object").refuse(f"expected {listed} unit vectors for a {data.type}, got {len(data.h_object)}")
    freedoms = len(GRASP_KINDS[data.type].free)
    if data.W is not None and len(data.W) != freedoms:
        raise (at / "W").refuse(f"expected {freedoms} relative rates for a {data.type}, got {len(data.W)}")
    R = np.eye(3)
    axes = []
    for i, h in enumerate(data.h_object):
        with (at / "h_object" / i).refusals():
            axes.append(checks.unit_vector(h, "axis"))
    if axes:
        x = axes[0]
        y = axes[1] if len(axes) == 2 else _perpendicular(x)
        if abs(x @ y) > checks.ROTATION_TOLERANCE:
            raise (at / "h_object").refuse(f"expected perpendicular tangents, got h1.h2 = {x @ y:.3g}")
        R = np.column_stack([x, y, cross(x, y)])
    with at.refusals():
        return Grasp(data.type, Pose(R, np.array(data.point_object)))


def _perpendicular(x: Array) -> Array:
    other = cross(x, np.eye(3)[int(np.argmin(np.abs(x)))])
    return other / np.linalg.norm(other)


def _with_tip_attitudes(motion: ChainMotion) -> ClosedChain:
    """Return the chain with every tip frame turned to its contact frame."""
    arms = {
        name: arm.with_tip(Pose(motion.arms[name].at.R[-1].T @ c.R, arm.tip.p))
        for (name, arm), c in zip(motion.chain.arms.items(), motion.contacts, strict=True)
    }
    return replace(motion.chain, arms=arms)


def _check_expected(data: CaseData, at: Location) -> None:
    """Refuse an answer whose shape is not the problem's."""
    if data.expected is None:
        return
    shapes = {
        "qdd": [len(arm.joints) for arm in data.arms],
        "f": [6] * len(data.arms),
        "W_dot": [len(GRASP_KINDS[arm.grasp.type].free) for arm in data.arms],
    }
    for key, lengths in shapes.items():
        parts = getattr(data.expected, key)
        if len(parts) != len(lengths):
            raise (at / key).refuse(f"expected {len(lengths)} lists, one per arm, got {len(parts)}")
        for i, (part, length) in enumerate(zip(parts, lengths, strict=True)):
            if len(part) != length:
                raise (at / key / i).refuse(f"expected {length} numbers, got {len(part)}")
    if len(data.expected.alpha_C) != 6:
        raise (at / "alpha_C").refuse(f"expected 6 numbers, got {len(data.expected.alpha_C)}")
