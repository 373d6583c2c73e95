"""URDF files to trees of links and joints."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import TypeVar

from holdfast.robots.urdf import attributes
from holdfast.robots.urdf.document import parse_document
from holdfast.robots.urdf.joints import read_joint
from holdfast.robots.urdf.links import read_link
from holdfast.robots.urdf.robot import UrdfJoint, UrdfLink, UrdfRobot
from holdfast.robots.urdf.source import Source, read_source
from holdfast.robots.urdf.tree import root_of
from holdfast.robots.urdf.vocabulary import read_words

Named = TypeVar("Named", UrdfLink, UrdfJoint)


def read_urdf(
    path_or_text: str | PathLike[str] | Source,
    *,
    xacro_args: Mapping[str, str] | None = None,
    trust_xacro: bool = False,
) -> UrdfRobot:
    """Return the tree of links and joints that a URDF file describes. O(links + joints).

    Every link and joint is read, wherever it stands; whether masses and inertias are
    possible is asked where they are used. Angles within 1e-12 rad of a multiple of pi/2
    are taken as that multiple.

    Args:
        path_or_text: a file, or the text itself (it begins with `<`). A file whose name ends
            in `.xacro` is expanded first (extra `robots`), if `trust_xacro` says so.
        xacro_args: values of the file's <xacro:arg> by name.
        trust_xacro: whether to expand a `.xacro` file. That runs the Python expressions in it
            and in the files that it includes, which can do whatever you can.

    Raises:
        SceneError: what is wrong, with file, line and element; a .xacro file without `trust_xacro`.
        MissingExtra: a .xacro file without xacrodoc.
    """
    source = read_source(path_or_text, xacro_args, trust_xacro)
    root = parse_document(source.text, source.name)
    if root.tag != "robot":
        raise root.refuse("expected <robot> as the outermost element")
    notes = (*source.notes, *read_words(root))
    links = _by_name([read_link(element) for element in root.children if element.tag == "link"])
    joints = _by_name([read_joint(element) for element in root.children if element.tag == "joint"])
    name = attributes.name(root) if root.attributes.get("name", "").strip() else ""
    return UrdfRobot(name, links, joints, root_of(root, links, joints), root, notes)


def _by_name(members: list[Named]) -> dict[str, Named]:
    """Return links or joints by name; the same name twice is refused."""
    found: dict[str, Named] = {}
    for member in members:
        if member.name in found:
            first = found[member.name].element.line
            raise member.element.refuse(f"expected a name of its own, first used in line {first}")
        found[member.name] = member
    return found
