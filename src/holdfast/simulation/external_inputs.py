"""External inputs of a run: constant, a function of time, or a function of time and state."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from holdfast.errors import ModelError, StateError
from holdfast.spatial.scalar import Scalar
from holdfast.state import Inputs, State

# functions receive the time t [s] and the state at that time
GivenInputs = Inputs | Callable[[Any], Inputs] | Callable[[Any, State], Inputs]
MOVING_BASES = ("base_twists", "base_accelerations", "trunk_base_twist", "trunk_base_acceleration")


def take_state(given: GivenInputs) -> bool:
    """Return whether the inputs are a function of (t, state), which is one that cannot be called with t alone.

    For example, `lambda t, gain=2.0: ...` is a function of time. So is a function whose signature Python cannot tell.

    Raises:
        ModelError: the inputs are neither Inputs nor a function that can be called as f(t) or f(t, state).
    """
    if isinstance(given, Inputs):
        return False
    if not callable(given):
        raise ModelError(
            "inputs: expected Inputs, or a function (t) -> Inputs or (t, state) -> Inputs, got"
            f" {type(given).__name__}; try Inputs(object_wrench=...)"
        )
    try:
        signature = inspect.signature(given)
    except (TypeError, ValueError):
        return False
    for arguments in ((0.0,), (0.0, None)):
        try:
            signature.bind(*arguments)
        except TypeError:
            continue
        return len(arguments) == 2
    raise ModelError(
        f"inputs: expected a function (t) -> Inputs or (t, state) -> Inputs, got one that is called with {signature};"
        " try lambda t, state: Inputs(object_wrench=...)"
    )


def inputs_at(given: GivenInputs, of_state: bool, t: Scalar, state: State) -> Inputs:
    """Return the inputs at one instant.

    Args:
        given: the inputs, or the function that returns them.
        of_state: the result of `take_state(given)`.
        t: time [s].
        state: positions and velocities at that time.

    Raises:
        StateError: a function has not returned Inputs, or a function of the state has returned a base motion. Base
            motions must be functions of time alone, because the velocity constraint of the grasps depends on them.
    """
    if isinstance(given, Inputs):
        return given
    arguments = (t, state) if of_state else (t,)
    found: Any = given(*arguments)
    if not isinstance(found, Inputs):
        raise StateError(
            f"inputs: expected the function to return Inputs, got {type(found).__name__}; try Inputs(object_wrench=...)"
        )
    if of_state:
        require_wrenches(found, "of a function of (t, state)")
    return found


def require_wrenches(found: Inputs, whose: str) -> None:
    """Refuse inputs that contain base motions where only wrenches are allowed.

    Raises:
        StateError: a base motion is given; the message names the first.
    """
    for name in MOVING_BASES:
        if getattr(found, name) is not None:
            raise StateError(
                f"inputs {whose}: {name}: expected none, as bases move with time alone; try base_motion="
                "{name: t -> (pose, twist, acceleration)}"
            )
