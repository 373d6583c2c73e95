"""The operations on Python floats: IEEE 754 binary64 arithmetic, rounded to nearest, without exceptions.

The bits of every result are defined, except for those of NaN, which has many representations.
"""

from __future__ import annotations

import math
from collections.abc import Callable

TRUTHS = frozenset({"less", "less_equal"})  # operations whose result is a truth value


def divide(a: float, b: float) -> float:
    """Return a / b; where Python would raise an error, the result is infinite or NaN, as IEEE 754 prescribes."""
    if b != 0.0:
        return a / b
    if a == 0.0 or math.isnan(a) or math.isnan(b):
        return math.nan
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def sqrt(x: float) -> float:
    """Return the correctly rounded square root, or NaN for a negative number."""
    return math.sqrt(x) if x >= 0.0 else math.nan


def fma(a: float, b: float, c: float) -> float:
    """Return a b + c rounded once, by exact integer arithmetic."""
    if not (math.isfinite(a) and math.isfinite(b)):
        return a * b + c
    if not math.isfinite(c):
        return c
    if a == 0.0 or b == 0.0:
        return a * b + c  # the product is an exact zero, with its sign
    (an, ad), (bn, bd), (cn, cd) = a.as_integer_ratio(), b.as_integer_ratio(), c.as_integer_ratio()
    numerator = an * bn * cd + cn * ad * bd
    if numerator == 0:
        return 0.0
    try:
        size = abs(numerator) / (ad * bd * cd)  # integer division rounds correctly
    except OverflowError:
        size = math.inf
    return size if numerator > 0 else -size


def select(condition: bool, a: float, b: float) -> float:
    """Return a if the condition holds, else b."""
    return a if condition else b


OPERATIONS: dict[str, Callable[..., float]] = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": divide,
    "negate": lambda a: -a,
    "absolute": math.fabs,
    "sqrt": sqrt,
    "fma": fma,
    "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b,
    "select": select,
}
