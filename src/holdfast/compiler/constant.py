"""A number that is known while a function is traced, such as a model's length or mass.

NumPy multiplies arrays of floats with BLAS, whose last digits depend on the kernel that it selects for the processor.
Arrays of `Constant` are multiplied entry by entry, in a fixed order and with the interpreter's operations, so the
constants of the machine code are the same on every processor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import numpy as np

from holdfast.compiler.arithmetic import OPERATIONS
from holdfast.compiler.errors import CompileError, place_of_call

NUMBER_TYPES = (float, int, np.floating, np.integer, np.bool_)


def _both_ways(kind: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    """Return the methods of an operation for a scalar on its left and on its right."""
    return (
        lambda self, other: self._operation(kind, self, other),
        lambda self, other: self._operation(kind, other, self),
    )


class Operators:
    """Python's operators of a scalar in terms of its `_operation(kind, a, b)`, of which it is one operand itself."""

    __slots__ = ()

    # With this priority np.float64(2) * x calls the scalar's operator, and array * x goes entry by entry.
    __array_priority__ = -1.0

    __add__, __radd__ = _both_ways("add")
    __sub__, __rsub__ = _both_ways("subtract")
    __mul__, __rmul__ = _both_ways("multiply")
    __truediv__, __rtruediv__ = _both_ways("divide")
    __lt__, __gt__ = _both_ways("less")
    __le__, __ge__ = _both_ways("less_equal")

    def __pos__(self) -> Self:
        return self


class Constant(Operators):
    """A float64 that NumPy treats as an object; its sum or product with a number is a `Constant` again.

    Attributes:
        value: the number.
    """

    __slots__ = ("value",)

    def __init__(self, value: float) -> None:
        self.value = float(value)

    def _operation(self, kind: str, a: Any, b: Any) -> Any:
        """Return the result for two numbers; nodes and arrays are left to their own operators."""
        other = b if a is self else a
        if not isinstance(other, NUMBER_TYPES) and not isinstance(other, Constant):
            return NotImplemented
        found = OPERATIONS[kind](float(a), float(b))
        return found if isinstance(found, bool) else Constant(found)

    def __neg__(self) -> Constant:
        return Constant(-self.value)

    def __abs__(self) -> Constant:
        return Constant(abs(self.value))

    def sqrt(self) -> Constant:
        """Return the square root."""
        return Constant(OPERATIONS["sqrt"](self.value))

    def where(self, a: Any, b: Any) -> Any:
        """Refuse to be a condition: comparisons of constants are plain truth values."""
        raise CompileError(f"{place_of_call()}: expected a comparison as the condition of `where`, got a number")

    def __float__(self) -> float:
        return self.value

    def __bool__(self) -> bool:
        return self.value != 0.0

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Constant | float | int | np.floating | np.integer):
            return NotImplemented
        return self.value == float(other)

    __hash__ = object.__hash__

    def __repr__(self) -> str:
        """Return the number."""
        return f"<constant {self.value!r}>"


def constants(x: np.ndarray) -> np.ndarray:
    """Return an array of floats as an array of constants."""
    found = np.empty(x.shape, dtype=object)
    for place, value in np.ndenumerate(x):
        found[place] = Constant(value)
    return found
