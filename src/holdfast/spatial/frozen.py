"""Frozen dataclasses whose arrays and mappings are frozen too, in their copies and after pickling as well.

    @dataclass(frozen=True, eq=False)
    class Link(Frozen):
        com: Array

        @frozen_property
        def moment(self) -> Array: ...

A dataclass that only says `frozen=True` refuses `link.com = x`, but lets `link.com[0] = x` change what others rely on.

Fields may hold an array and take whatever NumPy makes one of: lists, tuples, numbers. With

    com: ArrayField = field(default_factory=making(np.zeros, 3))

and a `__post_init__` that converts what it is given, the constructor's argument is an `ArrayLike` and the attribute an
`Array` to a type checker. At run time it is an attribute like any other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from functools import cached_property, partial
from typing import Any, NoReturn, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import FrozenError
from holdfast.spatial.scalar import Array

PropertyType = TypeVar("PropertyType")
FrozenType = TypeVar("FrozenType")


class Frozen:
    """A base of frozen dataclasses. What they hold cannot be written, so that a deep copy is the object itself."""

    def __post_init__(self) -> None:
        """Freeze the arguments of the constructor; a class that converts them freezes them itself."""
        self.__setstate__(dict(vars(self)))

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields; cached properties, which may hold functions, are computed again."""
        return {field.name: vars(self)[field.name] for field in fields(self)}  # type: ignore[arg-type]  # pyright: ignore

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Restore the attributes of a copy or a pickle, in which arrays are writeable."""
        self.__dict__.update({name: frozen(value) for name, value in state.items()})

    def __deepcopy__(self, memo: Any) -> Self:
        """Return the object itself."""
        return self


class FrozenDict(dict[Any, Any]):
    """A dict that cannot be changed."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise FrozenError(
            "this mapping cannot be changed, because others rely on it; try a new one, {**mapping, name: value}, and"
            " dataclasses.replace where it belongs to a frozen object"
        )

    __setitem__ = __delitem__ = __ior__ = _refuse  # type: ignore[assignment]
    clear = pop = popitem = setdefault = update = _refuse  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how pickle rebuilds the mapping."""
        return type(self), (dict(self),)


class frozen_property(cached_property[PropertyType]):
    """A cached property whose value is frozen."""

    def __init__(self, compute: Callable[[Any], PropertyType]) -> None:
        super().__init__(lambda instance: frozen(compute(instance)))
        self.__doc__ = compute.__doc__


def frozen(value: Any) -> Any:
    """Return a value whose arrays, lists and dicts cannot be written, at any depth; an array is not copied."""
    if isinstance(value, np.ndarray):
        return read_only(value)
    if type(value) in (dict, FrozenDict):
        return FrozenDict({name: frozen(x) for name, x in value.items()})
    if type(value) in (tuple, list):
        return tuple([frozen(x) for x in value])
    if isinstance(value, tuple) and hasattr(value, "_make"):
        return type(value)._make([frozen(x) for x in value])  # type: ignore[attr-defined]
    return value


def changed(of: FrozenType, **fields: Any) -> FrozenType:
    """Return a frozen object with some attributes replaced, for algorithms; nothing is checked or copied.

    Cached properties are kept, so those that depend on what is replaced must be replaced, too.
    """
    made = object.__new__(type(of))
    made.__dict__.update(vars(of), **fields)
    return made


def read_only(a: np.ndarray) -> np.ndarray:
    """Return the array if it cannot be written, else a view of it that cannot; the array given stays as it is."""
    if not a.flags.writeable:
        return a
    view = a.view()
    view.setflags(write=False)
    return view


HeldType = TypeVar("HeldType", covariant=True)
GivenType = TypeVar("GivenType", contravariant=True)


class Converted(Protocol[HeldType, GivenType]):
    """An attribute that is given as one type and held as another, as type checkers understand it: a descriptor."""

    def __get__(self, instance: object, owner: Any) -> HeldType:
        """Declare the type of the attribute."""
        ...

    def __set__(self, instance: object, value: GivenType) -> None:
        """Declare the type of the argument of the constructor."""
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
