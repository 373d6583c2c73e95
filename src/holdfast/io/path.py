"""Paths as callers give them: texts or path objects."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path
from typing import Any

from holdfast.errors import HoldfastError, ResultError


def file_path(given: Any, what: str, error: type[HoldfastError] = ResultError) -> Path:
    """Return a path from a str or a path object.

    Args:
        given: what the caller gave.
        what: its name, for the message.
        error: what to raise.

    Raises:
        HoldfastError: of that kind, if it is neither, or empty.
    """
    name = fspath(given) if isinstance(given, str | PathLike) else given
    if not isinstance(name, str):
        raise error(f"{what}: expected a path (str or pathlib.Path), got {type(given).__name__}")
    if not name:
        raise error(f"{what}: expected a path, got an empty text")
    return Path(name)
