"""One short text for all numbers of a model: two models with the same one give the same run."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def fingerprint(model: Any) -> str:
    """Return the SHA-256 of a model's names and numbers, hexadecimal.

    Args:
        model: a dataclass of numbers, texts, arrays, and of dataclasses, mappings and sequences
            of these. Anything else in it (a function, a picture) has no part.
    """
    digest = hashlib.sha256()
    for part in _parts(model):
        digest.update(len(part).to_bytes(8, "little"))  # ("ab", "c") is not ("a", "bc")
        digest.update(part)
    return digest.hexdigest()


def _parts(value: Any) -> Iterator[bytes]:
    if is_dataclass(value) and not isinstance(value, type):
        value = {f.name: getattr(value, f.name) for f in fields(value)}
    if isinstance(value, Mapping):
        yield b"{"
        for key, item in value.items():
            yield repr(key).encode()
            yield from _parts(item)
        yield b"}"
    elif isinstance(value, list | tuple):
        yield b"["
        for item in value:
            yield from _parts(item)
        yield b"]"
    elif isinstance(value, np.ndarray | np.generic):
        yield f"{value.dtype} {value.shape}".encode()
        yield value.tobytes()
    elif value is None or isinstance(value, bool | int | float | str):
        yield repr(value).encode()
