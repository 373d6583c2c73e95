"""Split a value into its traced nodes and a key for everything else.

Two items of a loop share their code if their keys are equal; they may differ in their traced nodes only. A value
consists of numbers, arrays, tuples, lists, dicts, dataclasses, and functions with the variables that they close over.
Any other object is compared by identity.
"""

from __future__ import annotations

import dataclasses
import functools
import types
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.compiler.constant import NUMBERS, Constant
from holdfast.compiler.node import Node

_PLAIN = (str, bool, Constant, *NUMBERS)
_WORDS = (str, bool)
_SEQUENCES = (tuple, list)

Leaf = tuple[Node, ...]  # the distinct nodes of one array, in order of appearance


class Values:
    """Splits values, and remembers the key of every object that holds no traced node.

    Attributes:
        kind: the class of what counts as a traced node.
    """

    def __init__(self, kind: type = Node) -> None:
        self.kind = kind
        # The first, third and fourth dict are keyed by `id`; they hold the objects too, so that no id is reused.
        self._static: dict[int, tuple[Any, int]] = {}  # objects without nodes, and the number of their key
        self._numbers: dict[Hashable, int] = {}
        self._arrays: dict[int, tuple[np.ndarray, Leaf, Hashable]] = {}  # arrays with nodes, their leaf and key
        self._seen: dict[int, Any] = {}  # values for which `replaced` has been called
        self._open: set[int] = set()  # functions being visited, which may close over themselves

    def leaves(self, value: Any) -> tuple[list[Leaf], Hashable]:
        """Return the traced nodes of a value, one leaf per array or scalar, and the key of the rest."""
        found: list[Leaf] = []
        return found, self._key(value, found)

    def _key(self, value: Any, found: list[Leaf]) -> Hashable:
        if isinstance(value, self.kind):
            found.append((value,))
            return "node"
        if value is None or isinstance(value, _WORDS):
            return value
        if isinstance(value, NUMBERS):
            return ("number", float(value).hex())
        if isinstance(value, Constant):
            return ("number", value.value.hex())
        known = self._static.get(id(value))
        if known is not None:
            return known[1]
        before = len(found)
        key = self._made_of(value, found)
        if len(found) > before:
            return key
        number = self._numbers.setdefault(key, len(self._numbers))
        self._static[id(value)] = (value, number)
        return number

    def _made_of(self, value: Any, found: list[Leaf]) -> Hashable:
        if isinstance(value, np.ndarray):
            return self._array(value, found)
        if isinstance(value, _SEQUENCES):
            return (type(value), *[self._key(x, found) for x in value])
        if isinstance(value, dict):
            return (dict, *[(name, self._key(x, found)) for name, x in value.items()])
        if isinstance(value, types.FunctionType):
            return self._function(value, found)
        if isinstance(value, types.MethodType):
            return ("method", value.__func__, self._key(value.__self__, found))
        names = _fields(type(value))
        if names is not None:
            return (type(value), *[self._key(getattr(value, name), found) for name in names])
        return ("object", id(value))

    def _array(self, value: np.ndarray, found: list[Leaf]) -> Hashable:
        if value.dtype != object:
            return (value.shape, value.dtype.str, value.tobytes())
        known = self._arrays.get(id(value))
        if known is None:
            known = self._arrays[id(value)] = (value, *self._leaf(value, found))
        if known[1]:
            found.append(known[1])
        return known[2]

    def _leaf(self, value: np.ndarray, found: list[Leaf]) -> tuple[Leaf, Hashable]:
        """Return the distinct nodes of an array, and the key of the array."""
        entries = value.ravel().tolist()
        if {*map(type, entries)} == {self.kind}:
            leaf = tuple(dict.fromkeys(entries))
            if len(leaf) == len(entries):
                return leaf, ("distinct", value.shape)
        places: dict[Node, int] = {}
        pattern: list[Hashable] = [value.shape]
        for x in entries:
            pattern.append(places.setdefault(x, len(places)) if isinstance(x, self.kind) else self._key(x, found))
        return tuple(places), tuple(pattern)

    def _function(self, value: types.FunctionType, found: list[Leaf]) -> Hashable:
        if id(value) in self._open:
            return "itself"
        self._open.add(id(value))
        cells = [self._key(_content(cell), found) for cell in value.__closure__ or ()]
        defaults = [self._key(x, found) for x in (value.__defaults__, value.__kwdefaults__)]
        self._open.remove(id(value))
        return ("function", value.__code__, *cells, *defaults)

    def replaced(self, value: Any, numbers: Iterable[Mapping[Node, Any]]) -> Any:
        """Return the value with other numbers in place of its traced nodes; `numbers` has one mapping per leaf."""
        if id(value) not in self._seen:
            self.leaves(value)  # records in `_static` the parts without nodes, which `_again` does not copy
            self._seen[id(value)] = value
        return self._again(value, iter(numbers))

    def _again(self, value: Any, numbers: Iterator[Mapping[Node, Any]]) -> Any:
        if isinstance(value, self.kind):
            return next(numbers)[value]
        if value is None or isinstance(value, _PLAIN) or id(value) in self._static or id(value) in self._open:
            return value
        if isinstance(value, np.ndarray):
            new = next(numbers)
            return array_of([new[x] if isinstance(x, self.kind) else x for x in value.ravel().tolist()], value.shape)
        if isinstance(value, types.FunctionType):
            return self._function_again(value, numbers)
        if isinstance(value, types.MethodType):
            return types.MethodType(value.__func__, self._again(value.__self__, numbers))
        return _rebuilt(value, lambda x: self._again(x, numbers))

    def _function_again(self, value: types.FunctionType, numbers: Iterator[Mapping[Node, Any]]) -> Any:
        self._open.add(id(value))
        cells = tuple([types.CellType(self._again(_content(cell), numbers)) for cell in value.__closure__ or ()])
        defaults = self._again(value.__defaults__, numbers)
        other = types.FunctionType(value.__code__, value.__globals__, value.__name__, defaults, cells)
        other.__kwdefaults__ = self._again(value.__kwdefaults__, numbers)
        self._open.remove(id(value))
        return other


