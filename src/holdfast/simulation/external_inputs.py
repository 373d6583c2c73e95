"""What acts on a run from outside: constant, a function of time, or a function of time and state."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from holdfast.errors import ModelError, StateError
from holdfast.spatial.scalar import Scalar
from holdfast.state import Inputs, State

# t [s] and state at one and the same instant
GivenInputs = Inputs | Callable[[Any], Inputs] | Callable[[Any, State], Inputs]
MOVING_BASES = ("base_twists", "base_accelerations", "trunk_base_twist", "trunk_base_acceleration")


def take_state(given: GivenInputs) -> bool:
    """Return whether inputs are asked for (t, state): a function is that cannot be called with t alone.

    So `lambda t, gain=2.0: ...` is a function of time, and so is one whose signature Python does not know.

    Raises:
        ModelError: they are neither Inputs nor a function, or one that can be called in neither way.
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
    """Return what acts at one instant.

    Args:
        given: the inputs.
        of_state: what `take_state` says of them.
        t: time [s].
        state: the chain then.

    Raises:
        StateError: a function returned something else, or moves bases with the state: grasps would close otherwise
            at another velocity, and where bases are is a function of time.
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
    """Refuse inputs that move bases where only wrenches can act.

    Raises:
        StateError: naming the first that is given.
    """
    for name in MOVING_BASES:
        if getattr(found, name) is not None:
            raise StateError(
                f"inputs {whose}: {name}: expected none, as bases move with time alone; try base_motion="
                "{name: t -> (pose, twist, acceleration)}"
            )
