"""Writing a file so that it is whole or absent, whenever the process may die."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import IO

from holdfast.errors import ResultError


def write_atomically(path: Path, content: bytes | Callable[[IO[bytes]], object]) -> None:
    """Write a file beside its place, then move it there.

    Args:
        path: its place.
        content: the bytes, or what writes them to an open file.

    Raises:
        ResultError: it cannot be written; what was at its place is still there.
    """
    beside = path.with_name(path.name + ".part")
    try:
        with beside.open("wb") as file:
            if callable(content):
                content(file)
            else:
                file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except OSError as cause:
        raise ResultError(f"{path}: cannot be written: {cause.strerror or cause}") from cause
