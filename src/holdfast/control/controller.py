"""Controllers, and control laws that can be compiled to machine code."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from holdfast.compiler.program import Shape
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.names import called
from holdfast.spatial.frozen import ArrayField, Converted, Frozen, FrozenDict, making
from holdfast.spatial.scalar import Array, Scalar
from holdfast.state import State

# pure function (t, state, memory) -> (torques (n,), memory); the memory is None in the first call
Controller = Callable[[float, State, Any], tuple[ArrayLike, Any]]
# traceable function (t, state, memory, parameters) -> (torques (n,), memory)
Torque = Callable[[Scalar, State, Array, Mapping[str, Array]], tuple[ArrayLike, ArrayLike]]


# returns the machine code of a controller that is called on floats, or None; set during long runs
machine_code: ContextVar[Callable[[Any], Controller | None] | None] = ContextVar("machine_code", default=None)


def by_machine_code(controller: Any, t: float, state: State, memory: Any) -> tuple[Array, Any] | None:
    """Return the result of a controller's machine code; None if it has none, or if numbers are traced."""
    find = machine_code.get()
    if find is None or state.q.dtype == object:
        return None
    fast = find(controller)
    return None if fast is None else fast(t, state, memory)  # type: ignore[return-value]


@contextmanager
def without_machine_code() -> Iterator[None]:
    """Within this context, evaluate controllers on floats: a single call is not worth compiling for."""
    token = machine_code.set(None)
    try:
        yield
    finally:
        machine_code.reset(token)


def require_controller(controller: Any) -> None:
    """Check that a controller is a function of three arguments.

    Raises:
        ModelError: it is not.
    """
    if not callable(controller):
        raise ModelError(
            "controller: expected a function (t, state, memory) -> (torques, memory), got"
            f" {type(controller).__name__}; try lambda t, state, memory: (tau, memory), or a TorqueSchedule"
        )
    _require_arguments(
        controller,
        3,
        "controller: expected a function (t, state, memory) -> (torques, memory)",
        "lambda t, state, memory: (tau, memory), which need not use its memory",
    )


def torques_and_memory(found: Any, what: str = "controller") -> tuple[Any, Any]:
    """Return the torques and the memory from the result of a controller.

    Raises:
        StateError: the result is not a pair.
    """
    if not isinstance(found, tuple) or len(found) != 2:
        got = f"an array of shape {found.shape}" if isinstance(found, np.ndarray) else f"a {type(found).__name__}"
        got = f"{len(found)} things" if isinstance(found, tuple) else got
        raise StateError(f"{what}: expected it to return torques and memory, got {got}; try `return tau, memory`")
    return found


@called
@dataclass(frozen=True, eq=False)
class ControlLaw(Frozen):
    """A traceable controller, written with `spatial.scalar` and without `if` on values or assignments to arrays.

    Attributes:
        torque: function (t, state, memory, parameters) -> (torques (n,), memory) of its arguments alone; it is
            called with traced numbers in all arguments.
        memory: (m,) initial memory; it is updated once per step, at the step's start.
        parameters: shapes of its parameters, such as gains, targets or an action; their values can differ between
            systems.
        key: name of the law in the cache on disk; if it is empty, the traced code serves as the name.

    Raises:
        ModelError: the memory is not an array of numbers, or a parameter has no shape.
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
        _require_arguments(
            self.torque,
            4,
            "control law: torque: expected a function (t, state, memory, parameters) -> (torques, memory)",
            "a fourth argument, which a law without parameters need not use",
        )
        if not isinstance(self.parameters, Mapping):
            raise ModelError(
                "control law: parameters: expected a mapping from a name to a shape, e.g. {'gain': (14,)}, got"
                f" {type(self.parameters).__name__}"
            )
        for name in self.parameters:
            if not isinstance(name, str) or not name.isidentifier():
                raise ModelError(
                    f"control law: parameters: expected names such as 'gain', got {checks.short(name)}; they are the"
                    " names of arguments"
                )
        put(self, "parameters", FrozenDict({name: _shape(name, shape) for name, shape in self.parameters.items()}))

    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques and the memory on floats, as any controller does.

        Raises:
            StateError: the law has parameters, whose values a controller does not receive, or `state` is not a State.
        """
        checks.instance(state, State, "control law: state", StateError)
        found = by_machine_code(self, t, state, memory)
        return self.given({}).on_floats(t, state, memory) if found is None else found

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which its torques jump [s], as far as they are known in advance."""
        return known_breakpoints(self.torque)

    def given(self, values: Mapping[str, ArrayLike]) -> GivenLaw:
        """Return the law with values of its parameters, which is a complete controller.

        Args:
            values: values of all parameters, by name.

        Raises:
            StateError: a parameter is missing or unknown, or its value has a wrong shape or is not finite.
        """
        checks.instance(values, Mapping, "control law: values", StateError)
        for name in values:
            if name not in self.parameters:
                raise StateError(
                    f"control law: no parameter '{name}'.{checks.did_you_mean(str(name), self.parameters)}"
                )
        if missing := [name for name in self.parameters if name not in values]:
            raise StateError(
                f"controller: the law takes {', '.join(missing)}, got no value; try"
                f" parameters={{'{missing[0]}': ...}}, or holdfast.compile_rollout for many values at once"
            )
        found = {
            name: checks.numbers(values[name], shape, f"control law: parameter '{name}'", StateError)
            for name, shape in self.parameters.items()
        }
        return GivenLaw(self, LawParameters(found))

    def for_chain(self, chain: Any) -> ControlLaw:
        """Return the law for a chain whose grasps have changed; another one only if its controller has one."""
        for_chain = getattr(self.torque, "for_chain", None)
        return self if for_chain is None else replace(self, torque=for_chain(chain), key="")


def known_breakpoints(*parts: Any) -> tuple[float, ...]:
    """Return the times at which controllers, laws, or paths (also as their methods) say that something jumps [s]."""
    owners = (part if hasattr(part, "breakpoints") else getattr(part, "__self__", None) for part in parts)
    return tuple(sorted({float(t) for owner in owners for t in getattr(owner, "breakpoints", ())}))


class LawParameters(FrozenDict):
    """The values of a law's parameters, by name; one that was not declared is refused."""

    def __missing__(self, name: Any) -> NoReturn:
        raise StateError(
            f"control law: parameter {checks.short(name)} was not declared.{checks.did_you_mean(str(name), self)} Try"
            f" ControlLaw(torque, parameters={{{name!r}: ()}})"
        )


