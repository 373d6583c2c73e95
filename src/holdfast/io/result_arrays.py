"""Arrays by name, and plain data beside them, in one .npz file that is whole or known not to be."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.io.atomic import write_atomically
from holdfast.spatial.scalar import Array

_UNREADABLE = (OSError, ValueError, KeyError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)


class Damage(Exception):
    """A file is missing or torn, or does not hold what meta.json says; the message names it."""


def write_arrays(path: Path, arrays: Mapping[str, Array], **texts: Any) -> None:
    """Write arrays and plain data by name, all or none; plain data as a text array of JSON.

    Raises:
        ResultError: they cannot be written.
    """
    held = dict(arrays) | {name: np.array(msgspec.json.encode(data).decode()) for name, data in texts.items()}
    write_atomically(path, lambda file: np.savez(file, **held))  # pyright: ignore[reportArgumentType]


def read_arrays(path: Path, *texts: str) -> tuple[dict[str, Array], dict[str, Any]]:
    """Return the arrays of a file by name, and the plain data of the given names.

    Raises:
        Damage: there is no such file, not one byte of it may be believed, or it lacks the plain data.
    """
    if not path.is_file():
        raise Damage(f"{path.name} is {'not a file' if path.exists() else 'missing'}")
    try:
        # opened here: np.load leaves a file open when it is damaged
        with path.open("rb") as raw:
            with zipfile.ZipFile(raw) as archive:
                # ours are stored as they are; what unpacks to more than the file holds was made to fill the memory
                if sum(part.file_size for part in archive.infolist()) > path.stat().st_size:
                    raise Damage(f"{path.name} is damaged: it unpacks to more than it holds")
                torn = archive.testzip()  # before any header is trusted
            if torn is not None:
                raise Damage(f"{path.name} is damaged at '{torn}'")
            raw.seek(0)
            with np.load(raw, allow_pickle=False) as file:
                held = {name: file[name] for name in file.files}
        return held, {name: msgspec.json.decode(held.pop(name).item()) for name in texts}
    except _UNREADABLE as cause:
        raise Damage(f"{path.name} is damaged") from cause
