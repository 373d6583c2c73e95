"""Forward dynamics bound to fixed arrays, for control loops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.compiled.bound_call import BoundCall
from holdfast.compiled.calls import Calls
from holdfast.compiled.externals import FLOATING, MOVING
from holdfast.errors import FrozenError, StateError
from holdfast.model import checks
from holdfast.spatial.real_numbers import is_masked
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain


class BoundDynamics(BoundCall):
    """Forward dynamics with fixed arrays: write into the inputs, call, read `result`. Made by `CompiledChain.bind`.

    It is for one thread at a time. It checks nothing and raises nothing: the call returns the `Status`, and if that is
    SINGULAR or INVALID the results are NaN.

    Attributes:
        q, qd, tau, object_pose, object_twist, object_wrench: the inputs; write with `bound.q[...] = q`.
        link_wrench: an input if `compile` was asked for it, otherwise None.
        floating_pose, floating_twist: inputs if the trunk has a floating base, otherwise None.
        result: the result of the last call.
        run: the machine code as a function without arguments; it returns the status as an integer, 0 for OK.
    """

    def __init__(self, compiled: CompiledChain, calls: Calls, given: Mapping[str, Any]) -> None:
        super().__init__(compiled, calls)
        shapes = {name: e.shape for name, e in self._externals.items() if e.role == "input"}
        self._bound.use({name: _usable(name, x, shapes[name]) for name, x in given.items() if name in shapes})
        arrays = self._bound.arrays
        self.q, self.qd, self.tau = arrays["q"], arrays["qd"], arrays["tau"]
        self.object_pose, self.object_twist = arrays["object_pose"], arrays["object_twist"]
        self.object_wrench, self.link_wrench = arrays["object_wrench"], arrays.get("link_wrench")
        self.floating_pose, self.floating_twist = (arrays.get(name) for name in FLOATING)
        self.result = self._written
        self.set(**{name: x for name, x in given.items() if name not in shapes})
        self._made = True

    def __setattr__(self, name: str, value: Any) -> None:
        """Raise an error if an array that the machine code reads would be replaced; `bound.q += dq` is allowed."""
        if "_made" in vars(self) and not name.startswith("_") and value is not vars(self).get(name, self):
            raise FrozenError(_refusal(name, vars(self)))
        object.__setattr__(self, name, value)

    def set(self, **parameters: Any) -> None:
        """Change run-time parameters, named as in `CompiledChain.forward_dynamics`.

        Raises:
            StateError: A parameter has an unknown name, a wrong shape or a number that is not finite.
        """
        if any(name in parameters and name not in self._externals for name in MOVING):
            self._move(self._compiled.moving)
        super().set(**parameters)

    def _move(self, moving: CompiledChain) -> None:
        """Switch to the machine code for moving bases; the arrays remain the same."""
        before, self._bound, self._externals = self._bound, moving.bound(), moving.externals
        for name, x in before.arrays.items():
            if self._externals[name].role == "parameter":
                self._bound.arrays[name][...] = x
            else:
                self._bound.use({name: x})
        vars(self)["run"] = self._bound.run


def _refusal(name: str, known: Mapping[str, Any]) -> str:
    """Return the message that says why an attribute of a bound call cannot be set."""
    if isinstance(known.get(name), np.ndarray):
        return (
            f"bound: {name}: expected the array that the machine code reads to stay; try bound.{name}[...] = values, or"
            f" bind({name}=array) again"
        )
    if name in known:
        return f"bound: {name}: expected it to stay as `bind` made it; try another bind"
    names = [n for n in known if not n.startswith("_")]
    return f"bound: no attribute '{name}'.{checks.did_you_mean(name, names)} Parameters: try bound.set({name}=...)"


def _usable(name: str, x: Any, shape: tuple[int, ...]) -> Array:
    """Return the array if machine code can read it in place; otherwise raise a StateError."""
    if is_masked(x):
        raise StateError(f"bind: {name}: expected a float64 array, got a masked array; try its method filled")
    if not isinstance(x, np.ndarray) or x.dtype != np.float64 or x.shape != shape or not x.flags.carray:
        got = f"{x.dtype} of shape {x.shape}" if isinstance(x, np.ndarray) else type(x).__name__
        if isinstance(x, np.ndarray) and x.shape == shape and not x.flags.writeable:
            got = f"one that cannot be written, such as an array of a State; try np.array({name})"
        raise StateError(f"bind: {name}: expected a float64 array of shape {shape} in C order, got {got}")
    return x
