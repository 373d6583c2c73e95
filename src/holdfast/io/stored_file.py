"""Files of a folder with a manifest: read only if they are those that its digests name, and arrays in them."""

from __future__ import annotations

import hashlib
import io
import os
import sys
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.errors import ResultError
from holdfast.io.files import LONGEST_NAME, one_line, read_bounded, reason_of
from holdfast.spatial.scalar import Array

LARGEST_FILE = 64 * 2**20  # [bytes] of a manifest, a scene, a model and a robot; arrays lie elsewhere
UNREADABLE = (OSError, ValueError, KeyError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)
CHANGED = "changed while it was read; try again"


class Damage(ResultError):
    """A file is missing, damaged, or in the place of another one; the message names it."""


def stored(folder: Path, name: str, files: Mapping[str, str | None], most: int = LARGEST_FILE) -> bytes:
    """Return the bytes of a file, compared with its digest.

    Args:
        folder: the folder.
        name: name of the file.
        files: digests by name, of the manifest.
        most: largest number of bytes.

    Raises:
        Damage: it is missing, damaged, too large or another file.
    """
    path = folder / name
    try:
        if name not in files or os.path.basename(name) != name:
            raise Damage(f"{one_line(name, LONGEST_NAME)} is not named by the manifest")
        if not path.is_file():
            raise Damage(f"{name} is {'not a file' if path.exists() else 'missing'}")
        if (size := path.stat().st_size) > most:
            raise Damage(f"{name}: expected at most {most >> 20} MiB, got more")
        content = read_bounded(path, size)
    except OSError as cause:
        raise Damage(f"{name} cannot be read: {reason_of(cause)}") from cause
    if files[name] not in (None, sha256(content)):
        raise Damage(f"{name} is damaged, or another file: its SHA-256 is not that in the manifest")
    return content


@contextmanager
def advising(folder: Path, advice: str) -> Iterator[None]:
    """Add the folder and an advice to the message of damage."""
    try:
        yield
    except Damage as damage:
        raise Damage(f"{folder}: {damage}; {advice}") from damage


def arrays_text(arrays: Mapping[str, Array], name: str, data: Any) -> bytes:
    """Return arrays by name, and plain data as an array of JSON text under `name`, as the bytes of an .npz file."""
    file = io.BytesIO()
    np.savez(file, **arrays, **{name: np.array(msgspec.json.encode(data).decode())})  # pyright: ignore[reportArgumentType]
    return file.getvalue()


def read_arrays(folder: Path, name: str, files: Mapping[str, str | None], data: str) -> tuple[dict[str, Array], Any]:
    """Return the arrays of an .npz file by name, and the plain data under the name `data`.

    Raises:
        Damage: the file is missing or damaged, or lacks the plain data.
    """
    content = stored(folder, name, files, most=sys.maxsize)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            # our arrays are not compressed; a file that unpacks to more than its size was made to fill the memory
            if sum(part.file_size for part in archive.infolist()) > len(content):
                raise Damage(f"{name} is damaged: it unpacks to more than the size of the file")
            if files[name] is None and (torn := archive.testzip()):  # checked before any header is trusted
                raise Damage(f"{name} is damaged at '{torn}'")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            held = {title: file[title] for title in file.files}
        return held, msgspec.json.decode(held.pop(data).item())
    except Damage:
        raise
    except UNREADABLE as cause:
        raise Damage(f"{name} is damaged") from cause


def json_text(data: Any) -> bytes:
    """Return data as indented JSON."""
    return msgspec.json.format(msgspec.json.encode(data), indent=2) + b"\n"


def sha256(content: bytes) -> str:
    """Return the SHA-256 of some bytes, hexadecimal."""
    return hashlib.sha256(content).hexdigest()
