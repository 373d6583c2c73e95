"""Conversion between the systems of machine code and instants."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.dynamics.projection import WIDEST_GAP
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.errors import ClosureError, HoldfastError, SingularChainError, StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import ARRAYS, FLOATING, STATE, state_of
from holdfast.simulation.increment import body_parts, twists
from holdfast.simulation.instant import WORST_CONDITION, Instant, late_instant
from holdfast.simulation.rollout.kernel import Systems
from holdfast.simulation.rollout.traced_step import BROKEN, GRASP_OPEN, PASSES_SINGULAR
from holdfast.simulation.runge_kutta import rotation_vector_rate
from holdfast.simulation.step import Gaps, StageRequest
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

TWISTS = ("object_twist", "floating_twist")  # of the free bodies
ACCELERATIONS = ("qdd", "object_acceleration", "floating_acceleration")


@dataclass(frozen=True, eq=False)
class StageInputs:
    """The inputs of a system at one time.

    Attributes:
        t: time [s].
        chain: the chain, with its bases at their poses at that time.
        inputs: external wrenches and base motion as arrays.
        tau: (n,) torques of the controller; None if the machine code computes them.
        memory: memory that the controller has returned.
    """

    t: float
    chain: ClosedChain
    inputs: Inputs
    tau: Array | None
    memory: Any


def state_rows(states: Sequence[State]) -> dict[str, Array]:
    """Return states as arrays with one row per state."""
    names = (*STATE, *(FLOATING if states[0].base_pose is not None else ()))
    fields = {name: ARRAYS[name].field for name in names}
    return {name: np.array([getattr(state, field) for state in states]) for name, field in fields.items()}


def velocities_in(systems: Mapping[str, Array]) -> Array:
    """Return the joint rates and the twists of the free bodies, (..., n + 6); a floating base adds six entries."""
    lead = systems["qd"].shape[:-1]
    parts = [systems[name] for name in ("qd", *TWISTS) if name in systems]
    return np.concatenate([x.reshape(*lead, math.prod(x.shape[len(lead) :])) for x in parts], axis=-1)


def late(
    systems: Systems,
    row: int,
    t: float,
    chain: ClosedChain,
    tau: Array,
    whole: Callable[[], Instant],
    touches: bool = False,
) -> Instant:
    """Return one system as an instant that is evaluated in full only when this is needed.

    Args:
        systems: systems after a step, which may have length zero, with forces by `StepKernel.choose_forces`.
        row: index of the system.
        t: its time [s].
        chain: the chain.
        tau: (n,) torques of the controller.
        whole: returns the fully evaluated instant.
        touches: whether that has contacts with the world.
    """
    margins = systems["margin"][row] if "margin" in systems else None
    return late_instant(t, (systems["q"][row], systems["qd"][row], tau), margins, whole, touches)


def instant_of(systems: Systems, row: int, at: StageInputs) -> Instant:
    """Return one system as an instant.

    Args:
        systems: as for `late`.
        row: index of the system.
        at: inputs of the system.
    """
    x = {name: array[row].copy() for name, array in systems.items()}
    tau, memory = (x["drive"], x.get("memory", at.memory)) if at.tau is None else (at.tau, at.memory)
    chain, state, rank = at.chain, state_of(systems, row), int(x["rank"])
    found = ForwardResult(
        chain,
        x["qdd"],
        x["grasp_wrench"],
        x["object_acceleration"],
        x.get("contact_acceleration", np.zeros(0)),
        x["base_wrench"],
        rank,
        chain.velocity_count + chain.contact_freedom_count - rank,
        Status.OK if rank == chain.constraint_row_count else Status.INDETERMINATE_FORCES,
        float(x["condition"]),
        "sequential",
        x.get("held_rows"),
        x.get("floating_acceleration"),
        x.get("trunk_base_wrench"),
    )
    return Instant(at.t, state, chain, at.inputs, tau, memory, found, x["slope"][-4:])


def gaps_of(systems: Systems, row: int) -> Gaps:
    """Return the gaps before and after projection."""
    return Gaps(*systems["gaps"][row].reshape(2, 2).T.copy())


def slope_at(found: Array, at: StageRequest) -> Array:
    """Return the slope at a stage, with the rates of the rotation vectors relative to the start of the step.

    The machine code has treated the attitude at the stage as that of a step's start.
    """
    slope = found.copy()
    for part, turn, twist in zip(body_parts(at.state), at.turns, twists(at.state), strict=True):
        slope[part.start : part.start + 3] = rotation_vector_rate(turn, twist[:3])
    return slope


def failure(code: float) -> HoldfastError | None:
    """Return the error for a status code; None for a running system."""
    if code == PASSES_SINGULAR:
        return SingularChainError(
            "the grasp constraint is singular, or nearly so: its rank drops or its condition passes"
            f" {WORST_CONDITION:g}; try another configuration or another grasp"
        )
    if code == GRASP_OPEN:
        return ClosureError(
            f"the step leaves a grasp open by more than {WIDEST_GAP:g} (m or rad), or by more than two rounds of"
            " Newton's method close; try a smaller time step"
        )
    if code == BROKEN:
        return StateError("the step overflows float64, or its inputs are not finite; try a smaller time step")
    return None


def refuse(systems: Systems) -> None:
    """Raise an error if one of the systems has stopped.

    Raises:
        SingularChainError, ClosureError, StateError: the reason why the first of them has stopped.
    """
    for code in systems["code"]:
        fault = failure(code)
        if fault is not None:
            raise fault
