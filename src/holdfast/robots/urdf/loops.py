"""Loops that close between links of a robot's file: those that it states itself, and those that a caller lists."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closure import Closure
from holdfast.model.grasp import Grasp
from holdfast.model.grasp_kinds import GRASP_KINDS
from holdfast.robots.urdf.bodies import FoldedChain
from holdfast.robots.urdf.chain_checks import is_mimicked
from holdfast.robots.urdf.document import hint, quoted
from holdfast.robots.urdf.robot import UrdfCoupling, UrdfRobot
from holdfast.spatial.pose import Pose

SHORT_KINDS = {"3d": "ball", "6d": "rigid"}  # the names in lists of Pinocchio's users
EXCHANGED = Pose(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.zeros(3))  # x and y
EXPECTED = "expected pairs of links, such as [('rod', 'hand', 'hinge')], or closures, also by name"


def with_loop_closures(robot: UrdfRobot, given: Any) -> UrdfRobot:
    """Return a robot with further loops.

    Args:
        robot: the links and joints in the file.
        given: a list of closures between links, or such closures by name: (a, b) or (a, b, kind), of links whose frames
            the grasp kind brings together, a ball by default; or a `Closure` with the names of links. None for none.

    Raises:
        SceneError: it is nothing of this kind, a link is unknown, or a name is used twice.
    """
    if given is None:
        return robot
    if isinstance(given, str) or not checks.is_listed(given):
        raise robot.element.refuse(f"loop_closures: {EXPECTED}; got a {type(given).__name__}")
    named = [*given.items()] if isinstance(given, Mapping) else [(None, one) for one in given]
    found = [*robot.couplings]
    names = {one.closure.name for one in found if one.closure is not None}
    for name, one in named:
        closure = _closure(robot, name, one)
        if closure.name in names:
            raise robot.element.refuse(f"loop_closures: expected unique names, got {quoted(closure.name)} twice")
        names.add(closure.name)
        found.append(UrdfCoupling(robot.element, frozenset({closure.a, closure.b}), closure=closure))
    return replace(robot, couplings=tuple(found))


def _closure(robot: UrdfRobot, name: Any, given: Any) -> Closure:
    """Return one closure between two links."""
    if isinstance(given, Closure):
        a, b, grasp, tip = given.a, given.b, given.grasp, given.tip
        name = name or given.name
    elif isinstance(given, tuple | list) and len(given) in (2, 3):
        a, b, kind = (*given, "ball")[:3]
        known = [kind for kind, row in GRASP_KINDS.items() if row.bushing is None and not row.by_hand]
        kind = SHORT_KINDS.get(str(kind), kind)
        if kind not in known:
            raise robot.element.refuse(
                f"loop_closures: kind: expected one of {', '.join(known)}, got {quoted(str(kind))}."
                f"{checks.did_you_mean(str(kind), known)}"
            )
        try:
            grasp, tip = Grasp(kind), Pose.identity()  # pyright: ignore[reportArgumentType]
        except ModelError as cause:
            raise robot.element.refuse(f"loop_closures: {cause}; try a Closure") from cause
    else:
        raise robot.element.refuse(f"loop_closures: {EXPECTED}; got {checks.short(given)}")
    for link in (a, b):
        if not isinstance(link, str) or link not in robot.links:
            raise robot.element.refuse(f"loop_closures: no link {quoted(str(link))}.{hint(str(link), robot.links)}")
    if a == b:
        raise robot.element.refuse(f"loop_closures: expected two links, got {quoted(a)} twice")
    return Closure(a, b, grasp, tip, str(name or f"{a}-{b}"))


def loops_within(robot: UrdfRobot, folded: FoldedChain) -> dict[str, Closure]:
    """Return the loops that close between bodies of an arm with branches, by name; its base is None. O(links).

    Loops of which both ends are on one body, or that mimic joints say again, are left out.
    """
    at = {link: (None, pose) for link, pose in folded.on_base.items()}
    at |= {link: (k, pose) for k, body in enumerate(folded.bodies) for link, pose in body.links.items()}
    found = {}
    for coupling in robot.couplings:
        closure = coupling.closure
        if closure is None or is_mimicked(robot, coupling) or not {closure.a, closure.b} <= at.keys():
            continue
        if at[closure.b][0] is None:
            closure = _turned_round(closure)
        on, pose = at[closure.a]
        if on != at[closure.b][0]:
            found[closure.name] = closure if on is not None else replace(closure, a=None, tip=pose @ closure.tip)
    return found


def _turned_round(closure: Closure) -> Closure:
    """Return the same constraint with its ends exchanged; the axes of a cardan cross are, too."""
    turn = EXCHANGED if closure.grasp.of_kind.crossed else Pose.identity()
    grasp = closure.grasp.standing_at(closure.tip @ turn)
    return Closure(closure.b, closure.a, grasp, closure.grasp.frame @ turn, closure.name)
