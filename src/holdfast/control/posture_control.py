"""Posture of redundant arms: a spring to a rest posture, damping, and repulsion from joint limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.control.law_parts import LawInput, NullMotion
from holdfast.errors import ModelError
from holdfast.forces.margins import joint_limits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import NOT_GIVEN, OptionalArrayField
from holdfast.spatial.scalar import Array, Scalar, array, maximum


@called
@dataclass(frozen=True, eq=False)
class PostureControl(NullMotion):
    """Joint accelerations towards a posture and away from joint limits, qdd = -2 w qd + w^2 (q_rest - q + r).

    Only what moves no grasp acts; object and grasp wrenches stay the same. r is zero far from the limits; within a
    part c of the range at either end, r = c range (1 - distance / (c range))^2 inwards. Joints of a trunk follow their
    wish entirely, and the arms on it compensate.

    Attributes:
        rest: q_rest, (n,); None for no spring.
        frequency: w [rad/s].
        clearance: c, the part of a joint's range from which its limits repel, at most 0.5; 0 for no repulsion.

    Raises:
        ModelError: a number is out of range.

    Reference:
        Khatib, A unified approach for motion and force control of robot manipulators, 1987, section VI.
    """

    rest: OptionalArrayField = NOT_GIVEN
    frequency: float = 5.0
    clearance: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        if self.rest is not None:
            put(self, "rest", checks.vector(self.rest, "posture: rest"))
        put(self, "frequency", checks.number(self.frequency, "posture: frequency", at_least=0.0))
        put(self, "clearance", checks.number(self.clearance, "posture: clearance", at_least=0.0))
        if self.clearance > 0.5:
            raise ModelError(
                f"posture: clearance: expected at most 0.5, the middle of the range, got {self.clearance:g}"
            )

    def require(self, chain: ClosedChain) -> None:
        """Refuse a chain with another number of joints."""
        if self.rest is not None and self.rest.shape != (chain.joint_count,):
            raise ModelError(f"posture: rest: expected shape ({chain.joint_count},), got {self.rest.shape}")

    def joint_acceleration(self, x: LawInput) -> Array:
        """Return the wished joint accelerations, (n,)."""
        w = self.frequency
        return w * w * self.displacement(x.motion.chain, x.state.q) - 2.0 * w * x.state.qd

    def displacement(self, chain: ClosedChain, q: Array) -> Array:
        """Return q_rest - q + r, (n,)."""
        pull = np.zeros(len(q)) if self.rest is None else self.rest - q
        if self.clearance:
            limits = joint_limits(chain)
            pull = pull + array([self._away(at, *ends) for at, *ends in zip(q, limits.low, limits.high, strict=True)])
        return pull

    def _away(self, q: Scalar, low: float, high: float) -> Scalar:
        """Return the displacement r of one joint."""
        width = self.clearance * (high - low)
        if not 0.0 < width < np.inf:
            return 0.0
        near = [maximum(1.0 - (q - low) / width, 0.0), maximum(1.0 - (high - q) / width, 0.0)]
        return width * (near[0] * near[0] - near[1] * near[1])
