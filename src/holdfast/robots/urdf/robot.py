"""The tree of links and joints that a URDF file describes, as plain data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from holdfast.errors import SceneError
from holdfast.model.closure import Closure
from holdfast.model.joint import UNBOUNDED
from holdfast.model.joint_types import JOINT_TYPES
from holdfast.robots.urdf.document import Element
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

MOVABLE = {urdf: kind for kind, row in JOINT_TYPES.items() for urdf in row.urdf}  # kinds of `Joint` by URDF type
TYPES = tuple(MOVABLE)  # of URDF itself
SDF_BALL, SDF_SCREW = "sdf:ball", "sdf:screw"  # kinds that only SDF files have
MOVABLE |= {SDF_BALL: "spherical", SDF_SCREW: "screw"}
PLANAR = "planar"  # read as three joints with one degree of freedom
UNSUPPORTED = ("floating", "ball", "spherical")
WORLD_LINK = "world"  # end of a coupling that is attached to no link


@dataclass(frozen=True, eq=False)
class UrdfInertial:
    """The mass, mass centre and inertia of a link.

    Attributes:
        mass: mass [kg].
        com: (3,) mass centre in link axes [m].
        inertia: (3, 3) inertia about the mass centre, link axes [kg m^2].
        element: the <inertial> element.
    """

    mass: float
    com: Array
    inertia: Array
    element: Element = field(repr=False)


@dataclass(frozen=True, eq=False)
class UrdfLink:
    """A link of a URDF file.

    Attributes:
        name: its name.
        inertial: mass, mass centre and inertia; None if the file gives none.
        element: the <link> element.
        notes: notes on what was not read, or was interpreted differently from the file.
        fault: why it cannot be part of a body that moves, such as a mass without inertia; None if it can.
        weightless: the element that switches gravity off for it; None if it has weight.
    """

    name: str
    inertial: UrdfInertial | None
    element: Element = field(repr=False)
    notes: tuple[str, ...]
    fault: SceneError | None = None
    weightless: Element | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Mimic:
    """A joint that mimics another, q = multiplier q_joint + offset.

    Attributes:
        joint: name of the joint that is mimicked.
        multiplier: factor [1].
        offset: offset [rad or m].
    """

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint of a URDF file.

    Attributes:
        name: its name.
        kind: "revolute", "continuous", "prismatic", "fixed", "sdf:ball", "sdf:screw", or a type that arms cannot have.
        parent: name of the parent link.
        child: name of the link that it moves.
        origin: pose of the child frame in the parent frame at q = 0.
        axis: (3,) unit vector in child axes.
        element: the <joint> element.
        notes: notes on what was not read, or was interpreted differently from the file.
        position_limits: lowest and highest q [rad or m]; infinite if the file gives none.
        rate_limit: largest |qd| [rad/s or m/s]; infinite if the file gives none.
        effort_limit: largest |tau| [N m or N]; infinite if the file gives none.
        damping: viscous damping [N m s/rad or N s/m].
        friction: Coulomb friction [N m or N].
        stiffness, rest: stiffness and rest position of a spring [N m/rad or N/m, rad or m], which many URDF files give
            with the names of SDF.
        armature: inertia of the rotors of its drives, reflected to the joint [kg m^2 or kg].
        pitch: translation along the axis per radian, for a screw [m/rad]; None for others.
        mimic: the joint that it mimics, or None.
        fault: why it cannot move, an error in its axis, limits or drive, which do not matter if it is locked; or None.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Pose
    axis: Array
    element: Element = field(repr=False)
    notes: tuple[str, ...]
    position_limits: tuple[float, float] = UNBOUNDED
    rate_limit: float = math.inf
    effort_limit: float = math.inf
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    armature: float = 0.0
    pitch: float | None = None
    mimic: Mimic | None = None
    fault: SceneError | None = None

    @property
    def is_fixed(self) -> bool:
        """Whether the joint is fixed."""
        return self.kind == "fixed"

    @property
    def turns(self) -> bool:
        """Whether its position is an angle [rad]; otherwise it is a length [m]."""
        return self.kind not in MOVABLE or JOINT_TYPES[MOVABLE[self.kind]].turns

    def other(self, link: str) -> str:
        """Return the name of the link on its other side."""
        return self.child if link == self.parent else self.parent


@dataclass(frozen=True, eq=False)
class UrdfCoupling:
    """An element that couples bodies beyond the tree: a loop, a spring between links, a drive of several joints.

    Attributes:
        element: the element.
        links: names of the links that it couples, or "world".
        joints: names of the joints that it couples.
        closure: the loop that it closes between two links, by their names, which an arm with branches can have; None
            for what no arm can have.
    """

    element: Element = field(repr=False)
    links: frozenset[str] = frozenset()
    joints: frozenset[str] = frozenset()
    closure: Closure | None = None


@dataclass(frozen=True, eq=False)
class UrdfRobot:
    """A tree of links and joints.

    Attributes:
        name: its name.
        links: links by name, in the file's order.
        joints: joints by name, in the file's order.
        root: name of the root link.
        element: the <robot> element.
        notes: one sentence for each part of the <robot> element itself that was ignored.
        folder: folder to which relative names of meshes refer; "" for a text without a file.
        packages: folders of packages by name, as given or as found by xacro.
        couplings: what couples bodies beyond the tree.
    """

    name: str
    links: Mapping[str, UrdfLink]
    joints: Mapping[str, UrdfJoint]
    root: str
    element: Element = field(repr=False)
    notes: tuple[str, ...]
    folder: str = ""
    packages: Mapping[str, str] = field(default_factory=FrozenDict)
    couplings: tuple[UrdfCoupling, ...] = ()

    @cached_property
    def joint_above(self) -> Mapping[str, UrdfJoint]:
        """The joint above each link, by link name; the root has none."""
        return {joint.child: joint for joint in self.joints.values()}

    @cached_property
    def joints_below(self) -> Mapping[str, tuple[UrdfJoint, ...]]:
        """The joints below each link, by link name."""
        below: dict[str, list[UrdfJoint]] = {link: [] for link in self.links}
        for joint in self.joints.values():
            below[joint.parent].append(joint)
        return {link: tuple(joints) for link, joints in below.items()}

    def joints_at(self, link: str) -> tuple[UrdfJoint, ...]:
        """Return all joints of a link, beginning with the one above it."""
        above = self.joint_above.get(link)
        return self.joints_below[link] if above is None else (above, *self.joints_below[link])


_INDENT = 2
_DEEPEST = 40  # levels that are shown by indentation; long chains stay readable


def urdf_tree(robot: UrdfRobot) -> str:
    """Return one line per link with the joint that moves it; children are indented below their parents.

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
    if joint.position_limits != UNBOUNDED:
        facts.append(f"{low:g} to {high:g} {length}")
    if joint.rate_limit < math.inf:
        facts.append(f"{joint.rate_limit:g} {length}/s")
    if joint.effort_limit < math.inf:
        facts.append(f"{joint.effort_limit:g} {force}")
    if joint.mimic is not None:
        facts.append(f"follows {joint.mimic.joint}")
    return f"   {joint.name}: {', '.join(facts)}"
