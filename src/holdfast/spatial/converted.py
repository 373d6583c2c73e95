"""Types of attributes that hold an array and take whatever NumPy makes one of: lists, tuples, numbers.

    com: ArrayField = field(default_factory=making(np.zeros, 3))

in a frozen dataclass whose `__post_init__` converts what it is given: to a type checker the constructor's argument
is an `ArrayLike` and the attribute an `Array`. At run time it is an attribute like any other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING
from functools import partial
from typing import Any, Protocol, TypeVar

from numpy.typing import ArrayLike

from holdfast.spatial.scalar import Array

Held = TypeVar("Held", covariant=True)
Given = TypeVar("Given", contravariant=True)


class Converted(Protocol[Held, Given]):
    """An attribute that is given as one type and held as another, as type checkers understand it: a descriptor."""

    def __get__(self, instance: object, owner: Any) -> Held:
        """Tell the type of what is held."""
        ...

    def __set__(self, instance: object, value: Given) -> None:
        """Tell the type of what the constructor takes."""
        ...


ArrayField = Converted[Array, ArrayLike]
OptionalArrayField = Converted[Array | None, ArrayLike | None]
NOT_GIVEN: Any = None  # its default
# Stands in a default's place where there is none: mypy takes an attribute of a dataclass for a descriptor only if
# something is assigned to it. To `dataclass` a default that is missing is no default.
REQUIRED: Any = MISSING


def making(make: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
    """Return a default factory whose type is left open: to a type checker no array is a `Converted`."""
    return partial(make, *arguments)
