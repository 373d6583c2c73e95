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
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.compiler.constant import NUMBER_TYPES, Constant
from holdfast.compiler.node import Node

_PLAIN = (str, bool, Constant, *NUMBER_TYPES)
_WORDS = (str, bool)
_SEQUENCES = (tuple, list)

Leaf = Sequence[Node]  # the distinct nodes of one array, in order of appearance


class ImagesOf(Protocol):
    """Lazily created nodes for one item's results of a loop body.

    Attributes:
        group: the items that run the body.
        item: the index of the item.
    """

    group: Any
    item: int

    def of(self, nodes: Leaf) -> tuple[Node, ...]:
        """Return the images of nodes."""
        ...


class ItemLeaf(Sequence[Node]):
    """A leaf of one item of a loop, whose nodes are created when first used.

    Attributes:
        images: the images of the item.
        leaf: the leaf of what the loop's body has returned.
    """

    __slots__ = ("_nodes", "images", "leaf")

    def __init__(self, images: ImagesOf, leaf: Leaf) -> None:
        self.images, self.leaf = images, leaf
        self._nodes: tuple[Node, ...] | None = None

    def nodes(self) -> tuple[Node, ...]:
        """Return the nodes."""
        if self._nodes is None:
            self._nodes = self.images.of(self.leaf)
        return self._nodes

    def __len__(self) -> int:
        return len(self.leaf)

    def __getitem__(self, k: Any) -> Any:
        return self.nodes()[k]

    def __iter__(self) -> Iterator[Node]:
        return iter(self.nodes())


class KnownValue(NamedTuple):
    """The key of a value that holds traced nodes, and its leaves `leaves[begin:end]`."""

    value: Any  # kept, so that its id is not reused
    key: Hashable
    leaves: list[Leaf]
    begin: int
    end: int


Maker = Callable[[list[Any], bool], Any]  # rebuilds a value with other numbers per leaf, at once or late


