"""One short text for all numbers of a model: two models with the same one give the same run."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from types import FunctionType, MethodType
from typing import Any

import numpy as np

# of a field that earlier versions did not have: at its default it has no part, so that their models keep their text
ADDED = {"added": True}
PICTURE = {"picture": True}  # of a field that nothing is computed from: it has no part


def fingerprint(model: Any) -> str:
    """Return the SHA-256 of a model's names and numbers, hexadecimal.

    Args:
        model: a dataclass of numbers, texts, arrays, and of dataclasses, mappings and sequences
            of these. Anything else in it (a function, a picture) has no part.
    """
    return _digest(_parts(model, exact=False))


def exact_fingerprint(value: Any) -> str | None:
    """Return the same of all that decides what a call of the value computes, or None if the library cannot know.

    Types have a part in it, and methods. A function or a class of the user's has a text that may change meanwhile.

    Args:
        value: an object of this library's, or a method of one.
    """
    try:
        return _digest(_parts(value, exact=True))
    except TypeError:
        return None


def _digest(parts: Iterator[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))  # ("ab", "c") is not ("a", "bc")
        digest.update(part)
    return digest.hexdigest()


def _parts(value: Any, exact: bool) -> Iterator[bytes]:
    if exact and isinstance(value, MethodType):
        yield _name_of(value.__func__).encode()
        value = value.__self__
    if exact and isinstance(value, FunctionType) and value.__closure__ is None:
        yield _name_of(value).encode()
        return
    if exact and type(value) not in (list, tuple) and (is_dataclass(value) or isinstance(value, list | tuple)):
        yield _name_of(type(value)).encode()
    if is_dataclass(value) and not isinstance(value, type):
        own = [(f, getattr(value, f.name)) for f in fields(value) if f.metadata != PICTURE]
        value = {f.name: x for f, x in own if f.metadata != ADDED or not _same(x, f.default)}
    if isinstance(value, Mapping):
        yield b"{"
        for key, item in value.items():
            yield repr(key).encode()
            yield from _parts(item, exact)
        yield b"}"
    elif isinstance(value, list | tuple):
        yield b"["
        for item in value:
            yield from _parts(item, exact)
        yield b"]"
    elif isinstance(value, np.ndarray | np.generic) and value.dtype != object:
        yield f"{value.dtype} {value.shape}".encode()
        yield value.tobytes()
    elif value is None or isinstance(value, bool | int | float | str):
        yield repr(value).encode()
    elif exact:
        raise TypeError(f"a {type(value).__name__} has no fingerprint")


def _same(x: Any, default: Any) -> bool:
    if isinstance(x, Mapping):
        return not x
    return x is None or bool(np.array_equal(x, default))


def _name_of(own: Any) -> str:
    if (own.__module__ or "").split(".")[0] != __name__.split(".")[0]:
        raise TypeError(f"{own.__qualname__} is no part of this library")
    return f"{own.__module__}.{own.__qualname__}"
