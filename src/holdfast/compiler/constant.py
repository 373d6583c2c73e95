"""A number that is known while a function is traced, such as a model's length or mass.

NumPy multiplies arrays of floats with BLAS, whose last digits depend on the kernel that it selects for the processor.
Arrays of `Constant` are multiplied entry by entry, in a fixed order and with the interpreter's operations, so the
constants of the machine code are the same on every processor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from holdfast.compiler.arithmetic import OPERATIONS
from holdfast.compiler.errors import CompileError, place_of_call

NUMBERS = (float, int, np.floating, np.integer, np.bool_)


def _binary(kind: str, swapped: bool = False) -> Callable[[Constant, Any], Any]:
    """Return an operator method; it leaves nodes and arrays to their own operators."""
    operation = OPERATIONS[kind]

    def operator(self: Constant, other: Any) -> Any:
        if isinstance(other, Constant):
            other = other.value
        elif isinstance(other, NUMBERS):
            other = float(other)
        else:
            return NotImplemented
        found = operation(other, self.value) if swapped else operation(self.value, other)
        return found if isinstance(found, bool) else Constant(found)

    return operator


class Constant:
    """A float64 that NumPy treats as an object; its sum or product with a number is a `Constant` again.

    Attributes:
        value: the number.
    """

    __slots__ = ("value",)

    __array_priority__ = -1.0  # as for `Node`: NumPy's scalars defer to this class, and arrays go entry by entry

    def __init__(self, value: float) -> None:
        self.value = float(value)

    __add__ = _binary("add")
    __radd__ = _binary("add", swapped=True)
    __sub__ = _binary("subtract")
    __rsub__ = _binary("subtract", swapped=True)
    __mul__ = _binary("multiply")
    __rmul__ = _binary("multiply", swapped=True)
    __truediv__ = _binary("divide")
    __rtruediv__ = _binary("divide", swapped=True)
    __lt__ = _binary("less")
    __gt__ = _binary("less", swapped=True)
    __le__ = _binary("less_equal")
    __ge__ = _binary("less_equal", swapped=True)

    def __neg__(self) -> Constant:
        return Constant(-self.value)

    def __pos__(self) -> Constant:
        return self

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