class Values:
    """Splits values, and remembers what it has seen of them.

    Attributes:
        kind: the class of what counts as a traced node.
    """

    def __init__(self, kind: type = Node) -> None:
        self.kind = kind
        # All but `_numbers` are keyed by `id`, and hold the objects too.
        self._static: dict[int, tuple[Any, int]] = {}  # objects without nodes, and the number of their key
        self._numbers: dict[Hashable, int] = {}
        self._known: dict[int, KnownValue] = {}  # arrays, tuples and dataclasses with nodes
        self._makers: dict[int, tuple[Any, list[Leaf], Maker]] = {}
        self._open: set[int] = set()  # functions being visited, which may close over themselves

    def clear(self) -> None:
        """Forget all values; what makes them again refers to this object."""
        self._known.clear()
        self._makers.clear()

    def leaves(self, value: Any) -> tuple[list[Leaf], Hashable]:
        """Return the traced nodes of a value, one leaf per array or scalar, and the key of the rest."""
        found: list[Leaf] = []
        return found, self._key(value, found)

    def _key(self, value: Any, found: list[Leaf]) -> Hashable:
        known = self._known.get(id(value))
        if known is not None:
            found += known.leaves[known.begin : known.end]
            return known.key
        if isinstance(value, self.kind):
            found.append((value,))
            return "node"
        if value is None or isinstance(value, _WORDS):
            return value
        if isinstance(value, NUMBER_TYPES):
            return ("number", float(value).hex())
        if isinstance(value, Constant):
            return ("number", value.value.hex())
        static = self._static.get(id(value))
        if static is not None:
            return static[1]
        before = len(found)
        key = self._made_of(value, found)
        if len(found) > before:
            if _lasting(value):
                self._known[id(value)] = KnownValue(value, key, found, before, len(found))
            return key
        number = self._numbers.setdefault(key, len(self._numbers))
        self._static[id(value)] = (value, number)
        return number

    def _made_of(self, value: Any, found: list[Leaf]) -> Hashable:
        if isinstance(value, np.ndarray):
            return self._array(value, found)
        if isinstance(value, types.FunctionType):
            return self._function(value, found)
        if isinstance(value, types.MethodType):
            return ("method", value.__func__, self._key(value.__self__, found))
        parts = _parts(value)
        if parts is None:
            return ("object", id(value))
        kind = (dict, *value) if isinstance(value, dict) else (_kind(value),)
        return (*kind, *[self._key(x, found) for x in parts])

    def _array(self, value: np.ndarray, found: list[Leaf]) -> Hashable:
        if value.dtype != object:
            return (value.shape, value.dtype.str, value.tobytes())
        entries = value.ravel().tolist()
        all_traced = {*map(type, entries)} == {self.kind}
        leaf = tuple(dict.fromkeys(entries if all_traced else [x for x in entries if isinstance(x, self.kind)]))
        if leaf:
            found.append(leaf)
        if len(leaf) == len(entries):
            return ("distinct", value.shape)
        places = {x: k for k, x in enumerate(leaf)}
        return (value.shape, *[places[x] if isinstance(x, self.kind) else self._key(x, found) for x in entries])

    def _function(self, value: types.FunctionType, found: list[Leaf]) -> Hashable:
        if id(value) in self._open:
            return "itself"
        self._open.add(id(value))
        parts = [self._key(x, found) for x in _closed_over(value)]
        self._open.remove(id(value))
        return ("function", value.__code__, *parts)

    def replaced(self, value: Any, numbers: Iterable[Mapping[Node, Any]]) -> Any:
        """Return the value with other numbers in place of its traced nodes; `numbers` has one mapping per leaf."""
        leaves, make = self._maker_of(value)
        return make([[new[x] for x in leaf] for leaf, new in zip(leaves, numbers, strict=True)], False)

    def images(self, value: Any, images: ImagesOf) -> Any:
        """Return the value of one item of a loop, with images in place of the nodes of what the loop's body returned.

        Its leaves and keys are known from that, and the fields of its dataclasses are made when they are first used.
        """
        leaves, make = self._maker_of(value)
        return make([ItemLeaf(images, leaf) for leaf in leaves], True)

    def _maker_of(self, value: Any) -> tuple[list[Leaf], Maker]:
        """Return the leaves of a value, and its maker."""
        if id(value) not in self._makers:
            leaves, _ = self.leaves(value)  # remembers the parts without nodes, which are not made again
            self._makers[id(value)] = value, leaves, self._maker(value, 0)[0]
        return self._makers[id(value)][1:]

    def _maker(self, value: Any, begin: int) -> tuple[Maker, int]:
        """Return the maker of a value with the leaves `begin` to `end`, and `end`."""
        if value is None or isinstance(value, _PLAIN) or id(value) in self._static or id(value) in self._open:
            return (lambda leaves, late: value), begin
        if isinstance(value, self.kind):
            return (lambda leaves, late: leaves[begin][0]), begin + 1
        if isinstance(value, types.FunctionType):
            self._open.add(id(value))
            parts, end = self._makers_in(_closed_over(value), begin)
            self._open.remove(id(value))
            return (lambda leaves, late: _closure(value, [make(leaves, late) for make in parts])), end
        if isinstance(value, types.MethodType):
            bound, end = self._maker(value.__self__, begin)
            return (lambda leaves, late: types.MethodType(value.__func__, bound(leaves, late))), end
        if isinstance(value, np.ndarray):
            known = self._known[id(value)]
            make, end = _array_maker(value, known.leaves[known.begin], begin), begin + 1
        else:
            parts, end = self._makers_in(_parts(value) or (), begin)
            make = _dataclass_maker(value, parts) if _fields(type(value)) else _container_maker(value, parts)
        if not _lasting(value):
            return make, end
        key = self._known[id(value)].key

        def remembered(leaves: list[Any], late: bool) -> Any:
            other = make(leaves, late)
            if late:
                self._known[id(other)] = KnownValue(other, key, leaves, begin, end)
            return other

        return remembered, end

    def _makers_in(self, parts: Iterable[Any], end: int) -> tuple[list[Maker], int]:
        """Return the makers of several values, and the number of leaves up to their end."""
        makers = []
        for x in parts:
            make, end = self._maker(x, end)
            makers.append(make)
        return makers, end


def _array_maker(value: np.ndarray, leaf: Leaf, begin: int) -> Maker:
    """Return the maker of an array with the traced nodes `leaf`; it reads the leaf number `begin`."""
    entries, shape = value.ravel().tolist(), value.shape
    if len(leaf) == len(entries):
        return lambda leaves, late: array_of(leaves[begin], shape)
    places = {id(x): k for k, x in enumerate(leaf)}
    known = [(places.get(id(x)), x) for x in entries]
    return lambda leaves, late: array_of([x if k is None else leaves[begin][k] for k, x in known], shape)


