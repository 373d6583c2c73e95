"""Rigid links."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.names import called
from holdfast.spatial import inertia as spatial_inertia
from holdfast.spatial.frozen import ArrayField, Frozen, frozen_property, making
from holdfast.spatial.inertia import RigidInertia


@called
@dataclass(frozen=True, eq=False)
class Link(Frozen):
    """A rigid body moved by one joint; the origin of its frame lies on that joint.

    Attributes:
        mass: mass, >= 0 [kg].
        com: (3,) mass centre in link axes [m].
        inertia: (3, 3) inertia about the mass centre, link axes, positive semidefinite [kg m^2].
        name: name in messages.
        physical: False accepts principal moments that no mass distribution has
            (identified parameters sometimes violate the triangle inequality).
    """

    mass: float
    com: ArrayField = field(default_factory=making(np.zeros, 3))
    inertia: ArrayField = field(default_factory=making(np.zeros, (3, 3)))
    name: str = ""
    physical: bool = True

    def __post_init__(self) -> None:
        checks.name(self.name, "link: name")
        checks.instance(self.physical, bool, "link: physical")
        label = f"link '{self.name}'" if self.name else "link"
        put = object.__setattr__
        put(self, "mass", checks.number(self.mass, f"{label}: mass"))
        if isinstance(self.mass, float) and self.mass < 0:  # the value of a traced mass is not known
            raise ModelError(f"{label}: mass: expected > 0, got {self.mass!r} (0 is allowed for a massless link)")
        put(self, "com", checks.numbers(self.com, (3,), f"{label}: com"))
        what = f"{label}: inertia"
        put(self, "inertia", checks.rotational_inertia(self.inertia, what, physical=self.physical))

    @frozen_property
    def spatial_inertia(self) -> RigidInertia:
        """M(k), the inertia about the link's origin, in link axes."""
        return spatial_inertia.about_origin(self.mass, self.com, self.inertia)
