"""Links and joints as a tree: its root, and the way from one link to another."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from holdfast.robots.urdf.document import Element, quoted
from holdfast.robots.urdf.robot import UrdfJoint, UrdfLink, UrdfRobot


class Step(NamedTuple):
    """A joint passed on the way from one link to another.

    Attributes:
        joint: the joint.
        down: True from parent to child, False from child to parent.
    """

    joint: UrdfJoint
    down: bool

    @property
    def beyond(self) -> str:
        """Name of the link that it leads to."""
        return self.joint.child if self.down else self.joint.parent


def root_of(element: Element, links: Mapping[str, UrdfLink], joints: Mapping[str, UrdfJoint]) -> str:
    """Return the one link that is no joint's child, if links and joints form a tree. O(links + joints).

    Raises:
        SceneError: no link, a joint to an unknown link, a link with two parents, a loop,
            several roots.
    """
    if not links:
        raise element.refuse("expected at least one <link>, got none")
    above: dict[str, UrdfJoint] = {}
    for joint in joints.values():
        for side, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise joint.element.refuse(f"{side}: no link {quoted(link)}.{hint(link, links)}")
        if joint.child in above:
            other = above[joint.child]
            raise joint.element.refuse(
                f"child: link {quoted(joint.child)} hangs on joint {quoted(other.name)} already (line"
                f" {other.element.line}): a loop, which joints in series cannot close"
            )
        above[joint.child] = joint
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        raise links[roots[1]].element.refuse(f"expected one root link, got {listed(roots)}; try joining them")
    if not roots:
        raise element.refuse("expected a root link that is no joint's child, got joints in a circle")
    _refuse_circles(roots[0], links, joints)
    return roots[0]


def _refuse_circles(root: str, links: Mapping[str, UrdfLink], joints: Mapping[str, UrdfJoint]) -> None:
    """Refuse links that cannot be reached from the root: each has a parent, so they stand in a circle."""
    below: dict[str, list[str]] = {}
    for joint in joints.values():
        below.setdefault(joint.parent, []).append(joint.child)
    reached, waiting = {root}, [root]
    while waiting:
        children = below.get(waiting.pop(), [])
        reached.update(children)
        waiting += children
    if astray := [link for link in links if link not in reached]:
        raise links[astray[0]].element.refuse(f"hangs on joints in a circle with {listed(astray)}")


def way(robot: UrdfRobot, start: str, end: str) -> list[Step]:
    """Return the joints from one link to another: up to their common ancestor, then down. O(links)."""
    up, down = _to_root(robot, start), _to_root(robot, end)
    while up and down and up[-1] is down[-1]:
        up.pop()
        down.pop()
    return [Step(joint, False) for joint in up] + [Step(joint, True) for joint in reversed(down)]


def _to_root(robot: UrdfRobot, link: str) -> list[UrdfJoint]:
    """Return the joints from a link up to the root."""
    joints = []
    while (joint := robot.joint_above.get(link)) is not None:
        joints.append(joint)
        link = joint.parent
    return joints


def known_link(robot: UrdfRobot, link: str, what: str) -> str:
    """Return the name of a link if the robot has it.

    Raises:
        SceneError: it has none of that name.
    """
    if not isinstance(link, str) or link not in robot.links:
        shown = quoted(link) if isinstance(link, str) else f"a {type(link).__name__}"
        raise robot.element.refuse(f"{what}: no link {shown}.{hint(str(link), robot.links)}")
    return link


def hint(name: str, known: Iterable[str]) -> str:
    """Return ' Did you mean ...?', or what is known, shortened."""
    known = list(known)
    near = difflib.get_close_matches(name[:256], known, n=1, cutoff=0.6) if len(known) <= 2000 else []
    return f" Did you mean '{near[0]}'?" if near else f" Known: {listed(known)}."


def listed(names: Iterable[str], most: int = 12) -> str:
    """Return names with quotes and commas, at most so many."""
    names = list(names)
    rest = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(quoted(name) for name in names[:most]) + rest if names else "none"
