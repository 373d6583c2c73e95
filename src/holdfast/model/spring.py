"""Springs and dampers between two points of the world, links and the object.

d = x_b - x_a,  s = |d|,  ds/dt = d . (v_b - v_a) / s,  f_a = (k (s - L) + c ds/dt) d / s = -f_b
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from holdfast.model import checks
from holdfast.model.force_element import EndLoad, EndMotion, ForceElement
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED
from holdfast.spatial.scalar import Array, Scalar, sqrt, where


@called
@dataclass(frozen=True, eq=False)
class Spring(ForceElement):
    """A massless spring and damper along the line between two points.

    Its tension is k (s - L) + c ds/dt with the distance s of the points. With natural length 0 it is a linear spring in
    every direction. With another length it exerts no force while its ends coincide, because it has no direction then.

    Attributes:
        a: one end, ("world", point), ("object", point), (arm, link, point) or ("trunk", link, point). The link is
            given by its name or its number from 0 at the base, or is "base" for a floating body. The point is in the
            frame of its body [m].
        b: the other end, likewise.
        stiffness: k >= 0 [N/m].
        length: natural length L >= 0 [m].
        damping: c >= 0 [N s/m].
    """

    stiffness: float = REQUIRED
    length: float = 0.0
    damping: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for quantity in ("stiffness", "length", "damping"):
            given = getattr(self, quantity)
            object.__setattr__(self, quantity, checks.number(given, f"spring: {quantity}", at_least=0.0))

    def between(self, a: EndMotion, b: EndMotion) -> Elongation:
        """Return the elongation of the spring between two ends."""
        d = b.position - a.position
        square = d @ d
        length = sqrt(square)
        direction = d / where(square > 0.0, length, 1.0)
        return Elongation(self, length, direction @ (b.velocity - a.velocity), direction)


class Elongation(NamedTuple):
    """A spring at one instant.

    Attributes:
        spring: the spring.
        length: s [m].
        rate: ds/dt [m/s]; 0 if the ends coincide.
        direction: (3,) unit vector from a to b; 0 if the ends coincide.
    """

    spring: Spring
    length: Scalar
    rate: Scalar
    direction: Array

    def loads(self) -> tuple[EndLoad, EndLoad]:
        """Return the pull on both ends."""
        tension = self.spring.stiffness * (self.length - self.spring.length) + self.spring.damping * self.rate
        pull = tension * self.direction
        return EndLoad(pull), EndLoad(-pull)

    def energy(self) -> Scalar:
        """Return 1/2 k (s - L)^2 [J]."""
        return 0.5 * self.spring.stiffness * (self.length - self.spring.length) ** 2

    def loss(self) -> Scalar:
        """Return c (ds/dt)^2 [W]."""
        return self.spring.damping * (self.rate * self.rate)
