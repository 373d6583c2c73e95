"""A constant internal force: a push of every arm, or chosen wrenches."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from holdfast.control.balanced_torques import pushes
from holdfast.control.law_parts import GraspForces, LawInput
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import ArrayField, making
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import rotate


@called
@dataclass(frozen=True, eq=False)
class InternalForce(GraspForces):
    """The smallest wrenches that move the object, and the internal part of chosen ones.

    Attributes:
        force: push of every arm along its contact normal into the object [N], (arms,) pushes, or wrenches (arms, 6)
            about the contacts along the axes of the contact frames.
    """

    force: ArrayField = field(default_factory=making(np.float64, 0.0))

    def __post_init__(self) -> None:
        object.__setattr__(self, "force", checks.numbers(self.force, None, "internal force"))

    def require(self, chain: ClosedChain) -> None:
        """Refuse a chain with another number of arms."""
        n = len(chain.arms)
        if self.force.shape not in ((), (n,), (n, 6)):
            raise ModelError(f"internal force: expected a number, ({n},) or ({n}, 6), got shape {self.force.shape}")

    def wished(self, x: LawInput, acceleration: Array) -> Array:
        """Return the chosen wrenches, (arms, 6)."""
        if not self.force.ndim:
            return pushes(x.motion, self.force[()])
        chosen = self.force if self.force.ndim == 2 else np.outer(self.force, np.eye(6)[5])
        own = dict(zip(x.motion.chain.names, chosen, strict=True))
        turned = {
            name: rotate(c.R, own[name]) for name, c in zip(x.motion.chain.grasps, x.motion.contacts, strict=True)
        }
        return array([turned.get(name, np.zeros(6)) for name in own])
