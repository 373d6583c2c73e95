"""The frames of a model: links, joints and frames, each placed relative to another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import holdfast.robots.urdf.attributes as attributes
from holdfast.errors import SceneError
from holdfast.robots.sdf.values import pose_in
from holdfast.robots.urdf.document import Element, hint, quoted
from holdfast.robots.urdf.robot import WORLD_LINK
from holdfast.robots.urdf.vocabulary import text_of
from holdfast.spatial.pose import Pose

MODEL_FRAME = "__model__"


@dataclass(frozen=True, eq=False)
class SdfFrames:
    """The frames of a model.

    Attributes:
        elements: the elements of links, joints and frames, by name.
        attached: the frame to which each is attached, and by default relative to which it is placed.
        above: the frame relative to which each is placed, and the pose there; the model's own in the world.
    """

    elements: Mapping[str, Element]
    attached: Mapping[str, str]
    above: Mapping[str, tuple[str, Pose]]

    def link(self, name: str, element: Element) -> str:
        """Return the link to which a frame is attached, or "world".

        Raises:
            SceneError: there is no such frame, or it is attached to no link.
        """
        for _ in range(len(self.elements) + 1):
            if name == WORLD_LINK or (name in self.elements and self.elements[name].tag == "link"):
                return name
            if name not in self.attached:
                raise _unknown(name, element, self.elements)
            name = self.attached[name]
        raise element.refuse(f"{quoted(name)} is attached to itself")

    def between(self, start: str, end: str, element: Element) -> Pose:
        """Return the pose of one frame in another. O(depth).

        Raises:
            SceneError: there is no such frame, or one is placed relative to itself.
        """
        up, down = self._upward(start, element), self._upward(end, element)
        while len(up) > 1 and len(down) > 1 and up[-2][0] == down[-2][0]:
            up.pop()
            down.pop()
        return _composed(up).inverse() @ _composed(down) if len(up) > 1 else _composed(down)

    def _upward(self, name: str, element: Element) -> list[tuple[str, Pose]]:
        """Return the frames from one up to the world, each with its pose in the next."""
        found = []
        while name != WORLD_LINK:
            if name not in self.above:
                raise _unknown(name, element, self.elements)
            on, pose = self.above[name]
            found.append((name, pose))
            if len(found) > len(self.above):
                raise element.refuse(f"{quoted(name)} is placed relative to itself")
            name = on
        return [*found, (WORLD_LINK, Pose.identity())]


def _composed(upward: list[tuple[str, Pose]]) -> Pose:
    """Return the pose of the first frame in the last."""
    at = Pose.identity()
    for _, pose in upward[-2::-1]:
        at = at @ pose
    return at


def _unknown(name: str, element: Element, known: Mapping[str, Element]) -> SceneError:
    if "::" in name:
        return element.refuse(f"no frame {quoted(name)}: nested models are not read")
    return element.refuse(f"no link, joint or frame {quoted(name)}.{hint(name, known)}")


def sdf_frames(model: Element) -> SdfFrames:
    """Return the frames of a model.

    Raises:
        SceneError: a name is missing or used twice.
    """
    elements: dict[str, Element] = {}
    attached, above = {}, {MODEL_FRAME: (WORLD_LINK, pose_in(model.first("pose")))}
    links = [child for child in model.children if child.tag == "link"]
    if links:
        attached[MODEL_FRAME] = model.attributes.get("canonical_link") or attributes.name(links[0])
    for element in model.children:
        if element.tag not in ("link", "joint", "frame"):
            continue
        name = attributes.name(element)
        if name in (WORLD_LINK, MODEL_FRAME) or name in elements:
            where = f"first used in line {elements[name].line}" if name in elements else "which the format reserves"
            raise element.refuse(f"expected a unique name, got {quoted(name)}, {where}")
        elements[name] = element
        on = MODEL_FRAME
        if element.tag == "joint":
            on = text_of(element.required("child"))
        elif element.tag == "frame":
            on = element.attributes.get("attached_to") or MODEL_FRAME
        attached[name] = on
        pose = element.first("pose")
        stated = "" if pose is None else pose.attributes.get("relative_to", "")
        above[name] = (stated or on, pose_in(pose))
    return SdfFrames(elements, attached, above)
