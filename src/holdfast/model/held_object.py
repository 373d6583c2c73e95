"""The object that the arms hold."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from holdfast.model import checks
from holdfast.spatial import inertia as spatial_inertia
from holdfast.spatial.converted import ArrayField, making
from holdfast.spatial.frozen import Frozen, frozen_property
from holdfast.spatial.inertia import RigidInertia


@dataclass(frozen=True, eq=False)
class HeldObject(Frozen):
    """A rigid body with origin C, which need not be its mass centre.

    Attributes:
        mass: > 0 [kg].
        com: (3,) mass centre from C, object axes [m].
        inertia: (3, 3) about the mass centre, object axes, positive definite [kg m^2].
        physical: False accepts principal moments that no mass distribution has.
    """

    mass: float
    inertia: ArrayField
    com: ArrayField = field(default_factory=making(np.zeros, 3))
    physical: bool = True

    def __post_init__(self) -> None:
        put = object.__setattr__
        checks.instance(self.physical, bool, "object: physical")
        put(self, "mass", checks.number(self.mass, "object: mass", above=0.0))
        put(self, "com", checks.numbers(self.com, (3,), "object: com"))
        put(
            self,
            "inertia",
            checks.rotational_inertia(self.inertia, "object: inertia", definite=True, physical=self.physical),
        )

    @staticmethod
    def box(mass: float, x: float, y: float, z: float) -> HeldObject:
        """Return a solid box of uniform density with C at its centre; edges > 0 [m]."""
        x, y, z = (checks.number(edge, f"box: {name}", above=0.0) for name, edge in (("x", x), ("y", y), ("z", z)))
        m = checks.number(mass, "object: mass", above=0.0)
        return HeldObject(m, m / 12 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y]))

    @frozen_property
    def spatial_inertia(self) -> RigidInertia:
        """M(C): the inertia about C, object axes."""
        return spatial_inertia.about_origin(self.mass, self.com, self.inertia)
