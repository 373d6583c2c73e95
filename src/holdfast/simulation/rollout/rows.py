"""Systems of machine code as instants, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.compiled.externals import STATE
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_motion, pseudo_gravity
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.indeterminate import with_smallest_forces
from holdfast.dynamics.projection import FARTHEST
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.errors import ClosureError, HoldfastError, SingularChainError, StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.instant import WORST_CONDITION, Instant, friction_torque, joint_friction
from holdfast.simulation.rollout.kernel import Systems
from holdfast.simulation.rollout.traced_step import BROKEN, OPEN, SINGULAR
from holdfast.simulation.step import Gaps
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class Moment:
    """What a system is given from outside at one time.

    Attributes:
        t: time [s].
        chain: its bases where they are.
        inputs: shaped.
        tau: (n,) torques of the controller; None where they are machine code's.
        memory: what the controller carries on.
    """

    t: float
    chain: ClosedChain
    inputs: Inputs
    tau: Array | None
    memory: Any


def state_rows(states: Sequence[State]) -> dict[str, Array]:
    """Return states as arrays with a row each."""
    return {name: np.array([getattr(state, name) for state in states]) for name in STATE}


def state_of(systems: Systems, row: int) -> State:
    """Return one system's state, to the bit."""
    parts = {name: systems[name][row].copy() for name in STATE}
    state = State(**parts)
    # dividing a unit quaternion by its length once more can change its last bit
    object.__setattr__(state, "object_pose", parts["object_pose"])
    return state


def instant_of(systems: Systems, row: int, at: Moment) -> Instant:
    """Return one system as an instant.

    Args:
        systems: after a step, or a step of length zero.
        row: which.
        at: what the system was given.
    """
    x = {name: array[row].copy() for name, array in systems.items()}
    tau, memory = (x["drive"], x.get("memory", at.memory)) if at.tau is None else (at.tau, at.memory)
    chain, state, rank = at.chain, state_of(systems, row), int(x["rank"])
    unique = rank == chain.constraint_row_count
    if not unique:  # machine code gives one solution for the forces, the reference the smallest
        net = tau - friction_torque(joint_friction(chain), state.qd)
        x["grasp_wrench"], x["base_wrench"] = _smallest_forces(chain_motion(chain, state, net, at.inputs), x)
    found = ForwardResult(
        chain,
        x["qdd"],
        x["grasp_wrench"],
        x["object_acceleration"],
        x.get("contact_acceleration", np.zeros(0)),
        x["base_wrench"],
        rank,
        chain.joint_count + 6 + chain.contact_freedom_count - rank,
        Status.OK if unique else Status.INDETERMINATE_FORCES,
        float(x["condition"]),
        "sequential",
        x.get("held_rows"),
    )
    return Instant(at.t, state, chain, at.inputs, tau, memory, found, x["slope"][-4:])


def _smallest_forces(motion: ChainMotion, x: dict[str, Array]) -> tuple[Array, Array]:
    """Return the smallest grasp wrenches with which a system moves as it does, and the base wrenches with them."""
    chain = motion.chain
    found = Solution(
        [x["qdd"][chain.joints[name]] for name in chain.grasps],
        [x["grasp_wrench"][chain.names.index(name)] for name in chain.grasps],
        x["object_acceleration"] - pseudo_gravity(chain),
        rank=int(x["rank"]),
    )
    whole = chain_solution(motion, with_smallest_forces(motion, found), "auto")
    return whole.grasp_wrench, whole.base_wrench


def gaps_of(systems: Systems, row: int) -> Gaps:
    """Return the gaps that projection found and left."""
    drift, left = systems["gaps"][row].reshape(2, 2)
    return Gaps(np.array([drift[0], left[0]]), np.array([drift[1], left[1]]))


def failure(code: float) -> HoldfastError | None:
    """Return why a system stands still, None if it does not."""
    if code == SINGULAR:
        return SingularChainError(
            "the grasp constraint is singular, or nearly so: its rank drops or its condition passes"
            f" {WORST_CONDITION:g}; try another posture or another grasp"
        )
    if code == OPEN:
        return ClosureError(
            f"the step leaves a grasp open by more than {FARTHEST:g} (m or rad), or by more than two rounds of Newton's"
            " method close; try a smaller time step"
        )
    if code == BROKEN:
        return StateError("the step overflows float64, or its inputs are not finite; try a smaller time step")
    return None


def refuse(systems: Systems) -> None:
    """Refuse systems of which one stands still.

    Raises:
        SingularChainError, ClosureError, StateError: why the first of them does.
    """
    for code in systems["code"]:
        fault = failure(code)
        if fault is not None:
            raise fault
