"""Posture of redundant arms: a spring to a posture or a joint path, damping, and repulsion from joint limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from holdfast.control.controller import known_breakpoints
from holdfast.control.law_parts import LawInput, NullMotion
from holdfast.control.paths import Joints, Target, path_function
from holdfast.errors import ModelError
from holdfast.forces.margins import joint_limits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import NOT_GIVEN, Converted
from holdfast.spatial.scalar import Array, Scalar, array, maximum


class PathOfJoints(Protocol):
    """Joint positions over time, such as a `JointPath`."""

    def at(self, t: Any) -> Joints:
        """Return positions, rates and accelerations at time t [s], (n,) each."""
        ...


@called
@dataclass(frozen=True, eq=False)
class PostureControl(NullMotion):
    """Joint accelerations towards a posture, away from joint limits, qdd = qdd_d + 2 w (qd_d - qd) + w^2 (q_d - q + r).

    Only what moves no grasp acts; object and grasp wrenches stay the same. r is zero far from the limits; within a
    part c of the range at either end, r = c range (1 - distance / (c range))^2 inwards. Joints of a trunk follow their
    wish entirely, and the arms on it compensate.

    Attributes:
        rest: q_d, (n,), at rest; or a joint path: a function of t [s] that returns (q_d, qd_d, qdd_d), (n,) each, or an
            object such as a `JointPath`, whose method `at` does. None for no spring.
        frequency: w [rad/s].
        clearance: c, the part of a joint's range from which its limits repel, at most 0.5; 0 for no repulsion.

    Raises:
        ModelError: a number is out of range.

    Reference:
        Khatib, A unified approach for motion and force control of robot manipulators, 1987, section VI.
    """

    rest: Converted[Array | Callable[[Any], Any] | None, ArrayLike | Callable[[Any], Joints] | PathOfJoints | None] = (
        NOT_GIVEN
    )
    frequency: float = 5.0
    clearance: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        if callable(self.rest) or hasattr(self.rest, "at"):
            put(self, "rest", path_function(self.rest, "posture: rest"))
        elif self.rest is not None:
            put(self, "rest", checks.vector(self.rest, "posture: rest"))
        put(self, "frequency", checks.number(self.frequency, "posture: frequency", at_least=0.0))
        put(self, "clearance", checks.number(self.clearance, "posture: clearance", at_least=0.0))
        if self.clearance > 0.5:
            raise ModelError(
                f"posture: clearance: expected at most 0.5, the middle of the range, got {self.clearance:g}"
            )

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which its path accelerates by leaps [s], as far as they are known in advance."""
        return known_breakpoints(self.rest)

    def require(self, chain: ClosedChain) -> None:
        """Refuse a chain with another number of joints, and a path of something else."""
        if callable(self.rest):
            self._wish(0.0, np.zeros(chain.joint_count))
        if isinstance(self.rest, np.ndarray) and self.rest.shape != (chain.joint_count,):
            raise ModelError(f"posture: rest: expected shape ({chain.joint_count},), got {self.rest.shape}")

    def joint_acceleration(self, x: LawInput) -> Array:
        """Return the wished joint accelerations, (n,)."""
        w, (off, rates, second) = self.frequency, self.departure(x.motion.chain, x.t, x.state.q)
        return second + 2.0 * w * (rates - x.state.qd) + w * w * off

    def departure(self, chain: ClosedChain, t: Scalar, q: Array) -> Joints:
        """Return q_d - q + r, qd_d and qdd_d at time t [s], (n,) each."""
        wish, rates, second = self._wish(t, q)
        off = wish - q
        if self.clearance:
            limits = joint_limits(chain)
            off = off + array([self._away(at, *ends) for at, *ends in zip(q, limits.low, limits.high, strict=True)])
        return off, rates, second

    def _wish(self, t: Scalar, q: Array) -> Joints:
        """Return q_d, or q if there is none, with its derivatives."""
        none = np.zeros(len(q))
        if not callable(self.rest):
            return q if self.rest is None else self.rest, none, none
        found = self.rest(t)
        if isinstance(found, Target):
            raise ModelError(
                "posture: rest: expected a path of joints, got one of the object; try a plan of `hf.follow`, or"
                " `joints_at` of a timed path"
            )
        if not isinstance(found, tuple) or len(found) != 3:
            raise ModelError(f"posture: rest: expected positions, rates and accelerations, got {checks.short(found)}")
        wish, rates, second = (checks.numbers(x, (len(q),), "posture: rest") for x in found)
        return wish, rates, second

    def _away(self, q: Scalar, low: float, high: float) -> Scalar:
        """Return the displacement r of one joint."""
        width = self.clearance * (high - low)
        if not 0.0 < width < np.inf:
            return 0.0
        near = [maximum(1.0 - (q - low) / width, 0.0), maximum(1.0 - (high - q) / width, 0.0)]
        return width * (near[0] * near[0] - near[1] * near[1])
