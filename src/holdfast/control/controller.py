"""Control laws that become part of the machine code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.compiler.program import Shape
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.spatial.converted import ArrayField, Converted, making
from holdfast.spatial.frozen import Frozen, FrozenDict
from holdfast.spatial.scalar import Array, Scalar
from holdfast.state import State

# (t, state, memory) -> (torques (n,), memory): a pure function, memory None at the start
Controller = Callable[[float, State, Any], tuple[ArrayLike, Any]]
# (t, state, memory, parameters) -> (torques (n,), memory), traced
Torque = Callable[[Scalar, State, Array, Mapping[str, Array]], tuple[ArrayLike, ArrayLike]]


def require_controller(controller: Any) -> None:
    """Refuse what cannot be asked for torques.

    Raises:
        ModelError: it is no function.
    """
    if not callable(controller):
        raise ModelError(
            "controller: expected a function (t, state, memory) -> (torques, memory), got"
            f" {type(controller).__name__}; try lambda t, state, memory: (tau, memory), or a TorqueSchedule"
        )


def torques_and_memory(found: Any) -> tuple[Any, Any]:
    """Return the torques and the memory that a controller returned.

    Raises:
        StateError: it returned something else.
    """
    if not isinstance(found, tuple) or len(found) != 2:
        got = f"an array of shape {found.shape}" if isinstance(found, np.ndarray) else f"a {type(found).__name__}"
        got = f"{len(found)} things" if isinstance(found, tuple) else got
        raise StateError(f"controller: expected it to return torques and memory, got {got}; try `return tau, memory`")
    return found


@dataclass(frozen=True, eq=False)
class ControlLaw(Frozen):
    """A controller that can be traced, written with `spatial.scalar`: no `if` on a value, no writing into arrays.

    Attributes:
        torque: (t, state, memory, parameters) -> (torques (n,), memory); called once, with traced
            numbers in all of them.
        memory: (m,) what it carries on, at the start; a step moves it on once, at the step's start.
        parameters: shapes of what it is given from outside, per system or for all: gains, targets,
            an action.
        key: names the law in the cache on disk; if it is empty, the traced machine code does.

    Raises:
        ModelError: memory that is no array of numbers, or a parameter without a shape.
    """

    torque: Torque
    memory: ArrayField = field(default_factory=making(np.zeros, 0))
    parameters: Converted[Mapping[str, Shape], Mapping[str, Sequence[int]]] = field(default_factory=making(dict))
    key: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "memory", checks.vector(self.memory, "control law: memory"))
        if not callable(self.torque):
            raise ModelError(
                "control law: torque: expected a function (t, state, memory, parameters) -> (torques, memory), got"
                f" {type(self.torque).__name__}"
            )
        if not isinstance(self.parameters, Mapping):
            raise ModelError(
                "control law: parameters: expected a mapping from a name to a shape, e.g. {'gain': (14,)}, got"
                f" {type(self.parameters).__name__}"
            )
        put(self, "parameters", FrozenDict({name: _shape(name, shape) for name, shape in self.parameters.items()}))

    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques on floats, as any controller does: (t, state, memory) -> (torques, memory).

        Raises:
            StateError: the law has parameters, which a controller is not given.
        """
        self.require_no_parameters()
        tau, kept = self.torque(t, state, self.memory if memory is None else memory, {})
        return np.asarray(tau), kept

    def require_no_parameters(self) -> None:
        """Refuse to be a controller, which has no parameters.

        Raises:
            StateError: the law has parameters.
        """
        if self.parameters:
            raise StateError(
                f"controller: the law takes {', '.join(self.parameters)}, which only a rollout can give; try"
                " holdfast.compile_rollout"
            )


def _shape(name: str, shape: Sequence[int]) -> Shape:
    """Return a parameter's shape as a tuple, or refuse it."""
    if not isinstance(shape, tuple | list) or not all(isinstance(k, int | np.integer) and k >= 0 for k in shape):
        raise ModelError(f"control law: parameter '{name}': expected a shape such as (), (3,), got {shape!r}")
    return tuple(int(k) for k in shape)


def held_torques(joint_count: int) -> ControlLaw:
    """Return the law tau = `tau`, the same at every stage of a step."""
    return ControlLaw(_held, parameters={"tau": (joint_count,)}, key="held")


def _held(t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
    return given["tau"], memory
