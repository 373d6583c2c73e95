"""Object code on disk, so that a program is compiled once.

An entry is executable code, and a damaged one ends the process inside LLVM. So the folder is used
only if it belongs to the user and is closed to others, and an entry only if its magic, length and
SHA-256 (of key and code) are right; any other is removed and built again.

`HOLDFAST_CACHE=off` turns the cache off, `HOLDFAST_CACHE=PATH` puts it elsewhere.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tempfile
from pathlib import Path

SIZE_CAP = 256 * 2**20  # bytes; beyond it the entries unused for longest go

_MAGIC = b"holdfst2"
_HEAD = len(_MAGIC) + 8 + 32
_SUFFIX = ".code"


def key_of(*parts: str) -> str:
    """Return the name of the code that these parts determine."""
    digest = hashlib.sha256()
    for part in parts:
        text = part.encode()
        digest.update(len(text).to_bytes(8, "little"))  # ("ab", "c") is not ("a", "bc")
        digest.update(text)
    return digest.hexdigest()


def folder() -> Path | None:
    """Return the cache's folder, made if need be, or None if it is off or not safe to use."""
    choice = os.environ.get("HOLDFAST_CACHE", "")
    if choice == "off" or not hasattr(os, "getuid"):
        return None
    try:
        path = Path(choice) if choice else _default_folder()
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.lstat()
    except (OSError, RuntimeError):  # RuntimeError: there is no home
        return None
    mine = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
    return path if mine and not found.st_mode & 0o077 else None


def load(key: str) -> bytes | None:
    """Return the code stored under a key if it is there and whole."""
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
        os.utime(path)  # used now: last to go
    return code


def store(key: str, code: bytes) -> None:
    """Store code under a key, all of it or nothing; a full or read-only disk is no error."""
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
    # with the key, so that an entry under another's name is not taken for it
    digest = hashlib.sha256(key.encode() + code).digest()
    return _MAGIC + len(code).to_bytes(8, "little") + digest


def _trim(place: Path) -> None:
    """Remove the entries unused for longest, until the rest is within the cap."""
    entries = []  # what killed writers left is among them
    for path in place.glob(f"*{_SUFFIX}*"):
        with contextlib.suppress(OSError):  # another process may trim too
            found = path.stat()
            entries.append((found.st_mtime_ns, found.st_size, path))
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= SIZE_CAP:
            return
        _remove(path)
        total -= size


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def _default_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "holdfast"
