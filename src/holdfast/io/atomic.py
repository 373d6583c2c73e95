"""Writing a file so that it is whole or absent, whenever the process or the machine may die."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import IO

from holdfast.errors import ResultError


def write_atomically(path: Path, content: bytes | Callable[[IO[bytes]], object]) -> None:
    """Write a file beside its place, then move it there; when this returns it is on disk to stay.

    Costs two waits for the disk: for the file, and for the folder that names it.

    Args:
        path: its place.
        content: the bytes, or what writes them to an open file.

    Raises:
        ResultError: it cannot be written; what was at its place is still there.
    """
    if "\0" in str(path):
        raise ResultError(f"{ascii(str(path))}: cannot be written: no file's name has a null character")
    beside = path.with_name(path.name + ".part")
    try:
        try:
            with beside.open("wb") as file:
                if callable(content):
                    content(file)
                else:
                    file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(beside, path)
        except BaseException:
            beside.unlink(missing_ok=True)
            raise
        keep_names(path.parent)
    except OSError as cause:
        raise ResultError(f"{path}: cannot be written: {cause.strerror or cause}") from cause


def remove(*paths: Path) -> None:
    """Remove files, those that are there.

    Raises:
        ResultError: one cannot be removed.
    """
    for path in paths:
        try:
            path.unlink(missing_ok=True)
        except OSError as cause:
            raise ResultError(f"{path}: cannot be removed: {cause.strerror or cause}") from cause


def keep_names(folder: Path) -> None:
    """Wait until the names in a folder are on disk: a moved or new file may otherwise be lost with the power.

    Raises:
        OSError: the folder cannot be opened.
    """
    if os.name == "nt":  # no folder can be opened there; NTFS keeps names in its own journal
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
