"""`holding_torques` as a control law, which can be compiled by `compile_law` and used in rollouts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from holdfast.control.balanced_torques import FEASIBLE, balanced, pushes
from holdfast.control.controller import ControlLaw
from holdfast.control.holding_torques import holding_torques
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.errors import MethodNotApplicable
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.model.serial_chain import serial_chain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar, less, where
from holdfast.state import Inputs, State


def holding_law(chain: ClosedChain, *, each_arm: bool = False) -> ControlLaw:
    """Return the law of `holding_torques`, with `acceleration` (6,) and `internal_force` as its parameters.

    `compile_law(holding_law(chain), chain)` compiles it, for one system, with bound arrays, or for a batch. If
    `holding_torques` would raise an error, so does a call for one system; in batches, bound calls and rollouts, the
    torques are NaN. All joints must be driven; for passive joints use `holding_torques` itself.

    Args:
        chain: arms, object and grasps.
        each_arm: whether `internal_force` are wrenches (arms, 6); by default it is one push of every arm [N].

    Raises:
        ModelError: `chain` is not a ClosedChain.
        MethodNotApplicable: the base of the chain floats, or no arm has a grasp.
    """
    serial_chain(chain, "holding law: chain")
    for refused, what in ((chain.floats, "a floating base, which no drive holds"), (not chain.grasps, "no grasp")):
        if refused:
            raise MethodNotApplicable(
                f"holding_law: expected driven arms that hold the object, got a chain with {what}; try"
                " holdfast.holding_torques, which decides state by state"
            )
    torque = HoldingTorques(chain)
    parameters = {"acceleration": (6,), "internal_force": (len(chain.arms), 6) if each_arm else ()}
    return ControlLaw(torque, parameters=parameters, key=exact_fingerprint(torque) or "")


@dataclass(frozen=True, eq=False)
class HoldingTorques(Frozen):
    """The torques of `holding_law`.

    Attributes:
        chain: the chain.
    """

    chain: ClosedChain

    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques (n,) and the memory; on floats, the errors are those of `holding_torques`."""
        acceleration, internal_force = given["acceleration"], given["internal_force"]
        if state.q.dtype != object:
            return holding_torques(self.chain, state, acceleration, internal_force), memory
        motion = chain_motion(self.chain, state, np.zeros(self.chain.joint_count), Inputs().shaped(self.chain))
        wished = internal_force if np.ndim(internal_force) else pushes(motion, internal_force[()])
        found = balanced(motion, acceleration, wished)
        good = where(less(FEASIBLE * found.size, found.left), 0.0, 1.0)
        for gap, size in found.missed:
            good = where(less(FEASIBLE * size, gap), 0.0, good)
        return found.tau / good * good, memory  # 0 / 0 gives NaN if the torques are invalid
