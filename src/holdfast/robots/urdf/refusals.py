"""What keeps a way through a robot from being an arm: each refusal names the joint and what to pass."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.folding import Fold, moving_branches
from holdfast.robots.urdf.locking import Locks, resting_position
from holdfast.robots.urdf.robot import MOVING, UrdfJoint
from holdfast.robots.urdf.tree import Step, listed, way

MOST_REASONS = 8  # of joints, in one message
MOST_HELD = 40  # joints in one advice


def refuse_unsupported(locks: Locks, steps: list[Step]) -> None:
    """Refuse joints on the way that an arm cannot have: several freedoms, or the motion of another."""
    for joint, down in steps:
        if not joint.is_fixed and joint.kind not in MOVING:
            end, link = ("base", joint.child) if down else ("tip", joint.child)
            raise joint.element.refuse(
                f"type: expected a joint of one freedom between base and tip, got {quoted(joint.kind)};"
                f" try {end}={quoted(link)}"
            )
    following = [joint for joint, _ in steps if joint.mimic is not None and locks.position(joint) is None]
    if following:
        mimic, others = following[0].mimic, listed(joint.name for joint in following[1:])
        assert mimic is not None
        raise following[0].element.refuse(
            f"mimic: expected joints that move independently, got one that follows {quoted(mimic.joint)}"
            f"{f', and {others}' if following[1:] else ''}; try {_held(following)}"
        )


class Loose(NamedTuple):
    """A joint that moves what must stand still.

    Attributes:
        joint: the joint.
        why: what it does, such as "moves both arm 'left' and arm 'right'".
    """

    joint: UrdfJoint
    why: str


def hanging(locks: Locks, folded: Fold, steps: list[Step]) -> list[Loose]:
    """Return the joints that move links which hang on an arm."""
    passed = {step.joint.name for step in steps}
    return [
        Loose(joint, f"moves link {quoted(joint.child)}, which hangs on the arm but is not between base and tip")
        for body in folded.bodies
        for joint in moving_branches(body, passed, locks)
    ]


def shared(locks: Locks, ways: Mapping[str, list[Step]]) -> list[Loose]:
    """Return the joints that move several arms."""
    owners: dict[str, list[str]] = {}
    for name, steps in ways.items():
        for joint, _ in steps:
            owners.setdefault(joint.name, []).append(f"arm '{name}'")
    joints = locks.robot.joints
    return [
        Loose(joints[name], f"moves both {' and '.join(arms)}")
        for name, arms in owners.items()
        if len(arms) > 1 and locks.pose(joints[name]) is None
    ]


def under_bases(locks: Locks, bases: Mapping[str, str]) -> list[Loose]:
    """Return the joints that move the bases of arms; `bases` has their links by arm."""
    moved: dict[str, list[str]] = {}
    for name, base in bases.items():
        for joint, _ in way(locks.robot, locks.robot.root, base):
            moved.setdefault(joint.name, []).append(f"base {quoted(base)} of arm '{name}'")
    joints = locks.robot.joints
    return [
        Loose(joints[name], f"moves the {' and the '.join(whose)}")
        for name, whose in moved.items()
        if locks.pose(joints[name]) is None
    ]


def refuse_loose(locks: Locks, loose: list[Loose]) -> None:
    """Refuse all joints that move what must stand still at once, with what to pass so that they are held."""
    if odd := [one for one in loose if one.joint.kind not in MOVING]:
        raise odd[0].joint.element.refuse(
            f"type: expected a joint that can be held, since it {odd[0].why}, got {quoted(odd[0].joint.kind)};"
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


def _advice(locks: Locks, loose: list[Loose]) -> str:
    """Return what to pass so that these joints are held; those that follow another of them need nothing."""
    joints = {one.joint.name: one.joint for one in loose}
    free = [joint for joint in joints.values() if joint.mimic is None or joint.mimic.joint not in joints]
    own = any(joint.name in locks.on_the_way or joint.mimic is not None for joint in free)  # no others to the arms
    return f"try {_held(free)}" + ("" if own else " or lock_others=True")


def _held(joints: list[UrdfJoint]) -> str:
    """Return `locked=` of joints, each at its resting position, as code."""
    held = ", ".join(f"{quoted(joint.name)}: {resting_position(joint)!r}" for joint in joints[:MOST_HELD])
    return f"locked={{{held}{', ...' if len(joints) > MOST_HELD else ''}}}"
