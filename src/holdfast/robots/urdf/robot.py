"""A robot as a URDF file describes it: a tree of links and joints, plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from holdfast.model.joint_types import JOINT_TYPES
from holdfast.robots.urdf.document import Element
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

MOVING = {urdf: kind for kind, row in JOINT_TYPES.items() for urdf in row.urdf}  # kinds of `Joint` by URDF type
PLANAR = "planar"  # read as three joints of one freedom
UNSUPPORTED = ("floating", "ball", "spherical")


@dataclass(frozen=True, eq=False)
class UrdfInertial:
    """Mass, mass centre and inertia of a link.

    Attributes:
        mass: [kg].
        com: (3,) mass centre in link axes [m].
        inertia: (3, 3) about the mass centre, link axes [kg m^2].
        element: the <inertial>.
    """

    mass: float
    com: Array
    inertia: Array
    element: Element = field(repr=False)


@dataclass(frozen=True, eq=False)
class UrdfLink:
    """A link.

    Attributes:
        name: its name.
        inertial: mass, mass centre and inertia; None if the file gives none.
        element: the <link>.
        notes: what of it was read differently from what the file states, or not at all.
    """

    name: str
    inertial: UrdfInertial | None
    element: Element = field(repr=False)
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Mimic:
    """q = multiplier q_joint + offset.

    Attributes:
        joint: the name of the joint that is followed.
        multiplier: [1].
        offset: [rad or m].
    """

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint.

    Attributes:
        name: its name.
        kind: "revolute", "continuous", "prismatic", "fixed", or one that no arm can have.
        parent: name of the link it is on.
        child: name of the link it moves.
        origin: pose of the child frame in the parent frame at q = 0.
        axis: (3,) unit vector in child axes.
        position_limits: lowest and highest q [rad or m]; infinite if the file gives none.
        rate_limit: largest |qd| [rad/s or m/s]; infinite if the file gives none.
        effort_limit: largest |tau| [N m or N]; infinite if the file gives none.
        damping: [N m s/rad or N s/m].
        friction: [N m or N].
        stiffness, rest: of a spring in it [N m/rad or N/m, rad or m]; SDF's names, which many URDFs use.
        mimic: the joint it follows, or None.
        element: the <joint>.
        notes: what of it was read differently from what the file states, or not at all.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Pose
    axis: Array
    position_limits: tuple[float, float]
    rate_limit: float
    effort_limit: float
    damping: float
    friction: float
    stiffness: float
    rest: float
    mimic: Mimic | None
    element: Element = field(repr=False)
    notes: tuple[str, ...]

    @property
    def is_fixed(self) -> bool:
        """Whether it never moves."""
        return self.kind == "fixed"

    @property
    def turns(self) -> bool:
        """Whether its position is an angle [rad]; else it is a length [m]."""
        return self.kind not in MOVING or JOINT_TYPES[MOVING[self.kind]].turns

    def other(self, link: str) -> str:
        """Return the name of the link on its other side."""
        return self.child if link == self.parent else self.parent


@dataclass(frozen=True, eq=False)
class UrdfRobot:
    """A tree of links and joints.

    Attributes:
        name: its name.
        links: by name, in the file's order.
        joints: by name, in the file's order.
        root: the name of the link that no joint moves.
        element: the <robot>.
        notes: what of the <robot> itself was not read.
        folder: that relative names of meshes start from; empty for a text that came without a file.
    """

    name: str
    links: Mapping[str, UrdfLink]
    joints: Mapping[str, UrdfJoint]
    root: str
    element: Element = field(repr=False)
    notes: tuple[str, ...]
    folder: str = ""

    @cached_property
    def joint_above(self) -> Mapping[str, UrdfJoint]:
        """The joint whose child a link is, by link; the root has none."""
        return {joint.child: joint for joint in self.joints.values()}

    @cached_property
    def joints_below(self) -> Mapping[str, tuple[UrdfJoint, ...]]:
        """The joints whose parent a link is, by link."""
        below: dict[str, list[UrdfJoint]] = {link: [] for link in self.links}
        for joint in self.joints.values():
            below[joint.parent].append(joint)
        return {link: tuple(joints) for link, joints in below.items()}

    def joints_at(self, link: str) -> tuple[UrdfJoint, ...]:
        """Return all joints of a link, the one above it first."""
        above = self.joint_above.get(link)
        return self.joints_below[link] if above is None else (above, *self.joints_below[link])


_INDENT = 2
_DEEPEST = 40  # levels that are shown by indentation; long chains stay readable


def urdf_tree(robot: UrdfRobot) -> str:
    """Return one line a link, children indented below parents, with the joint that moves it.

        base
          shoulder   joint1: revolute, -2.9 to 2.9 rad, 2.2 rad/s, 87 N m

    O(links).
    """
    lines, waiting = [], [(robot.root, 0)]
    while waiting:
        link, depth = waiting.pop()
        lines.append(" " * (_INDENT * min(depth, _DEEPEST)) + link + _moved_by(robot, link))
        waiting += [(joint.child, depth + 1) for joint in reversed(robot.joints_below[link])]
    return "\n".join(lines)


def _moved_by(robot: UrdfRobot, link: str) -> str:
    """Return the joint above a link and its limits, as far as the file gives them."""
    joint = robot.joint_above.get(link)
    if joint is None:
        return ""
    length, force = ("m", "N") if not joint.turns else ("rad", "N m")
    low, high = joint.position_limits
    facts = [joint.kind]
    if low > -float("inf") or high < float("inf"):
        facts.append(f"{low:g} to {high:g} {length}")
    if joint.rate_limit < float("inf"):
        facts.append(f"{joint.rate_limit:g} {length}/s")
    if joint.effort_limit < float("inf"):
        facts.append(f"{joint.effort_limit:g} {force}")
    if joint.mimic is not None:
        facts.append(f"follows {joint.mimic.joint}")
    return f"   {joint.name}: {', '.join(facts)}"
