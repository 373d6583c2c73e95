"""The held object from a URDF file."""

from __future__ import annotations

from os import PathLike
from typing import Any

from holdfast.model.held_object import HeldObject
from holdfast.robots.notes import show_notes
from holdfast.robots.urdf.bodies import inertia_parts
from holdfast.robots.urdf.document import listed, quoted
from holdfast.robots.urdf.path import known_link
from holdfast.robots.urdf.reader import read_urdf
from holdfast.spatial.inertia import welded
from holdfast.spatial.pose import Pose


def held_object_from_urdf(
    path_or_text: str | PathLike[str], link: str | None, physical: bool, **options: Any
) -> HeldObject:
    """Return the object of a URDF file; see `HeldObject.from_urdf`. O(links).

    Args:
        path_or_text: path of the file, or its text.
        link: name of the link; None for the root.
        physical: as for `HeldObject`.
        **options: xacro_args, trust_xacro and packages of `read_urdf`.

    Raises:
        SceneError: as for `HeldObject.from_urdf`.
    """
    robot = read_urdf(path_or_text, **options)
    start = robot.root if link is None else known_link(robot, link, "link")
    at, waiting, moving = {start: Pose.identity()}, [start], []
    while waiting:
        name = waiting.pop()
        for joint in robot.joints_below[name]:
            if joint.is_fixed:
                at[joint.child] = at[name] @ joint.origin
                waiting.append(joint.child)
            else:
                moving.append(joint.name)
    if moving:
        raise robot.links[start].element.refuse(
            f"expected one rigid body, got joints that move parts of it: {listed(moving)}; try link=, naming one of"
            f" {listed(list(robot.links))}, or joints of type fixed"
        )
    notes: list[str] = []
    parts = inertia_parts(robot, at, physical, notes)
    show_notes((*robot.notes, *(note for name in at for note in robot.links[name].notes), *notes))
    if not parts:
        raise robot.links[start].element.refuse(f"expected <inertial> in {quoted(start)}, got none; try adding one")
    mass, com, inertia = welded(parts)
    with robot.links[start].element.refusals():
        return HeldObject(mass, inertia, com, physical)
