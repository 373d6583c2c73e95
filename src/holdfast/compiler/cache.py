"""A cache of object code on disk, so that each program is compiled only once.

An entry is executable code, and a damaged entry would crash the process inside LLVM. The folder is therefore used
only if it belongs to the user and nobody else has access to it. An entry is used only if its magic number, its length
and its SHA-256 digest (of key and code) are right; otherwise it is removed and built again.

`HOLDFAST_CACHE=off` turns the cache off; `HOLDFAST_CACHE=PATH` moves it to another folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tempfile
from pathlib import Path

SIZE_CAP = 256 * 2**20  # bytes; above this size the least recently used entries are removed

_MAGIC = b"holdfst3"
_HEAD = len(_MAGIC) + 8 + 32
_SUFFIX = ".code"


def key_of(*parts: str) -> str:
    """Return the cache key of the code that these parts determine: a SHA-256 digest."""
    digest = hashlib.sha256()
    for part in parts:
        text = part.encode()
        digest.update(len(text).to_bytes(8, "little"))  # so that ("ab", "c") and ("a", "bc") have different keys
        digest.update(text)
    return digest.hexdigest()


def folder() -> Path | None:
    """Return the cache's folder, created if necessary, or None if the cache is off or not safe to use."""
    choice = os.environ.get("HOLDFAST_CACHE", "")
    if choice == "off" or not hasattr(os, "getuid"):
        return None
    try:
        path = Path(choice) if choice else _default_folder()
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.lstat()
    except (OSError, RuntimeError):  # a RuntimeError means that the user has no home folder
        return None
    mine = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
    return path if mine and not found.st_mode & 0o077 else None


def load(key: str) -> bytes | None:
    """Return the code stored under a key, or None if there is no undamaged entry."""
    place = folder()
    if place is None:
        return None
    path = place / (key + _SUFFIX)
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW), "rb") as file:
            entry = file.read()
    except OSError:
        return None
    code = entry[_HEAD:]
    if entry[:_HEAD] != _head(key, code):
        _remove(path)
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # marks the entry as the most recently used
    return code


def store(key: str, code: bytes) -> None:
    """Store code under a key atomically. A full or read-only disk is not an error: nothing is stored then."""
    place = folder()
    if place is None:
        return
    try:
        handle, temporary = tempfile.mkstemp(dir=place, suffix=_SUFFIX + ".part")  # readable by the user only
    except OSError:
        return
    try:
        with open(handle, "wb") as file:
            file.write(_head(key, code) + code)
        os.replace(temporary, place / (key + _SUFFIX))
    except OSError:
        _remove(Path(temporary))
    _trim(place)


def _head(key: str, code: bytes) -> bytes:
    # The digest includes the key, so that an entry whose file was renamed is rejected.
    digest = hashlib.sha256(key.encode() + code).digest()
    return _MAGIC + len(code).to_bytes(8, "little") + digest


def _trim(place: Path) -> None:
    """Remove the least recently used entries until the others are within `SIZE_CAP`."""
    entries = []  # these include the temporary files of writers that were killed
    with contextlib.suppress(OSError), os.scandir(place) as files:
        for file in files:
            if _SUFFIX in file.name:
                with contextlib.suppress(OSError):  # another process may remove entries at the same time
                    found = file.stat()
                    entries.append((found.st_mtime_ns, found.st_size, file.path))
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= SIZE_CAP:
            return
        _remove(Path(path))
        total -= size


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def _default_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "holdfast"
