"""Problem cases of forests: forward dynamics of bodies with closures and couplings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.io import forest_case_data as layout
from holdfast.io.case_data import CasePose
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.closure import Closure
from holdfast.model.forest import BodyJoint, Forest, ForestBody, JointCoupling
from holdfast.model.grasp import Grasp
from holdfast.model.link import Link
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class ForestCase:
    """Forward dynamics of a forest, ready to solve.

    Attributes:
        name: its name.
        forest: bodies, closures and couplings.
        q: (n_q,) positions.
        qd: (n_v,) rates.
        tau: (n_v,) torques; of a free body, a wrench about its frame's origin.
        wrenches: (bodies, 6) external wrenches about the frames' origins, world axes.
        expected: the answer, if the file contains one.
    """

    name: str
    forest: Forest
    q: Array
    qd: Array
    tau: Array
    wrenches: Array
    expected: layout.ForestExpected | None


def build_forest_case(data: layout.ForestCaseData, source: str = "case", root: str = "$") -> ForestCase:
    """Return a forest's case from its typed data.

    Raises:
        SceneError: it is invalid; the message gives the JSON path of the first fault.
    """
    at = Location(source, root)
    bodies = [_body(body, at / "bodies" / k) for k, body in enumerate(data.bodies)]
    closures = []
    for i, closure in enumerate(data.closures):
        where = at / "closures" / i
        tip, frame = _pose(closure.frame_a, where / "frame_a"), _pose(closure.frame_b, where / "frame_b")
        kind: Any = closure.type
        with where.refusals():
            closures.append(Closure(closure.a, closure.b, Grasp(kind, frame), tip))
    couplings = []
    for i, coupling in enumerate(data.couplings):
        with (at / "couplings" / i).refusals():
            couplings.append(JointCoupling(coupling.terms))
    with at.refusals():
        forest = Forest(bodies, closures, couplings, np.array(data.gravity))
    counts = [(body.joint.of_kind.position_count, body.joint.of_kind.freedoms) for body in bodies]
    for k, (given, (n_q, n_v)) in enumerate(zip(data.bodies, counts, strict=True)):
        for key, count in (("q", n_q), ("qd", n_v), ("tau", n_v)):
            numbers = getattr(given, key)
            if numbers is not None and len(numbers) != count:
                raise (at / "bodies" / k / key).refuse(
                    f"expected {count} numbers for a {given.joint.type} joint, got {len(numbers)}"
                )
        if forest.bodies[k].joint.of_kind.pose:
            with (at / "bodies" / k / "q").refusals():
                checks.pose_numbers([*given.q[:4], 0.0, 0.0, 0.0], "q")
    _check_expected(data, counts, at / "expected")
    none = np.zeros(6)
    return ForestCase(
        data.name,
        forest,
        np.concatenate([np.array(body.q) for body in data.bodies]),
        np.concatenate([np.array(body.qd) for body in data.bodies]),
        np.concatenate(
            [np.zeros(n) if b.tau is None else np.array(b.tau) for b, (_, n) in zip(data.bodies, counts, strict=True)]
        ),
        np.array([none if body.wrench is None else body.wrench for body in data.bodies]),
        data.expected,
    )


def _body(data: layout.ForestBodyData, at: Location) -> ForestBody:
    joint = data.joint
    with (at / "joint").refusals():
        placement = Pose(checks.rotation_matrix(joint.R0, "joint: R0"), np.array(joint.p0))
        kind: Any = joint.type
        axis: dict[str, Any] = {} if joint.axis is None else {"axis": joint.axis}
        found = BodyJoint(
            kind,
            placement,
            across=joint.across,
            pitch=joint.pitch,
            armature=data.armature,
            damping=data.damping,
            **axis,
        )
    with at.refusals():
        link = Link(data.mass, np.array(data.com), np.array(data.inertia), data.name)
        return ForestBody(link, found, data.parent)


def _pose(data: CasePose, at: Location) -> Pose:
    with at.refusals():
        return Pose(checks.rotation_matrix(data.R, "frame: R"), np.array(data.p))


def _check_expected(data: layout.ForestCaseData, counts: list[tuple[int, int]], at: Location) -> None:
    """Refuse an answer whose shape does not match the forest."""
    if data.expected is None:
        return
    lengths = {
        "qdd": len(data.bodies),
        "alpha": len(data.bodies),
        "f": len(data.closures),
        "coupling": len(data.couplings),
    }
    for key, count in lengths.items():
        if len(getattr(data.expected, key)) != count:
            raise (at / key).refuse(f"expected {count} entries, got {len(getattr(data.expected, key))}")
    for k, (qdd, (_, n_v)) in enumerate(zip(data.expected.qdd, counts, strict=True)):
        if len(qdd) != n_v:
            raise (at / "qdd" / k).refuse(f"expected {n_v} numbers, got {len(qdd)}")