@called
@dataclass(frozen=True, eq=False)
class GivenLaw(Frozen):
    """A control law with values of its parameters, created by `ControlLaw.given`.

    Attributes:
        law: the law.
        values: values of all its parameters, by name.
    """

    law: ControlLaw
    values: Mapping[str, Array]

    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques (n,) and the memory, as any controller does.

        Raises:
            StateError: `state` is not a State.
        """
        checks.instance(state, State, "control law: state", StateError)
        found = by_machine_code(self, t, state, memory)
        return self.on_floats(t, state, memory) if found is None else found

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which its torques jump [s], as far as they are known in advance."""
        return known_breakpoints(self.law)

    def for_chain(self, chain: Any) -> GivenLaw:
        """Return the law with the same values for a chain whose grasps have changed."""
        law = self.law.for_chain(chain)
        return self if law is self.law else replace(self, law=law)

    def on_floats(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the same, computed on floats by the law's own function."""
        law, size = self.law, self.law.memory.shape
        if memory is None:
            memory = law.memory
        elif _shape_of(memory) != size:
            memory = checks.numbers(memory, size, "control law: memory", StateError)
        tau, kept = torques_and_memory(law.torque(t, state, memory, self.values), "control law")
        kept = law.memory if kept is None and size == (0,) else kept
        if (got := _shape_of(kept)) != size:
            shown = checks.short(kept) if got is None else f"shape {got}"
            raise StateError(
                f"control law: memory: expected shape {size}, got {shown}; try ControlLaw(torque, memory=...) of the"
                " shape that the function returns"
            )
        return np.asarray(tau), kept


def _shape_of(x: Any) -> Shape | None:
    """Return the shape of an array or of what can become one; None of anything else."""
    try:
        return None if x is None else np.shape(x)
    except (TypeError, ValueError):
        return None


def given_law(controller: Any, parameters: Mapping[str, ArrayLike] | None) -> Any:
    """Return a control law with values of its parameters; any other controller is returned unchanged.

    Args:
        controller: any controller.
        parameters: values by name, or None.

    Raises:
        ModelError: the parameters are not a mapping.
        StateError: they do not fit the law, or the controller has no parameters.
    """
    values = {} if parameters is None else parameters
    if not isinstance(values, Mapping):
        got = type(values).__name__
        raise ModelError(f"simulation: parameters: expected a mapping from a name to a value, got {got}")
    if isinstance(controller, ControlLaw):
        return controller.given(values)
    if values:
        raise StateError(
            f"simulation: parameters: expected none, got {', '.join(map(str, values))}: only a ControlLaw takes them;"
            " try ControlLaw(torque, parameters={name: shape}), or a function that contains their values"
        )
    return controller


def _require_arguments(function: Callable[..., Any], count: int, expected: str, advice: str) -> None:
    """Check that a function can be called with so many arguments.

    Raises:
        ModelError: it cannot.
    """
    try:
        taken = inspect.signature(function)
    except (TypeError, ValueError):  # of a function that does not tell
        return
    try:
        taken.bind(*[None] * count)
    except TypeError:
        raise ModelError(f"{expected}, got one of {taken}; try {advice}") from None


def _shape(name: str, shape: Sequence[int]) -> Shape:
    """Return the checked shape of a parameter as a tuple."""
    if not isinstance(shape, tuple | list) or not all(isinstance(k, int | np.integer) and k >= 0 for k in shape):
        got = checks.short(shape)
        raise ModelError(f"control law: parameter '{name}': expected a shape such as (), (3,), got {got}")
    return tuple(int(k) for k in shape)


def held_torques(joint_count: int) -> ControlLaw:
    """Return the law whose torques are its parameter `tau`, constant during each step."""
    return ControlLaw(_held, parameters={"tau": (joint_count,)}, key="held")


def holds_torques(law: ControlLaw) -> bool:
    """Return whether a law is that of `held_torques`."""
    return law.torque is _held


def controller_of(joint_count: int, given: Controller | ControlLaw | None) -> Controller | ControlLaw:
    """Return the controller of a run; without joints, None stands for the law without torques.

    Raises:
        ModelError: it is not a function of three arguments.
    """
    if given is None and not joint_count:
        return ControlLaw(lambda t, state, memory, given: (np.zeros(0), memory), key="none")
    require_controller(given)
    assert given is not None
    return given


def _held(t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
    return given["tau"], memory
