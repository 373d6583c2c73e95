"""The checks that links and joints of a robot's file form one tree."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from holdfast.robots.urdf.document import Element, hint, listed, quoted
from holdfast.robots.urdf.robot import UrdfJoint, UrdfLink, UrdfRobot

Named = TypeVar("Named", UrdfLink, UrdfJoint)


def by_name(members: list[Named]) -> dict[str, Named]:
    """Return links or joints by name; duplicate names are refused."""
    found: dict[str, Named] = {}
    for member in members:
        if member.name in found:
            first = found[member.name].element.line
            raise member.element.refuse(f"expected a unique name, first used in line {first}")
        found[member.name] = member
    return found


def root_of(element: Element, links: Mapping[str, UrdfLink], joints: Mapping[str, UrdfJoint]) -> str:
    """Return the root, the only link that is not the child of a joint, after checking that there is a tree.

    O(links + joints).

    Raises:
        SceneError: there are no links, a joint refers to an unknown link, a link has two parents, or there is a loop or
            more than one root.
    """
    if not links:
        of_xacro = "xmlns:xacro" in element.attributes or element.source.endswith("(expanded)")
        why = ": the file contains macros only and calls none; try to load the file that calls them" if of_xacro else ""
        raise element.refuse(f"expected at least one <link>, got none{why}")
    above: dict[str, UrdfJoint] = {}
    for joint in joints.values():
        for side, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise joint.element.refuse(f"{side}: no link {quoted(link)}.{hint(link, links)}")
        if joint.child in above:
            other = above[joint.child]
            raise joint.element.refuse(
                f"child: link {quoted(joint.child)} hangs on joint {quoted(other.name)} already (line"
                f" {other.element.line}): a loop, which a serial arm cannot contain"
            )
        above[joint.child] = joint
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        raise links[roots[1]].element.refuse(f"expected one root link, got {listed(roots)}; try joining them")
    if not roots:
        raise element.refuse("expected a root link that is not the child of any joint, got a cycle of joints")
    return roots[0]


def refuse_circles(robot: UrdfRobot) -> None:
    """Refuse links that cannot be reached from the root; each has a parent, so they form a cycle."""
    reached, waiting = {robot.root}, [robot.root]
    while waiting:
        children = [joint.child for joint in robot.joints_below[waiting.pop()]]
        reached.update(children)
        waiting += children
    if astray := [link for link in robot.links if link not in reached]:
        raise robot.links[astray[0]].element.refuse(f"hangs on a cycle of joints with {listed(astray)}")
