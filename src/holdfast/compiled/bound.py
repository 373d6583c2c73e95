"""A function of a compiled chain bound to fixed arrays: a call without arguments, for control loops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.compiled import statuses
from holdfast.compiled.derivative_schedule import WITH
from holdfast.compiled.parameters import parse_parameters, rank_number
from holdfast.compiled.result import UNDECIDED
from holdfast.dynamics.result import Status
from holdfast.errors import FrozenError, StateError
from holdfast.model import checks
from holdfast.names import named, no_arguments
from holdfast.questions.arrays import ARRAYS, FLOATING, MOVING
from holdfast.spatial.real_numbers import is_masked
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.compiled.function import Function


@named
class BoundFunction:
    """A function with fixed arrays: write into the inputs, call, read `result` or `found`. Made by `Function.bind`.

    It is for one thread at a time. It checks nothing and raises nothing. If the equations may have no solution, the
    call returns the `Status`, and results are NaN if that is SINGULAR or INVALID; otherwise it returns the answer.

    Attributes:
        arrays: the inputs by name. Each is also an attribute, which is None for an input that the chain does not have;
            write with `bound.q[...] = q`.
        given: the cotangents by result (of a `vjp`) or the tangents by argument (of a `jvp`).
        result: the answer of the last call, which the next one overwrites.
        found: the derivatives of the last call; None without derivatives.
        run: the machine code as a function without arguments; it returns the status as an integer, 0 for OK.
    """

    arrays: dict[str, Array]
    given: dict[str, Array]
    run: Any

    def __init__(self, function: Function, given: Mapping[str, Any]) -> None:
        self._function, self._externals, self._has_status = function, function.externals, function.has_status
        self._bound = function.calls.bind()
        self._written = function.results(None)
        self._bound.use({name: self._written.array(name) for name in function.calls.layout.shapes})
        inputs = {name: e.shape for name, e in self._externals.items() if e.role == "input"}
        named = {name: x for name, x in given.items() if name in inputs and not name.startswith(WITH)}
        self._bound.use({name: _usable(name, x, inputs[name]) for name, x in named.items()})
        arrays = self._bound.arrays
        self.arrays = {name: arrays[name] for name in inputs if not name.startswith(WITH)}
        self.given = {name.removeprefix(WITH): arrays[name] for name in inputs if name.startswith(WITH)}
        self.run = self._bound.run
        absent = [name for name, row in ARRAYS.items() if row.role in ("state", "input") and name not in arrays]
        vars(self).update({**dict.fromkeys(absent), **self.arrays})
        for pose in ("object_pose", FLOATING[0]):
            if pose in arrays and pose not in named and not arrays[pose].any():
                arrays[pose][..., 0] = 1.0
        self.found = None if function.request is None else function.shown(self._written)
        self._only = function.only_array(self._written)
        self.set(**{name: x for name, x in given.items() if name not in named})
        self._made = True

    @property
    def result(self) -> Any:
        """The answer of the last call."""
        if (only := self._only) is not None:
            return only if only.ndim else only.item()
        return self._function.shown(self._written) if self.found is None else self.found.result

    def __setattr__(self, name: str, value: Any) -> None:
        """Raise an error if an array that the machine code reads would be replaced; `bound.q += dq` is allowed."""
        if "_made" in vars(self) and not name.startswith("_") and value is not vars(self).get(name, self):
            raise FrozenError(_refusal(name, {**vars(self), "result": None}))
        object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        """Return the question and the chain's arms."""
        return f"<bound {self._function.name} of {self._function.subject}>"

    def __call__(self, *none: Any) -> Any:
        """Compute the results from the inputs; see the class for what is returned."""
        if none:
            no_arguments("bound call", none)
        code = self.run()
        if not self._has_status:
            return self.result if self.found is None else None
        if code == 0:
            return Status.OK
        if code == UNDECIDED:
            compiled = self._function.compiled
            statuses.resolve_undecided(compiled, self._bound.arrays, self._written)
            self._bound.set({"generic_rank": rank_number(compiled.generic_rank or 0)})
            self.run()
        return self._written.status  # type: ignore[attr-defined]

    def set(self, **inputs_or_parameters: Any) -> None:
        """Change inputs, cotangents (`with_` and the result's name) or run-time parameters of the function.

        Raises:
            StateError: A name is unknown, a shape is wrong, or a parameter is not finite.
        """
        given, further = {}, dict(inputs_or_parameters)
        for name in tuple(further):
            if name in self.arrays and self._externals[name].role == "input":
                shape = self._externals[name].shape
                x = checks.numbers(further.pop(name), None, f"set: {name}", StateError)
                _require_one_system(name, x, shape)
                given[name] = checks.numbers(x, shape, f"set: {name}", StateError)
        if any(name in further and name not in self._externals for name in MOVING):
            self._move()
        found = parse_parameters(further, self._externals, self._function.chain) if further else {}
        for name, x in found.items():
            _require_one_system(name, x, self._externals[name].shape)
        self._bound.set(given | found)

    def _move(self) -> None:
        """Switch to the machine code for moving bases; the arrays remain the same."""
        moving = self._function.when_moving
        before, self._bound, self._externals = self._bound, moving.calls.bind(), moving.externals
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


def _require_one_system(name: str, x: Array, shape: tuple[int, ...]) -> None:
    if x.ndim > len(shape):
        raise StateError(f"set: {name}: expected numbers of one system, got a batch of {len(x)}")


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
