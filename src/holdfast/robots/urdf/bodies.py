"""The path through a tree of links as a chain of rigid bodies and the joints between them; one body as the held object.

Fixed and locked joints weld their links together, including side branches. A joint that is passed from child to parent
rotates about the same axis in the opposite direction. With its placement T0,
    parent -> child   T0 Rot(a, q)          child -> parent   Rot(-a, q) T0^-1,
so the frame of the body beyond it is that of the joint, and its link has the pose T0^-1 in this frame.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np

from holdfast.errors import ModelError
from holdfast.model.held_object import HeldObject
from holdfast.model.link import Link
from holdfast.robots.notes import show_notes
from holdfast.robots.urdf.document import listed, quoted
from holdfast.robots.urdf.path import Locks, PassedJoint, known_link
from holdfast.robots.urdf.reader import read_urdf
from holdfast.robots.urdf.robot import UrdfJoint, UrdfRobot
from holdfast.spatial.inertia import turned, welded
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import product

SLIGHT = 1e-4  # of a body's largest principal moment: by so much the inertia of one of its links may be impossible

LinkPoses = dict[str, Pose]  # pose in the body's frame, by link name


@dataclass(frozen=True, eq=False)
class WeldedBody:
    """Links that are moved by one joint as a single body.

    Attributes:
        step: the joint, and the direction in which it is passed.
        placement: pose of the body's frame at q = 0 in the frame of the body before.
        links: poses in the body's frame, by link name, beginning with the link that the joint moves.
    """

    step: PassedJoint
    placement: Pose
    links: LinkPoses


@dataclass(frozen=True, eq=False)
class FoldedChain:
    """A robot as one chain of bodies.

    Attributes:
        base: name of the base link.
        path: the joints from it to the tip link.
        on_base: poses in the base link's frame of the links that are fixed to it, by name.
        bodies: the moving bodies, base to tip, and then those of branches.
        tip: pose of the tip link in the frame of the last body on the path.
        floats: whether the base link is a free body.
        parents: per body, the index of the body on which its joint is; None for the base.
    """

    base: str
    path: list[PassedJoint]
    on_base: LinkPoses
    bodies: tuple[WeldedBody, ...]
    tip: Pose
    floats: bool = False
    parents: tuple[int | None, ...] = ()

    @property
    def joints(self) -> list[UrdfJoint]:
        """The joints of the moving bodies."""
        return [body.step.joint for body in self.bodies]

    @property
    def moving(self) -> tuple[LinkPoses, ...]:
        """The links of each body that moves, base to tip."""
        return (*([self.on_base] if self.floats else []), *(body.links for body in self.bodies))


def fold(base: str, path: list[PassedJoint], locks: Locks, *, floats: bool = False) -> FoldedChain:
    """Return the bodies along the path from the base link, which is fixed unless it floats. O(links)."""
    at = Pose.identity()
    on_base, bodies = {base: at}, []
    welded = on_base
    for step in path:
        joint, down = step
        across = locks.pose(joint)
        if across is not None:
            at = at @ (across if down else across.inverse())
            welded[step.beyond] = at
            continue
        placement = at @ joint.origin if down else at
        at = Pose.identity() if down else joint.origin.inverse()
        welded = {step.beyond: at}
        bodies.append(WeldedBody(step, placement, welded))
    passed = {step.joint.name for step in path}
    others = locks.others and floats  # joints on a fixed base do not matter
    weld_branches(on_base, passed, replace(locks, others=others))
    for body in bodies:
        weld_branches(body.links, passed, locks)
    return FoldedChain(base, path, on_base, tuple(bodies), at, floats, (None, *range(len(bodies)))[: len(bodies)])


def weld_branches(links: LinkPoses, passed: set[str], locks: Locks) -> None:
    """Add the links that are attached to those of a body by fixed and locked joints off the path."""
    waiting = list(links)
    while waiting:
        link = waiting.pop()
        for joint in locks.robot.joints_at(link):
            beyond = joint.other(link)
            if joint.name in passed or beyond in links or (across := locks.pose(joint)) is None:
                continue
            links[beyond] = links[link] @ (across if link == joint.parent else across.inverse())
            waiting.append(beyond)


def moving_branches(links: LinkPoses, passed: Container[str], locks: Locks) -> list[UrdfJoint]:
    """Return the movable joints off the path on a body, at any depth. O(links)."""
    found, waiting, seen = [], list(links), set(links)
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


def welded_link(robot: UrdfRobot, links: LinkPoses, moved: str, physical: bool, notes: list[str]) -> Link:
    """Return the links of a body combined to one link.

        m = sum m_i,  c = sum m_i c_i / m,  J = sum R_i J_i R_i^T + m_i (d_i.d_i 1 - d_i d_i^T)

    with d_i = c_i - c. Each link must be physically possible. An inertia that is impossible by less than `SLIGHT` of
    the body's is used as it stands, and noted in `notes`. `moved` is the reason why the body must have a mass.

    Raises:
        SceneError: a link is physically impossible, or the body has no <inertial>.
    """
    name = next(iter(links))
    parts = inertia_parts(robot, links, physical, notes)
    if not parts:
        raise robot.links[name].element.refuse(
            f"expected <inertial>, since {moved}, got none; try adding one"
            " (mass 0 and inertia 0 if it is meant to be massless)"
        )
    with robot.links[name].element.refusals():
        return Link(*welded(parts), name=name, physical=physical)


def inertia_parts(
    robot: UrdfRobot, links: LinkPoses, physical: bool, notes: list[str]
) -> list[tuple[float, Array, Array]]:
    """Return the mass, mass centre and inertia about it of each link that has them, in the frame of the links' poses.

    Raises:
        SceneError: a link is physically impossible, or has no weight.
    """
    stated = [
        (robot.links[link], inertial, at) for link, at in links.items() if (inertial := robot.links[link].inertial)
    ]
    for link, inertial, _ in stated:
        if link.fault is not None:
            raise link.fault
        if link.weightless is not None and inertial.mass > 0.0:
            off = f"gravity off for link {quoted(link.name)}"
            if physical:
                raise link.weightless.refuse(
                    f"{off}: expected every body to have weight, since the model has no such switch; try"
                    " physical=False, which gives it weight, and joint torques that carry it; or gravity=[0, 0, 0] of"
                    " the chain if nothing is to have weight"
                )
            notes.append(link.weightless.message(f"{off}: not read, it has weight"))
    parts = [(one.mass, at.p + product(at.R, one.com), turned(one.inertia, at.R)) for _, one, at in stated]
    largest = float(np.linalg.eigvalsh(welded(parts)[2])[-1]) if parts else 0.0  # of the whole body
    for link, one, _ in stated:
        with one.element.refusals():
            try:
                Link(one.mass, one.com, one.inertia, link.name, physical)
            except ModelError:
                a, b, c = np.linalg.eigvalsh(one.inertia).tolist()
                excess = max(-a, c - a - b)
                if one.mass < 0.0 or excess > SLIGHT * largest:
                    raise
                notes.append(
                    one.element.message(
                        f"inertia: no mass distribution has principal moments {a:.3g}, {b:.3g}, {c:.3g}; used as it"
                        f" stands, since this is {excess / largest:.1g} of the largest moment of the whole body"
                    )
                )
    return parts


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
