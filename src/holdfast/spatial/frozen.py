"""Frozen dataclasses whose arrays and mappings are frozen too, in their copies and after pickling as well.

    @dataclass(frozen=True, eq=False)
    class Link(Frozen):
        com: Array

        @frozen_property
        def moment(self) -> Array: ...

A dataclass that only says `frozen=True` refuses `link.com = x`, but lets `link.com[0] = x` change what others rely on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, NoReturn, Self, TypeVar

import numpy as np

from holdfast.errors import FrozenError

Value = TypeVar("Value")
Held = TypeVar("Held")


class Frozen:
    """A base of frozen dataclasses. What they hold cannot be written, so that a deep copy is the object itself."""

    def __post_init__(self) -> None:
        """Freeze what the constructor was given; a class that converts it does so itself."""
        self.__setstate__(dict(vars(self)))

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the attributes of a copy or a pickle; arrays come back writeable from there."""
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
        """Return what makes the mapping again."""
        return type(self), (dict(self),)


class frozen_property(cached_property[Value]):
    """A cached property whose value is frozen."""

    def __init__(self, compute: Callable[[Any], Value]) -> None:
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


def changed(of: Held, **fields: Any) -> Held:
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
