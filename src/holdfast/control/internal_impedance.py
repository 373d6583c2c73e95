"""Impedance of the grasps against each other: springs between where tips are and where the model has them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from holdfast.compiler.program import Shape
from holdfast.control.gains import gain_matrix
from holdfast.control.internal_force import InternalForce
from holdfast.control.law_parts import GraspForces, LawInput
from holdfast.dynamics.grasp_gap import position_gap
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, ArrayField, making
from holdfast.spatial.scalar import Array, array


@called
@dataclass(frozen=True, eq=False)
class InternalImpedance(GraspForces):
    """Springs and dampers between arms, f_i = f_i,d + K_int e_i + D_int e_i'.

    e_i is the displacement [rotation vector; shift] that would bring the tip of arm i to its contact on the object, as
    the controller's model has it, and e_i' its rate. It is zero for an exact model; errors of the assumed grasps or of
    the kinematics give internal forces of K_int times the error, whatever the stiffness of arms and object.

    Attributes:
        stiffness: K_int, (6, 6) world axes, its diagonal (6,), or one number for all [N m/rad, N/m].
        damping: D_int, likewise [N m s/rad, N s/m].
        around: f_d, grasp forces without memory; by default none beyond the smallest.

    Raises:
        ModelError: a matrix is not symmetric or not positive semidefinite, or `around` is none of grasp forces.

    Reference:
        Caccavale, Chiacchio, Marino and Villani, Six-DOF impedance control of dual-arm cooperative manipulators,
        T-Mech 2008; Erhart and Hirche 2013.
    """

    stiffness: ArrayField = REQUIRED
    damping: ArrayField = REQUIRED
    around: GraspForces = field(default_factory=making(InternalForce))

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping"):
            object.__setattr__(self, name, gain_matrix(getattr(self, name), f"internal impedance: {name}"))
        checks.instance(self.around, GraspForces, "internal impedance: around")

    def parameters(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return those of f_d."""
        return self.around.parameters(chain)

    def require(self, chain: ClosedChain) -> None:
        """Refuse a chain that f_d does not fit, and an f_d with memory."""
        self.around.require(chain)
        if len(self.around.memory(chain)):
            got = type(self.around).__name__
            raise ModelError(f"internal impedance: around: expected grasp forces without memory, got {got}")

    def wished(self, x: LawInput, acceleration: Array) -> Array:
        """Return the wrenches, (arms, 6)."""
        chain, pulled = x.motion.chain, {}
        frame = x.state.object_frame
        for name, c in zip(chain.grasps, x.motion.contacts, strict=True):
            gap = position_gap(c, frame.p + c.offset, x.motion.arms[name].at.tip)
            pulled[name] = self.stiffness @ gap + self.damping @ (c.K.T @ c.velocity_gap)
        own = array([pulled.get(name, np.zeros(6)) for name in chain.names])
        return self.around.wished(x, acceleration) + own

    def commanded(self, x: LawInput, acceleration: Array) -> Array:
        """Return f_d, (arms, 6)."""
        return self.around.commanded(x, acceleration)
