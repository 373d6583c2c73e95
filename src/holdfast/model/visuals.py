"""What arms and trunks look like, as far as their files say: boxes, cylinders, spheres and mesh files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from holdfast.spatial.frozen import Frozen
from holdfast.spatial.pose import Pose

Rgba = tuple[float, float, float, float]


@dataclass(frozen=True)
class Box:
    """A box, centred.

    Attributes:
        size: edges along x, y, z [m].
    """

    size: tuple[float, float, float]


@dataclass(frozen=True)
class Cylinder:
    """A cylinder about z, centred.

    Attributes:
        radius: [m].
        length: [m].
    """

    radius: float
    length: float


@dataclass(frozen=True)
class Capsule:
    """A cylinder about z with half spheres on both ends, centred.

    Attributes:
        radius: [m].
        length: of the cylinder alone [m].
    """

    radius: float
    length: float


@dataclass(frozen=True)
class Sphere:
    """A sphere, centred.

    Attributes:
        radius: [m].
    """

    radius: float


@dataclass(frozen=True)
class Mesh:
    """A mesh in a file of its own.

    Attributes:
        filename: as the file says, `package://` and relative paths included.
        scale: along x, y, z.
    """

    filename: str
    scale: tuple[float, float, float]


Shape = Box | Cylinder | Capsule | Sphere | Mesh


@dataclass(frozen=True, eq=False)
class Visual(Frozen):
    """One piece of what a link looks like.

    Attributes:
        link: name of the URDF link it belongs to.
        pose: in the frame of the arm's base or link.
        shape: what it is.
        rgba: colour, 0 to 1 each; None if the file gives none.
    """

    link: str
    pose: Pose
    shape: Shape
    rgba: Rgba | None


@dataclass(frozen=True, eq=False)
class Visuals(Frozen):
    """What an arm, or a trunk, looks like; nothing that is computed depends on it.

    Attributes:
        bodies: what its base, then each of its N links, consists of.
        folder: that the names of mesh files start from; empty where there is none.
    """

    bodies: Sequence[Sequence[Visual]]
    folder: str = ""
