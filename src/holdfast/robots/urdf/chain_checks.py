"""What is refused of a chain in a robot's file, and what is noted.

Errors name the joint that keeps a path from being an arm, and the arguments to pass. Notes are on links and joints, on
couplings that have no effect on the chain, and on its tip.
"""

from __future__ import annotations

from collections.abc import Collection, Container, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.tip_direction import tip_advice, tip_angle
from holdfast.robots.urdf.bodies import FoldedChain, moving_branches
from holdfast.robots.urdf.document import listed, quoted
from holdfast.robots.urdf.path import Locks, PassedJoint, path_between, resting_position
from holdfast.robots.urdf.robot import MOVABLE, WORLD_LINK, UrdfCoupling, UrdfJoint, UrdfRobot

MOST_REASONS = 8  # reasons in one message
MOST_HELD = 40  # joints in the advice of one message
SAME_PLACE = 1e-6  # [m] distance below which the origins of two frames are at the same place
UPRIGHT = 0.1  # [rad] largest angle between z and the direction to the tip


def refuse_unsupported(locks: Locks, path: list[PassedJoint], *, coupled: bool = False) -> None:
    """Refuse joints on the path with several degrees of freedom and, unless they are `coupled`, that mimic others."""
    for joint, down in path:
        if not joint.is_fixed and joint.kind not in MOVABLE:
            end, link = ("base", joint.child) if down else ("tip", joint.child)
            raise joint.element.refuse(
                f"type: expected a joint with one degree of freedom between base and tip, got {quoted(joint.kind)};"
                f" try {end}={quoted(link)}"
            )
    following = [joint for joint, _ in path if joint.mimic is not None and locks.position(joint) is None]
    if following and not coupled:
        mimic, others = following[0].mimic, listed(joint.name for joint in following[1:])
        assert mimic is not None
        raise following[0].element.refuse(
            f"mimic: expected joints that move independently, got one that follows {quoted(mimic.joint)}"
            f"{', which moves, so that lock_others does not lock it' if locks.others else ''}"
            f"{f', and {others}' if following[1:] else ''}; try {held_argument(following)}"
        )


class LooseJoint(NamedTuple):
    """A joint that must be locked.

    Attributes:
        joint: the joint.
        why: the reason, such as "moves both arm 'left' and arm 'right'".
    """

    joint: UrdfJoint
    why: str


def hanging(
    locks: Locks, folded: FoldedChain, what: str = "arm", passed: Container[str] | None = None
) -> list[LooseJoint]:
    """Return the joints that move links on an arm or a trunk but are not on its path."""
    if passed is None:
        passed = {joint.name for joint, _ in folded.path} | {joint.name for joint in folded.joints}
    found = []
    for joint in (joint for links in folded.moving for joint in moving_branches(links, passed, locks)):
        why = f"moves link {quoted(joint.child)}, which hangs on the {what} but is not between base and tip"
        if joint.mimic and locks.others:
            why += f", and mimics {quoted(joint.mimic.joint)}, which moves, so that lock_others does not lock it"
        found.append(LooseJoint(joint, why))
    return found


def shared(locks: Locks, ends: Mapping[str, tuple[str, str]]) -> list[LooseJoint]:
    """Return the joints that move several arms, or the bases of arms; `ends` contains base and tip link by arm."""
    arms: dict[str, list[str]] = {}
    bases: dict[str, list[str]] = {}
    robot = locks.robot
    for name, (base, tip) in ends.items():
        for joint, _ in path_between(robot, base, tip):
            arms.setdefault(joint.name, []).append(f"arm '{name}'")
        for joint, _ in path_between(robot, robot.root, base):
            bases.setdefault(joint.name, []).append(f"base {quoted(base)} of arm '{name}'")
    reasons = [(name, f"moves both {' and '.join(moved)}") for name, moved in arms.items() if len(moved) > 1]
    reasons += [(name, f"moves the {' and the '.join(moved)}") for name, moved in bases.items()]
    joints = robot.joints
    return [LooseJoint(joints[name], why) for name, why in reasons if locks.pose(joints[name]) is None]


def refuse_loose(locks: Locks, loose: list[LooseJoint]) -> None:
    """Raise one error for all joints that must be locked, with the arguments that lock them."""
    if odd := [one for one in loose if one.joint.kind not in MOVABLE]:
        raise odd[0].joint.element.refuse(
            f"type: expected a joint that can be locked, since it {odd[0].why}, got {quoted(odd[0].joint.kind)};"
            " try load_urdf with a base beyond it, and its mount"
        )
    if not loose:
        return
    groups: dict[str, dict[str, None]] = {}
    for joint, why in loose:
        groups.setdefault(why, {})[joint.name] = None
    (why, alike), *others = groups.items()
    first, *rest = alike
    too = f", as {'do' if len(rest) > 1 else 'does'} {listed(rest)}" if rest else ""
    also = "".join(f"; {listed(names)} {why}" for why, names in others[:MOST_REASONS])
    more = f"; and {len(others) - MOST_REASONS} more" if len(others) > MOST_REASONS else ""
    raise locks.robot.joints[first].element.refuse(f"{why}{too}{also}{more}; {_advice(locks, loose)}")


def _advice(locks: Locks, loose: list[LooseJoint]) -> str:
    """Return the arguments that lock these joints; those that mimic another of them need not be given."""
    joints = {one.joint.name: one.joint for one in loose}
    free = [joint for joint in joints.values() if joint.mimic is None or joint.mimic.joint not in joints]
    own = any(joint.name in locks.on_path or joint.mimic is not None for joint in free)  # not locked by `lock_others`
    return f"try {held_argument(free)}" + ("" if own else " or lock_others=True")