def _container_maker(value: Any, parts: list[Maker]) -> Maker:
    """Return the maker of a tuple, list or dict from the makers of its parts."""
    return lambda leaves, late: _with_parts(value, [make(leaves, late) for make in parts])


def _dataclass_maker(value: Any, parts: list[Maker]) -> Maker:
    """Return the maker of a dataclass from those of its parts, called at once, or late, when each is first used."""
    kind = _late(_kind(value))
    makers = dict(zip(_fields(kind) or (), parts, strict=True))

    def make(leaves: list[Any], late: bool) -> Any:
        if not late:
            return _with_parts(value, [make(leaves, late) for make in parts])
        other = object.__new__(kind)
        other.__dict__["_makers"], other.__dict__["_leaves"] = makers, leaves
        return other

    return make


@functools.cache
def _late(kind: type) -> type:
    """Return a subclass of a dataclass in which a field is made when it is first used."""

    def made(name: str) -> functools.cached_property[Any]:
        return functools.cached_property(lambda late: late._makers[name](late._leaves, True))

    return type(kind.__name__, (kind,), {"_late_kind": kind, **{name: made(name) for name in _fields(kind) or ()}})


def _kind(value: Any) -> type:
    """Return the class of a value; that of a late one is what its fields make it."""
    return getattr(type(value), "_late_kind", type(value))


def numbers_of(value: Any) -> list[Any]:
    """Return all numbers of a value, traced or not, in order."""
    found: list[Any] = []
    with_numbers(value, lambda x: found.append(x))
    return found


def with_numbers(value: Any, new: Callable[[Any], Any]) -> Any:
    """Return the value with every number x, traced or not, replaced by `new(x)`, in order."""
    if isinstance(value, Node | Constant) or (isinstance(value, NUMBER_TYPES) and not isinstance(value, bool)):
        return new(value)
    if isinstance(value, np.ndarray):
        return array_of([new(x) for x in value.flat], value.shape)
    parts = _parts(value)
    return value if parts is None else _with_parts(value, [with_numbers(x, new) for x in parts])


def _lasting(value: Any) -> bool:
    """Return whether a value with traced nodes is an array, a tuple or a dataclass, which nobody changes."""
    return not isinstance(value, list | dict | types.FunctionType | types.MethodType)


def _parts(value: Any) -> list[Any] | None:
    """Return the parts of a tuple, list, dict or dataclass, or None for another value."""
    if isinstance(value, _SEQUENCES):
        return list(value)
    if isinstance(value, dict):
        return list(value.values())
    names = _fields(type(value))
    return None if names is None else [getattr(value, name) for name in names]


def _with_parts(value: Any, parts: list[Any]) -> Any:
    """Return a tuple, list, dict or dataclass like `value` with other parts."""
    if isinstance(value, tuple) and hasattr(value, "_make"):
        return type(value)._make(parts)  # type: ignore[attr-defined]
    if isinstance(value, _SEQUENCES):
        return type(value)(parts)
    if isinstance(value, dict):
        return dict(zip(value, parts, strict=True))
    other = object.__new__(_kind(value))  # skips the checks of `__init__`, which the original has passed
    for name, x in zip(_fields(type(value)) or (), parts, strict=True):
        object.__setattr__(other, name, x)
    return other


@functools.cache
def _fields(kind: type) -> tuple[str, ...] | None:
    """Return the names of the fields of a dataclass, or None for another class."""
    return tuple([field.name for field in dataclasses.fields(kind)]) if dataclasses.is_dataclass(kind) else None


def _closed_over(function: types.FunctionType) -> list[Any]:
    """Return the variables that a function closes over, its defaults and its keyword defaults."""
    return [*map(_content, function.__closure__ or ()), function.__defaults__, function.__kwdefaults__]


def _closure(function: types.FunctionType, parts: list[Any]) -> types.FunctionType:
    """Return a function like `function` that closes over other variables; see `_closed_over`."""
    *variables, defaults, keywords = parts
    cells = tuple(map(types.CellType, variables))
    other = types.FunctionType(function.__code__, function.__globals__, function.__name__, defaults, cells)
    other.__kwdefaults__ = keywords
    return other


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
