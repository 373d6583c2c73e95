"""Writing a file so that it is whole or absent, whenever the process or the machine may die."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO

from holdfast.errors import ResultError
from holdfast.io.place import LONGEST_NAME, one_line


def write_atomically(path: Path, content: bytes | Callable[[IO[bytes]], object]) -> None:
    """Write a file beside its place, then move it there; when this returns it is on disk to stay.

    Costs two waits for the disk: for the file, and for the folder that names it.

    Args:
        path: its place.
        content: the bytes, or what writes them to an open file.

    Raises:
        ResultError: it cannot be written; what was at its place is still there.
    """
    require_file(path)
    name = one_line(str(path), LONGEST_NAME)
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
            with contextlib.suppress(OSError):
                beside.unlink(missing_ok=True)
            raise
        keep_names(path.parent)
    except OSError as cause:
        raise ResultError(f"{name}: cannot be written: {cause.strerror or cause}") from cause


def require_file(path: Path) -> None:
    """Refuse what cannot be a file's place: no name, a folder, or a device, which a file must not take the place of.

    Raises:
        ResultError: saying which.
    """
    name = one_line(str(path), LONGEST_NAME)
    if "\0" in str(path):
        raise ResultError(f"{name}: cannot be written: no file's name has a null character")
    if path.name in ("", ".."):
        raise ResultError(f"{name}: cannot be written: expected the name of a file")
    if os.path.exists(path) and not os.path.isfile(path):
        raise ResultError(f"{name}: cannot be written: is not a file")


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
