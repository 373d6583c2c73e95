"""Visuals of arms and trunks according to their files: boxes, cylinders, spheres and mesh files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from holdfast.spatial.frozen import Frozen, FrozenDict
from holdfast.spatial.pose import Pose

Rgba = tuple[float, float, float, float]


@dataclass(frozen=True)
class Box:
    """A box, centred at the origin.

    Attributes:
        size: edge lengths along x, y, z [m].
    """

    size: tuple[float, float, float]


@dataclass(frozen=True)
class Cylinder:
    """A cylinder about the z axis, centred at the origin.

    Attributes:
        radius: radius [m].
        length: length [m].
    """

    radius: float
    length: float


@dataclass(frozen=True)
class Capsule:
    """A cylinder about the z axis with hemispheres on both ends, centred at the origin.

    Attributes:
        radius: radius [m].
        length: length of the cylinder without the hemispheres [m].
    """

    radius: float
    length: float


@dataclass(frozen=True)
class Sphere:
    """A sphere, centred at the origin.

    Attributes:
        radius: radius [m].
    """

    radius: float


@dataclass(frozen=True)
class Mesh:
    """A mesh in a separate file.

    Attributes:
        filename: name as written in the robot's file, which may be a relative path or begin with `package://`.
        scale: scale factors along x, y, z.
    """

    filename: str
    scale: tuple[float, float, float]


VisualShape = Box | Cylinder | Capsule | Sphere | Mesh


@dataclass(frozen=True, eq=False)
class Visual(Frozen):
    """One visual element of a link.

    Attributes:
        link: name of the URDF link to which it belongs.
        pose: pose in the frame of the arm's base or link.
        shape: shape of the element.
        rgba: colour with components from 0 to 1; None if the file gives none.
    """

    link: str
    pose: Pose
    shape: VisualShape
    rgba: Rgba | None


@dataclass(frozen=True, eq=False)
class Visuals(Frozen):
    """The appearance of an arm or a trunk, which does not affect any results.

    Attributes:
        bodies: visual elements of its base and of each of its N links.
        folder: folder to which the names of mesh files are relative; empty if there is none.
        packages: folders of the packages that these names refer to, by name, as far as they were given or found.
    """

    bodies: Sequence[Sequence[Visual]]
    folder: str = ""
    packages: Mapping[str, str] = field(default_factory=FrozenDict)