def held_argument(joints: list[UrdfJoint]) -> str:
    """Return the argument `locked=` for joints at their default positions, as code."""
    held = ", ".join(f"{quoted(joint.name)}: {resting_position(joint)!r}" for joint in joints[:MOST_HELD])
    return f"locked={{{held}{', ...' if len(joints) > MOST_HELD else ''}}}"


def read_within(locks: Locks, folded: FoldedChain) -> tuple[dict[str, float], list[str], list[str]]:
    """Return the positions of locked joints within a chain and its base, the notes on its links and joints, and frames.

    Those are links without mass and shape. They are noted, too, but there is no need to warn of them.
    """
    robot = locks.robot
    inside = {name: robot.links[name] for links in (folded.on_base, *folded.moving) for name in links}
    within = [joint for joint in robot.joints.values() if joint.parent in inside and joint.child in inside]
    locked = {j.name: q for j in within if not j.is_fixed and (q := locks.position(j)) is not None}
    notes = [note for part in (robot, *inside.values(), *within) for note in part.notes]
    moving = [robot.links[name] for links in folded.moving for name in links]
    massless = [link.element for link in moving if link.inertial is None]
    shaped = [element for element in massless if any(map(element.first, ("visual", "collision")))]
    said = {element: element.message("no <inertial>, taken as massless") for element in massless}
    faults = [joint.fault for joint in robot.joints.values() if joint.fault is not None]
    notes += [f"{fault}; not read, since the joint does not move here" for fault in dict.fromkeys(faults)]
    notes += [*map(said.pop, shaped), *_locked_notes(locks, within)]
    return locked, notes, [*said.values()]


def _locked_notes(locks: Locks, within: list[UrdfJoint]) -> list[str]:
    """Return notes on joints whose lock is no plain answer to `lock_others`."""
    notes = []
    for joint in within:
        if joint.kind not in MOVABLE and not joint.is_fixed and locks.passes_over(joint):
            notes.append(joint.element.message(f"{joint.kind}, locked in the pose of its <origin>"))
        elif joint.mimic is None or joint.name in locks.given or (q := locks.position(joint)) is None:
            continue
        elif joint.mimic.joint not in locks.robot.joints:
            notes.append(joint.element.message(f"mimic: no joint {quoted(joint.mimic.joint)}; locked at {q:g}"))
        elif joint.name in locks.on_path:
            why = f"since it mimics {quoted(joint.mimic.joint)}, which is locked"
            notes.append(joint.element.message(f"locked at {q:g}, {why}"))
    return notes


def tip_note_of(robot: UrdfRobot, arm: Arm, tip: str, folded: FoldedChain) -> str:
    """Return the note on a tip whose z axis does not point out of the hand, with better links at this place, or ''."""
    if arm.parents or not (advice := tip_advice(arm)):
        return ""
    better = [
        f"tip={quoted(name)}"
        for name, at in folded.bodies[-1].links.items()
        if np.allclose(at.p, arm.tip.p, rtol=0, atol=SAME_PLACE) and tip_angle(arm.with_tip(at)) < UPRIGHT
    ]
    others = f", or {' or '.join(better[:3])}, a frame at the same place" if better else ""
    return robot.links[tip].element.message(f"as a tip: {advice}{others}")


def coupling_notes(
    robot: UrdfRobot,
    bodies: Sequence[Collection[str]],
    joints: Container[str],
    floats: bool = False,
    loops: Container[str] | None = None,
) -> list[str]:
    """Return notes on couplings without effect, whose ends are on one moving body.

    Args:
        robot: the robot.
        bodies: names of the links of each body; the first is the base.
        joints: names of the joints that move.
        floats: whether the base is a free body.
        loops: names of the loops that arms with branches have; None without branches.

    Raises:
        SceneError: a coupling acts on a body that moves.
    """
    at = {link: k for k, links in enumerate(bodies) for link in links}
    world = -2 if floats else 0
    notes = []
    for coupling in robot.couplings:
        if loops is not None and coupling.closure is not None and coupling.closure.name in loops:
            continue
        places = {world if link == WORLD_LINK and link not in at else at.get(link, -1) for link in coupling.links}
        moving = {k for k in places if k > 0 or (floats and k == 0)}
        acts = any(joint in joints for joint in coupling.joints)
        if is_mimicked(robot, coupling):
            notes.append(coupling.element.message("not read, since the joints between its links mimic one of them"))
            continue
        if acts or (moving and len(places) > 1) or len(coupling.links | coupling.joints) < 2:
            ends = " and ".join(quoted(one) for one in sorted(coupling.links or coupling.joints)) or "no known link"
            closes = "closes a loop, which a serial arm cannot contain"
            advice = "" if loops is not None or coupling.closure is None else " branches=True, which reads it,"
            if loops is not None and coupling.closure is not None:
                closes = "closes a loop that is not within one arm"
            raise coupling.element.refuse(
                f"{closes}: it couples {ends}; try{advice} locking the joints between"
                " them (locked=, lock_others=True), or deleting it if no arm passes through it"
            )
        if moving:
            notes.append(
                coupling.element.message("not read, since it has no effect between links that are locked together")
            )
    return notes


def is_mimicked(robot: UrdfRobot, coupling: UrdfCoupling) -> bool:
    """Return whether one joint moves all joints between two links, which a loop between them only says again."""
    if len(coupling.links) != 2 or coupling.joints or WORLD_LINK in coupling.links:
        return False
    between = [joint for joint, _ in path_between(robot, *sorted(coupling.links)) if not joint.is_fixed]
    followed = {joint.mimic.joint if joint.mimic is not None else joint.name for joint in between}
    return len(between) > 1 and len(followed) == 1
