"""A way through a tree of links as rigid bodies and the joints between them.

Fixed and held joints weld their links together, side branches included. A joint that is
passed from child to parent turns about the same axis the other way: with T0 its placement,

    parent -> child   T0 Rot(a, q)          child -> parent   Rot(-a, q) T0^-1,

so the body beyond it takes the joint's frame for its own, and its link lies at T0^-1 in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from holdfast.robots.urdf.locking import Locks
from holdfast.robots.urdf.robot import UrdfJoint
from holdfast.robots.urdf.tree import Step
from holdfast.spatial.pose import Pose

Welded = dict[str, Pose]  # pose in the body's frame, by link name


@dataclass(frozen=True, eq=False)
class Body:
    """Links that one joint moves as one.

    Attributes:
        step: the joint, and which way it is passed.
        placement: pose of the body's frame at q = 0 in the frame of the body before.
        links: pose in the body's frame, by link name; the link that the joint moves first.
    """

    step: Step
    placement: Pose
    links: Welded


@dataclass(frozen=True, eq=False)
class Fold:
    """A robot as one chain of bodies.

    Attributes:
        on_base: pose in the base link's frame, by name of the links that stand still with it.
        bodies: what moves, base to tip.
        tip: pose of the tip link in the last body's frame.
    """

    on_base: Welded
    bodies: tuple[Body, ...]
    tip: Pose


def fold(base: str, steps: list[Step], locks: Locks) -> Fold:
    """Return the bodies along the steps from the base link. O(links)."""
    at = Pose.identity()
    on_base, bodies = {base: at}, []
    welded = on_base
    for step in steps:
        joint, down = step
        across = locks.pose(joint)
        if across is not None:
            at = at @ (across if down else across.inverse())
            welded[step.beyond] = at
            continue
        placement = at @ joint.origin if down else at
        at = Pose.identity() if down else joint.origin.inverse()
        welded = {step.beyond: at}
        bodies.append(Body(step, placement, welded))
    passed = {step.joint.name for step in steps}
    _weld_branches(on_base, passed, replace(locks, others=False))  # what moves on the base does not matter
    for body in bodies:
        _weld_branches(body.links, passed, locks)
    return Fold(on_base, tuple(bodies), at)


def _weld_branches(links: Welded, passed: set[str], locks: Locks) -> None:
    """Add to the links of a body what hangs on them by fixed and held joints off the way."""
    waiting = list(links)
    while waiting:
        link = waiting.pop()
        for joint in locks.robot.joints_at(link):
            beyond = joint.other(link)
            if joint.name in passed or beyond in links or (across := locks.pose(joint)) is None:
                continue
            links[beyond] = links[link] @ (across if link == joint.parent else across.inverse())
            waiting.append(beyond)


def moving_branches(body: Body, passed: set[str], locks: Locks) -> list[UrdfJoint]:
    """Return the joints off the way that move something on a body, however far out. O(links)."""
    found, waiting, seen = [], list(body.links), set(body.links)
    while waiting:
        link = waiting.pop()
        for joint in locks.robot.joints_at(link):
            beyond = joint.other(link)
            if joint.name in passed or beyond in seen:
                continue
            if locks.pose(joint) is None:
                found.append(joint)
            seen.add(beyond)
            waiting.append(beyond)
    return found
