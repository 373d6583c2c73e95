"""The mass, mass centre and inertia of a link in its own axes."""

from __future__ import annotations

import numpy as np

from holdfast.robots.urdf.document import Element
from holdfast.robots.urdf.robot import UrdfInertial
from holdfast.spatial.inertia import turned
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

SMALLEST_RADIUS = 1e-8  # [m] of gyration; iCub's exporter writes 1e-35 to 1e-18 kg m^2 instead of zeros


def link_inertial(element: Element, mass: float, J: Array, at: Pose, notes: list[str]) -> UrdfInertial:
    """Return the mass, mass centre and inertia of a link; an inertia that is only rounding becomes 0, and is noted.

    Args:
        element: the <inertial> element.
        mass: mass [kg].
        J: (3, 3) inertia about the mass centre, in the axes of the inertial frame [kg m^2].
        at: pose of the inertial frame in the link.
        notes: gets the note.
    """
    if J.any() and np.abs(J).max() <= mass * SMALLEST_RADIUS**2:
        moments = element.first("inertia") or element
        notes.append(moments.message(f"inertia up to {np.abs(J).max():g} kg m^2, taken as 0"))
        J = np.zeros((3, 3))
    return UrdfInertial(mass, at.p, turned(J, at.R), element)
