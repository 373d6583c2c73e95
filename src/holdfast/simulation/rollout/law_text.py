"""What a control law is asked, and what it must answer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from holdfast.compiler.errors import CompileError
from holdfast.compiler.program import Program, Shape
from holdfast.compiler.trace import trace
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.law import ControlLaw
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.state import State


def asked(
    law: ControlLaw, chain: ClosedChain, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Return a law's torques (n,) and memory.

    Args:
        law: the law.
        chain: whose joints it drives.
        t: time [s].
        state: positions and velocities.
        memory: the law's.
        given: its parameters, by `control.name`.

    Raises:
        CompileError: it answers something else.
    """
    parameters = {name: given[f"control.{name}"] for name in law.parameters}
    return _answer(law.torque(t, state, memory, parameters), chain.joint_count, len(law.memory))


def law_program(law: ControlLaw, chain: ClosedChain) -> Program:
    """Return a law as a program: t, q, qd, object_pose, object_twist, memory and parameters to torques and memory.

    Raises:
        CompileError: it cannot be traced.
    """
    n, names = chain.joint_count, [f"control.{name}" for name in law.parameters]

    def text(
        t: Array, q: Array, qd: Array, pose: Array, twist: Array, memory: Array, *given: Array
    ) -> tuple[Array, Array]:
        return asked(law, chain, t[()], State(q, qd, pose, twist), memory, dict(zip(names, given, strict=True)))

    parameters: dict[str, Shape] = {f"control.{name}": tuple(shape) for name, shape in law.parameters.items()}
    state: dict[str, Shape] = {"t": (), "q": (n,), "qd": (n,), "object_pose": (7,), "object_twist": (6,)}
    shapes = state | {"memory": (len(law.memory),)} | parameters
    return trace(text, shapes.values())


def _answer(found: Any, joint_count: int, memory_count: int) -> tuple[Array, Array]:
    """Return a law's torques and memory, or say how they do not fit."""
    if not isinstance(found, tuple) or len(found) != 2:
        raise CompileError(f"control law: expected torques and memory, got {type(found).__name__}; try `tau, memory`")
    drive, kept = array(found[0]), array(found[1])
    for what, x, size in (("torques", drive, joint_count), ("memory", kept, memory_count)):
        if x.shape != (size,):
            raise CompileError(f"control law: {what}: expected shape ({size},), got {x.shape}")
    return drive, kept
