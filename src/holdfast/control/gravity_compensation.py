"""Gravity compensation: torques that hold the chain still in any configuration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from holdfast.control.controller import by_machine_code
from holdfast.control.grasp_forces import commanded_wrenches
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.inverse import torques
from holdfast.dynamics.tree.mechanism_inverse import mechanism_holding
from holdfast.dynamics.tree.mechanism_terms import driven_joints
from holdfast.errors import MethodNotApplicable
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit, require_state


@called
@dataclass(frozen=True, eq=False)
class GravityCompensation(Frozen):
    """The static balance of the closed chain, tau = C_gravity + J^T f + stiffness (q - rest) - d qd.

    f are the smallest wrenches that the grasps can transmit to carry the object's weight, plus an internal force. Bases
    are assumed to stand still, and external wrenches are ignored.

    Attributes:
        chain: the controller's model of the chain.
        internal_force: push of every arm along its contact normal into the object [N].
        joint_damping: damping d of every joint [N m s/rad or N s/m].
    """

    chain: ClosedChain
    internal_force: float = 0.0
    joint_damping: float = 0.0
    traceable: ClassVar[bool] = True  # can be compiled to machine code

    def __post_init__(self) -> None:
        checks.instance(self.chain, ClosedChain, "gravity compensation: chain")
        if self.chain.floats and self.chain.gravity.any():
            raise MethodNotApplicable(
                "GravityCompensation: expected a fixed base, got a trunk whose base floats under gravity, which"
                " no actuator holds; try a chain without gravity, or ObjectTracking"
            )
        for name in ("internal_force", "joint_damping"):
            object.__setattr__(self, name, checks.number(getattr(self, name), f"gravity compensation: {name}"))

    def for_chain(self, chain: ClosedChain) -> Self:
        """Return the controller for a chain whose grasps have changed."""
        return replace(self, chain=chain)

    @np.errstate(all="ignore")  # what overflows is refused
    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques (n,) [N m or N]; the memory is not used.

        Raises:
            StateError: they overflow, or the state is none of the chain.
        """
        if answered_as_forest(self.chain):
            require_state(self.chain, state)
            rest = state.at_rest()  # of a stage within a step, which is closed but for the step's error
            held = mechanism_holding(self.chain, rest, None, self.internal_force, check=False)
            return held - self.joint_damping * driven_joints(self.chain) * state.qd, memory
        require_fit(self.chain, state)
        found = by_machine_code(self, t, state, memory)
        if found is not None:
            return found
        none, configuration = np.zeros(self.chain.joint_count), state.at_rest()
        wrenches = commanded_wrenches(self.chain, configuration, np.zeros(6), self.internal_force)
        motion = chain_motion(self.chain, configuration, none, Inputs().shaped(self.chain))
        tau = torques(motion, none, wrenches) - self.joint_damping * state.qd
        return checks.finite(tau, "gravity compensation"), memory
