"""Fingerprints of models: two models with the same fingerprint give the same run."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from types import FunctionType, MethodType
from typing import Any

import numpy as np

# marks a field that was added in a later version; its default is not included, so that fingerprints do not change
ADDED = {"added": True}
OMITTED = {**ADDED, "omitted": True}  # the same, and the default is left out of files
PICTURE = {"picture": True}  # marks a field without influence on results; it is not included


def fingerprint(model: Any) -> str:
    """Return the SHA-256 of a model's names and numbers, in hexadecimal.

    Args:
        model: a dataclass of numbers, strings, arrays, and of dataclasses, mappings and sequences
            of these. Anything else in it, such as functions and visuals, is ignored.
    """
    return digest_of(_parts(model, exact=False))


def exact_fingerprint(value: Any) -> str | None:
    """Return a fingerprint of everything that determines the result of calling `value`; None if it is not known.

    The fingerprint includes types and methods. It is None for functions and classes of the user, whose code may change.

    Args:
        value: an object of this library, or a method of one.
    """
    try:
        return digest_of(_parts(value, exact=True))
    except TypeError:
        return None


def code_key(value: Any) -> str:
    """Return a key of code made of `value`; a random one, never found again, if its fingerprint is not known."""
    return exact_fingerprint(value) or secrets.token_hex()


def digest_of(parts: Iterable[bytes]) -> str:
    """Return the SHA-256 digest of byte strings and their lengths, in hexadecimal digits."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))  # distinguishes ("ab", "c") from ("a", "bc")
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
        value = {f.name: x for f, x in own if not f.metadata.get("added") or not is_default(x, f.default)}
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


def is_default(x: Any, default: Any) -> bool:
    """Return whether a field has its default, or is an empty mapping."""
    if isinstance(x, Mapping):
        return not x
    return x is None or bool(np.array_equal(x, default))


def _name_of(own: Any) -> str:
    if (own.__module__ or "").split(".")[0] != __name__.split(".")[0]:
        raise TypeError(f"{own.__qualname__} is no part of this library")
    return f"{own.__module__}.{own.__qualname__}"
