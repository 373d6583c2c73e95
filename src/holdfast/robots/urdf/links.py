"""<link> elements."""

from __future__ import annotations

import numpy as np

from holdfast.robots.urdf import attributes
from holdfast.robots.urdf.document import Element
from holdfast.robots.urdf.robot import UrdfInertial, UrdfLink
from holdfast.robots.urdf.vocabulary import read_words
from holdfast.spatial.inertia import turned
from holdfast.spatial.scalar import Array

SMALLEST_RADIUS = 1e-8  # [m] of gyration; iCub's exporter leaves 1e-35 to 1e-18 kg m^2 beside zeros, which no body has


def read_link(element: Element) -> UrdfLink:
    """Return a link; without <inertial> it weighs nothing."""
    notes = list(read_words(element))
    inertial = element.first("inertial")
    if inertial is None:
        return UrdfLink(attributes.name(element), None, element, tuple(notes))
    notes += read_words(inertial)
    for part in inertial.children:
        notes += read_words(part) if part.tag in ("origin", "mass", "inertia") else ()
    return UrdfLink(attributes.name(element), _inertial(inertial, notes), element, tuple(notes))


def _inertial(element: Element, notes: list[str]) -> UrdfInertial:
    """Return mass, mass centre and inertia, turned into link axes; an inertia that is only rounding is 0."""
    mass = attributes.number(element.required("mass"), "value", size=attributes.LARGEST)
    moments = element.required("inertia")
    J = _symmetric(moments)
    if J.any() and np.abs(J).max() <= mass * SMALLEST_RADIUS**2:
        notes.append(moments.said(f"inertia up to {np.abs(J).max():g} kg m^2, taken as 0"))
        J = np.zeros((3, 3))
    at = attributes.pose(element.first("origin"))
    return UrdfInertial(mass, at.p, turned(J, at.R), element)


def _symmetric(moments: Element) -> Array:
    """Return the (3, 3) matrix; entries below the diagonal may be given too, and must agree."""
    xx, xy, xz, yy, yz, zz = (
        attributes.number(moments, key, size=attributes.LARGEST) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    for mirror, key, value in (("iyx", "ixy", xy), ("izx", "ixz", xz), ("izy", "iyz", yz)):
        if (again := attributes.number(moments, mirror, value)) != value:
            raise moments.refuse(f"{mirror}: expected {key}, {value!r}, since an inertia is symmetric, got {again!r}")
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
