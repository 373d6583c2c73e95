"""Control laws that become part of the machine code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from holdfast.compiler.program import Shape
from holdfast.model import checks
from holdfast.spatial.scalar import Array, Scalar
from holdfast.state import State

Torque = Callable[[Scalar, State, Array, Mapping[str, Array]], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class ControlLaw:
    """A controller in the words of `spatial.scalar`: no `if` on a value, no writing into arrays.

    Attributes:
        torque: (t, state, memory, parameters) -> (torques (n,), memory); called once, with traced
            numbers in all of them.
        memory: (m,) what it carries on, at the start; a step moves it on once, at the step's start.
        parameters: shapes of what it is told from outside, per system or for all: gains, targets,
            an action.
        key: stands for the law's text on disk; the text of its machine code does if it is empty.
    """

    torque: Torque
    memory: Array = field(default_factory=lambda: np.zeros(0))
    parameters: Mapping[str, Shape] = field(default_factory=dict)
    key: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "memory", checks.numbers(self.memory, (np.size(self.memory),), "control law: memory"))
        put(self, "parameters", dict(self.parameters))


def held_torques(joint_count: int) -> ControlLaw:
    """Return the law tau = `tau`, the same at every stage of a step."""
    return ControlLaw(
        lambda t, state, memory, given: (given["tau"], memory), parameters={"tau": (joint_count,)}, key="held"
    )
