"""Problem cases of contacts between object and world: instants of chains, Painleve's rod."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.io import contact_case_data as layout
from holdfast.io import typed
from holdfast.io.case_mechanism import mechanism
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.world.solids import HalfSpace
from holdfast.model.world.touching import Touching
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import cross
from holdfast.state import Inputs, State

GraspOf = Callable[[Any, Location], Grasp]
LAYOUTS: dict[str, type[Any]] = {
    "impact": layout.ContactCaseData,
    "rest": layout.ContactCaseData,
    "sliding": layout.ContactCaseData,
    "rod": layout.RodCaseData,
}


@dataclass(frozen=True, eq=False)
class ContactCase:
    """An instant at which the object touches the world.

    Attributes:
        name: its name.
        kind: "impact", "rest", "sliding" or "rod"; a motion is a `ContactMotion`.
        chain: the chain with `touching`.
        state: its state.
        tau: (n,) joint torques.
        inputs: base motion and external wrenches.
        expected: the answer, if the file contains one.
    """

    name: str
    kind: str
    chain: ClosedChain
    state: State
    tau: Array
    inputs: Inputs
    expected: layout.ContactExpected | layout.RodExpected | None


def is_contact_case(item: Any) -> bool:
    """Return whether plain data are a case of contacts."""
    return isinstance(item, dict) and "kind" in item


def parse_contact_case(item: dict[str, Any], source: str, root: str, grasp_of: GraspOf) -> ContactCase:
    """Return a case of contacts from plain data.

    Args:
        item: the data.
        source: where they come from, for messages.
        root: JSON path.
        grasp_of: function of a grasp's data and place that returns the grasp.

    Raises:
        SceneError: it is invalid; the message gives the JSON path of the first fault.
    """
    at, kind = Location(source, root), item["kind"]
    if kind not in LAYOUTS:
        raise (at / "kind").refuse(f"expected {', '.join(LAYOUTS)}, got {checks.short(kind)}")
    data = typed.convert(item, LAYOUTS[kind], source, root)
    return _rod(data, at) if kind == "rod" else _instant(data, at, grasp_of)


def _instant(data: layout.ContactCaseData, at: Location, grasp_of: GraspOf) -> ContactCase:
    found = mechanism(data, at, grasp_of)
    names = [f"contact{j + 1}" for j in range(len(data.contacts))]
    world = {}
    for j, (name, contact) in enumerate(zip(names, data.contacts, strict=True)):
        with (at / "contacts" / j).refusals():
            world[name] = HalfSpace(normal=contact.normal, offset=contact.offset, friction=contact.mu)
    points = {name: contact.point_object for name, contact in zip(names, data.contacts, strict=True)}
    with at.refusals():
        chain = replace(found.chain, touching=Touching(points, world, [(name, name) for name in names]))
    parts = [*([] if data.trunk is None else [data.trunk]), *data.arms]
    with at.refusals():
        tau = checks.numbers(np.concatenate([part.tau for part in parts]), (chain.joint_count,), "case: tau")
    _check_expected(data, at / "expected")
    return ContactCase(data.name, data.kind, chain, found.state, tau, found.inputs, data.expected)


def _rod(data: layout.RodCaseData, at: Location) -> ContactCase:
    """Return a rod as a free object; its centre is behind the sliding end, as the file's p requires.

    p = 1/m + (l^2 / J) (c^2 - mu c s), c and s of `angle`: friction against the slide lifts the end.
    """
    c, s, l = np.cos(data.angle), np.sin(data.angle), data.half_length
    end = l * np.array([c, 0.0, -s])  # from C
    w = np.array([0.0, data.rate, 0.0])
    velocity = np.array([data.slide, 0.0, 0.0]) - cross(w, end)
    with at.refusals():
        body = HeldObject(data.mass, data.inertia * np.eye(3))
        floor = HalfSpace(friction=data.mu)
        chain = ClosedChain({}, body, {}, [0.0, 0.0, -data.gravity], touching=Touching({"end": end}, {"floor": floor}))
        state = State(np.zeros(0), np.zeros(0), Pose.translation(0.0, 0.0, l * s).wxyz_xyz, np.array([*w, *velocity]))
    return ContactCase(data.name, "rod", chain, state, np.zeros(0), Inputs(), data.expected)


def _check_expected(data: layout.ContactCaseData, at: Location) -> None:
    """Refuse an answer whose shape does not match the case."""
    if data.expected is None:
        return
    k, arms = len(data.contacts), len(data.arms)
    for key, count in (("modes", k), ("contact_force", k), ("grasp_impulse", arms), ("f", arms)):
        given = getattr(data.expected, key)
        if given is not None and len(given) != count:
            raise (at / key).refuse(f"expected {count} entries, got {len(given)}")
    for key in ("qd", "qdd"):
        given = getattr(data.expected, key)
        wanted = [len(arm.joints) for arm in data.arms]
        if given is not None and [len(part) for part in given] != wanted:
            raise (at / key).refuse(f"expected lists of {wanted} numbers, one per arm")
