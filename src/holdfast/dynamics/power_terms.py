"""The terms of the power that moves a mechanism."""

from __future__ import annotations

from typing import NamedTuple

from holdfast.spatial.scalar import Scalar


class Power(NamedTuple):
    """Power into the chain [W], without gravity and springs, whose work is in the potential energy.

    Attributes:
        drives: power tau . qd of the actuators.
        damping: power of all dampers, never positive: -sum d qd^2 in the joints, -sum c (ds/dt)^2 in the springs
            and -sum V . C V in the bushings.
        base: power sum F_b . V_b of the base wrenches.
        external: power of the external wrenches on object and links.
    """

    drives: Scalar
    damping: Scalar
    base: Scalar
    external: Scalar

    @property
    def total(self) -> Scalar:
        """d(T + U)/dt [W]."""
        return self.drives + self.damping + self.base + self.external