def numbers_of(value: Any) -> list[Any]:
    """Return all numbers of a value, traced or not, in order."""
    found: list[Any] = []
    with_numbers(value, lambda x: found.append(x))
    return found


def with_numbers(value: Any, new: Callable[[Any], Any]) -> Any:
    """Return the value with every number x, traced or not, replaced by `new(x)`, in order."""
    if isinstance(value, Node | Constant) or (isinstance(value, NUMBERS) and not isinstance(value, bool)):
        return new(value)
    if isinstance(value, np.ndarray):
        return array_of([new(x) for x in value.flat], value.shape)
    if isinstance(value, tuple | list | dict) or dataclasses.is_dataclass(value):
        return _rebuilt(value, lambda x: with_numbers(x, new))
    return value


def _rebuilt(value: Any, again: Callable[[Any], Any]) -> Any:
    """Return a tuple, list, dict or dataclass in which every part x is replaced by `again(x)`."""
    if isinstance(value, tuple) and hasattr(value, "_make"):
        return type(value)._make([again(x) for x in value])  # type: ignore[attr-defined]
    if isinstance(value, _SEQUENCES):
        return type(value)([again(x) for x in value])
    if isinstance(value, dict):
        return {name: again(x) for name, x in value.items()}
    other = object.__new__(type(value))  # skips the checks of `__init__`, which the original has passed
    for name in _fields(type(value)) or ():
        object.__setattr__(other, name, again(getattr(value, name)))
    return other


@functools.cache
def _fields(kind: type) -> tuple[str, ...] | None:
    """Return the names of the fields of a dataclass, or None for another class."""
    return tuple([field.name for field in dataclasses.fields(kind)]) if dataclasses.is_dataclass(kind) else None


def _content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # the variable has no value yet
        return None


def array_of(entries: Sequence[Any], shape: tuple[int, ...]) -> np.ndarray:
    """Return a read-only array of objects, as a traced function receives its arguments."""
    found = np.fromiter(entries, object, len(entries)).reshape(shape)
    found.flags.writeable = False
    return found
