"""Checks that a path through a robot is an arm; the errors name the joint and the arguments to pass."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import NamedTuple

from holdfast.robots.urdf.bodies import FoldedChain, moving_branches
from holdfast.robots.urdf.document import listed, quoted
from holdfast.robots.urdf.path import Locks, PassedJoint, path_between, resting_position
from holdfast.robots.urdf.robot import MOVING_KINDS, UrdfJoint

MOST_REASONS = 8  # reasons in one message
MOST_HELD = 40  # joints in the advice of one message


def refuse_unsupported(locks: Locks, path: list[PassedJoint]) -> None:
    """Refuse joints on the path with several degrees of freedom, and joints that mimic others."""
    for joint, down in path:
        if not joint.is_fixed and joint.kind not in MOVING_KINDS:
            end, link = ("base", joint.child) if down else ("tip", joint.child)
            raise joint.element.refuse(
                f"type: expected a joint with one degree of freedom between base and tip, got {quoted(joint.kind)};"
                f" try {end}={quoted(link)}"
            )
    following = [joint for joint, _ in path if joint.mimic is not None and locks.position(joint) is None]
    if following:
        mimic, others = following[0].mimic, listed(joint.name for joint in following[1:])
        assert mimic is not None
        raise following[0].element.refuse(
            f"mimic: expected joints that move independently, got one that follows {quoted(mimic.joint)}"
            f"{', which moves, so that lock_others does not lock it' if locks.others else ''}"
            f"{f', and {others}' if following[1:] else ''}; try {_held(following)}"
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
    passed = {joint.name for joint, _ in folded.path} if passed is None else passed
    return [
        LooseJoint(
            joint,
            f"moves link {quoted(joint.child)}, which hangs on the {what} but is not between base and tip"
            + (_unlocked(joint.mimic.joint) if joint.mimic and locks.others else ""),
        )
        for links in folded.moving
        for joint in moving_branches(links, passed, locks)
    ]


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


def _unlocked(leader: str) -> str:
    return f", and mimics {quoted(leader)}, which moves, so that lock_others does not lock it"


def refuse_loose(locks: Locks, loose: list[LooseJoint]) -> None:
    """Raise one error for all joints that must be locked, with the arguments that lock them."""
    if odd := [one for one in loose if one.joint.kind not in MOVING_KINDS]:
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
    return f"try {_held(free)}" + ("" if own else " or lock_others=True")


def _held(joints: list[UrdfJoint]) -> str:
    """Return the argument `locked=` for joints at their default positions, as code."""
    held = ", ".join(f"{quoted(joint.name)}: {resting_position(joint)!r}" for joint in joints[:MOST_HELD])
    return f"locked={{{held}{', ...' if len(joints) > MOST_HELD else ''}}}"
