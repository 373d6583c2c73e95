"""The rigid object that the arms hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import get_args

import numpy as np

from holdfast import outer
from holdfast.model import checks
from holdfast.model.fingerprint import PICTURE
from holdfast.model.visuals import Cylinder, Sphere, VisualShape
from holdfast.names import called
from holdfast.spatial import inertia as spatial_inertia
from holdfast.spatial.frozen import REQUIRED, ArrayField, Frozen, frozen_property, making
from holdfast.spatial.inertia import RigidInertia


@called
@dataclass(frozen=True, eq=False)
class HeldObject(Frozen):
    """A rigid body with origin C, which need not be its mass centre.

    Attributes:
        mass: mass, > 0 [kg].
        com: (3,) mass centre from C, object axes [m].
        inertia: (3, 3) inertia about the mass centre, object axes, positive definite [kg m^2].
        physical: False accepts principal moments that no mass distribution has.
        shape: shape for drawings, about C; None for the box with the same inertia. It does not affect results.
    """

    mass: float
    inertia: ArrayField = REQUIRED
    com: ArrayField = field(default_factory=making(np.zeros, 3))
    physical: bool = True
    shape: VisualShape | None = field(default=None, metadata=PICTURE)

    def __post_init__(self) -> None:
        put = object.__setattr__
        checks.instance(self.physical, bool, "object: physical")
        checks.instance(self.shape, (*get_args(VisualShape), type(None)), "object: shape")
        put(self, "mass", checks.number(self.mass, "object: mass", above=0.0))
        put(self, "com", checks.numbers(self.com, (3,), "object: com"))
        J = checks.rotational_inertia(self.inertia, "object: inertia", definite=True, physical=self.physical)
        put(self, "inertia", J)

    @staticmethod
    def box(mass: float, x: float, y: float, z: float) -> HeldObject:
        """Return a solid box of uniform density with C at its centre; edges > 0 [m]."""
        x, y, z = (checks.number(edge, f"box: {name}", above=0.0) for name, edge in (("x", x), ("y", y), ("z", z)))
        m = checks.number(mass, "object: mass", above=0.0)
        return HeldObject(m, m / 12 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y]))

    @staticmethod
    def sphere(mass: float, radius: float) -> HeldObject:
        """Return a solid sphere of uniform density with C at its centre; radius > 0 [m]."""
        m, r = checks.number(mass, "object: mass", above=0.0), checks.number(radius, "sphere: radius", above=0.0)
        return HeldObject(m, 0.4 * m * r * r * np.eye(3), shape=Sphere(r))

    @staticmethod
    def cylinder(mass: float, radius: float, length: float) -> HeldObject:
        """Return a solid cylinder about z of uniform density with C at its centre; radius and length > 0 [m]."""
        m, r = checks.number(mass, "object: mass", above=0.0), checks.number(radius, "cylinder: radius", above=0.0)
        l = checks.number(length, "cylinder: length", above=0.0)
        across = m * (r * r / 4 + l * l / 12)
        return HeldObject(m, np.diag([across, across, m * r * r / 2]), shape=Cylinder(r, l))

    @staticmethod
    def from_mesh(
        path: str | PathLike[str],
        *,
        mass: float | None = None,
        density: float | None = None,
        scale: float = 1.0,
    ) -> HeldObject:
        """Return the solid of uniform density inside a closed surface; C is the origin of the mesh's frame.

        Args:
            path: an .stl, .obj or .dae file with faces that are counter-clockwise seen from outside.
            mass: mass [kg]; either this or `density` must be given.
            density: density [kg/m^3].
            scale: factor for the lengths in the file, such as 0.001 for millimetres.

        Raises:
            ModelError: both or neither of mass and density are given, or a number is not > 0.
            SceneError: the file cannot be read, or its surface is open, inside out or flat, or encloses places twice
                (shells that overlap, lie within others, or occur twice; a cavity's surface looks inward).
        """
        return outer.held_object_from_mesh(path, mass, density, scale)

    @staticmethod
    def from_urdf(
        path_or_text: str | PathLike[str],
        link: str | None = None,
        *,
        physical: bool = True,
        xacro_args: Mapping[str, str] | None = None,
        trust_xacro: bool = False,
        packages: Mapping[str, str | PathLike[str]] | None = None,
    ) -> HeldObject:
        """Return a link of a URDF file with everything that is fixed to it; C is the origin of the link's frame.

        Args:
            path_or_text: path of the file, or its text.
            link: name of the link; by default the root, if the file has no movable joints.
            physical: False accepts principal moments that no mass distribution has.
            xacro_args: values of the file's <xacro:arg> elements by name.
            trust_xacro: whether to expand a `.xacro` file, which runs the Python code in it.
            packages: folders of packages by name, for `$(find name)` (see `read_urdf`).

        Warns:
            ModelWarning: once, with all notes on what was not read.

        Raises:
            SceneError: the file has an error, the link is unknown, or other links move relative to it.
            MissingExtra: the file is a `.xacro` file, and xacrodoc is not installed.
        """
        how = {"xacro_args": xacro_args, "trust_xacro": trust_xacro, "packages": packages}
        return outer.held_object_from_urdf(path_or_text, link, physical, **how)

    @frozen_property
    def spatial_inertia(self) -> RigidInertia:
        """M(C), the inertia about C, in object axes."""
        return spatial_inertia.about_origin(self.mass, self.com, self.inertia)
