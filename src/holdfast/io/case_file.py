"""Problem cases in JSON, with or without answers: forward dynamics of chains and forests, forces, contacts.

Arms list joints and links base to tip; matrices are row-major; SI units. `tags`, `debug`,
`oracle` and `see` are free-form, everything else is strict.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from holdfast.errors import SceneError
from holdfast.io import case_data, typed
from holdfast.io.case_mechanism import mechanism
from holdfast.io.contact_case import ContactCase, is_contact_case, parse_contact_case
from holdfast.io.contact_motion import AnyMotion, ContactMotion
from holdfast.io.files import file_path
from holdfast.io.force_case import ForceCase, build_force_case
from holdfast.io.force_case_data import ForceCaseData
from holdfast.io.forest_case import ForestCase, build_forest_case
from holdfast.io.forest_case_data import ForestCaseData
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.grasp_kinds import GRASP_KINDS
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import cross
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class Case:
    """A problem ready to solve.

    Attributes:
        name: its name.
        chain: arms ('arm1', 'arm2', ...), object and grasps.
        state: positions and velocities.
        tau: (n,) joint torques.
        inputs: base motion.
        rates: relative rates W in the file, flat; None if it gives none.
        expected: the answer, if the file contains one.
    """

    name: str
    chain: ClosedChain
    state: State
    tau: Array
    inputs: Inputs
    rates: Array | None
    expected: case_data.CaseExpected | None


AnyCase = Case | ContactCase | ContactMotion | ForceCase | ForestCase


def load_cases(path: str | PathLike[str]) -> list[AnyCase]:
    """Return the problems of a JSON file: one case, a list, or an object with `cases`.

    Args:
        path: the file.

    Raises:
        SceneError: the file cannot be read or is invalid; the message gives the JSON path of the first fault.
    """
    file = file_path(path, "path", SceneError)
    return parse_cases(typed.read_bytes(file), str(file))


def parse_cases(text: bytes, source: str) -> list[AnyCase]:
    """Return the problems in the text of such a file.

    Args:
        text: JSON.
        source: where it comes from, for messages.

    Raises:
        SceneError: it is invalid; the message gives the JSON path of the first fault.
    """
    data = typed.parse_json(text, source)
    if isinstance(data, dict) and ("cases" in data or not data.keys() & {"name", "object", "arms", "bodies", "kind"}):
        items = typed.convert(data, case_data.CaseFileData, source).cases
        listed = [(f"$.cases[{i}]", item) for i, item in enumerate(items)]
    elif isinstance(data, list):
        listed = [(f"$[{i}]", item) for i, item in enumerate(data)]
    else:
        listed = [("$", data)]
    if not listed:
        raise Location(source).refuse("expected at least one case, got none")
    cases: list[AnyCase] = []
    first: dict[str, str] = {}
    for root, item in listed:
        case = _case(item, source, root)
        if case.name in first:
            raise Location(source, root + ".name").refuse(
                f"duplicate name {case.name!r}, first used at {first[case.name]}"
            )
        first[case.name] = root
        cases.append(case)
    return cases


def _case(item: Any, source: str, root: str) -> AnyCase:
    """Return one problem: of a forest, a question about forces, or of forward dynamics of arms and an object."""
    if isinstance(item, dict) and "bodies" in item:
        return build_forest_case(typed.convert(item, ForestCaseData, source, root), source, root)
    if isinstance(item, dict) and item.get("kind") == "trajectory":
        motion: ContactMotion = typed.convert(item, AnyMotion, source, root)  # pyright: ignore[reportArgumentType]
        motion.check(Location(source, root))
        return motion
    if is_contact_case(item):
        return parse_contact_case(item, source, root, _grasp)
    if isinstance(item, dict) and "question" in item:
        return build_force_case(typed.convert(item, ForceCaseData, source, root), source, root)
    return build_case(typed.convert(item, case_data.CaseData, source, root), source, root)


@np.errstate(all="ignore")  # of numbers near the end of float64's range: what overflows is refused, not warned of
def build_case(data: case_data.CaseData, source: str = "case", root: str = "$") -> Case:
    """Return a case from its typed data.

    Raises:
        SceneError: it is invalid; the message gives the JSON path of the first fault.
    """
    at = Location(source, root)
    found = mechanism(data, at, _grasp)
    parts = [*([] if data.trunk is None else [data.trunk]), *data.arms]
    with at.refusals():
        tau = checks.numbers(np.concatenate([part.tau for part in parts]), (found.chain.joint_count,), "case: tau")
    _check_expected(data, at / "expected")
    return Case(data.name, found.chain, found.state, tau, found.inputs, found.rates, data.expected)


def _grasp(data: case_data.CaseGrasp, at: Location) -> Grasp:
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


def _check_expected(data: case_data.CaseData, at: Location) -> None:
    """Refuse an answer whose shape does not match the problem."""
    if data.expected is None:
        return
    shapes = {
        "qdd": [len(arm.joints) for arm in data.arms],
        "f": [6] * len(data.arms),
        "W_dot": [0 if arm.grasp is None else len(GRASP_KINDS[arm.grasp.type].free) for arm in data.arms],
    }
    if data.expected.base_wrench is not None:
        shapes["base_wrench"] = [6] * len(data.arms)
    if data.expected.trunk is not None:
        wanted = 0 if data.trunk is None else len(data.trunk.q)
        if data.trunk is None or len(data.expected.trunk.qdd) != wanted:
            raise (at / "trunk" / "qdd").refuse(f"expected {wanted} numbers, got {len(data.expected.trunk.qdd)}")
    counted = []
    for key, lengths in shapes.items():
        parts = getattr(data.expected, key)
        if len(parts) != len(lengths):
            raise (at / key).refuse(f"expected {len(lengths)} lists, one per arm, got {len(parts)}")
        counted += [(at / key / i, part, lengths[i]) for i, part in enumerate(parts)]
    for where, part, length in [*counted, (at / "alpha_C", data.expected.alpha_C, 6)]:
        if len(part) != length:
            raise where.refuse(f"expected {length} numbers, got {len(part)}")
