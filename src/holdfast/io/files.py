"""Files and folders: their paths, and reading and writing them so that each is whole or absent after any death."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from os import PathLike, fspath
from pathlib import Path
from typing import IO, Any

from holdfast.errors import HoldfastError, ResultError

LONGEST_MESSAGE = 600  # characters; names and values that a file contains are quoted in it
LONGEST_NAME = 200  # of a file or a path inside it


def one_line(text: str, most: int = LONGEST_MESSAGE) -> str:
    """Return a text as messages show it: on one line, printable, cut to at most so many characters."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[: most + 1])
    return shown if len(shown) <= most else shown[: most - 3] + "..."


def file_path(given: Any, what: str, error: type[HoldfastError] = ResultError) -> Path:
    """Return a path from a str or a path object.

    Args:
        given: the argument.
        what: its name, for the message.
        error: the type of the error.

    Raises:
        HoldfastError: of that kind, if it is neither, or empty.
    """
    name = fspath(given) if isinstance(given, str | PathLike) else given
    if not isinstance(name, str):
        raise error(f"{what}: expected a path (str or pathlib.Path), got {type(given).__name__}")
    if not name:
        raise error(f"{what}: expected a path, got an empty text")
    return Path(name)


def read_bounded(path: Path, most: int) -> bytes:
    """Return a file's bytes; of a file larger than `most`, only the first most + 1.

    Raises:
        OSError: it cannot be read; the message or `strerror` says why.
    """
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise OSError("is not a file")  # a device or a pipe, which might never end
        with path.open("rb") as file:
            return file.read(most + 1)
    except ValueError as cause:  # a path that no file system takes
        raise OSError(str(cause)) from cause


def names_in(folder: Path, what: str) -> list[str]:
    """Return the sorted names in a folder, or an empty list.

    Args:
        folder: the folder.
        what: what the folder is to be, for the message.

    Raises:
        ResultError: it is not a folder, or cannot be read.
    """
    try:
        return sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    except (OSError, ValueError) as cause:
        raise ResultError(f"{one_line(str(folder), LONGEST_NAME)}: cannot be {what}: {reason_of(cause)}") from cause


def make_folder(folder: Path) -> None:
    """Create a folder, and those above it, unless they are there.

    Raises:
        ResultError: it cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as cause:
        raise _unwritable(folder, reason_of(cause)) from cause


def reason_of(cause: OSError | ValueError) -> str:
    """Return why a file cannot be read or written: as the operating system says it, or why no system takes its name."""
    return getattr(cause, "strerror", None) or str(cause)


def write_atomically(path: Path, content: bytes | Callable[[IO[bytes]], object]) -> None:
    """Write a file under another name, then move it to its path; it is durable when this returns.

    Costs two waits for the disk: for the file, and for the folder that names it.

    Args:
        path: the path.
        content: the bytes, or a function that writes them to an open file.

    Raises:
        ResultError: it cannot be written; an earlier file at the path is kept.
    """
    require_file(path)
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
        _keep_names(path.parent)
    except OSError as cause:
        raise _unwritable(path, reason_of(cause)) from cause


def require_file(path: Path) -> None:
    """Refuse a path that a file cannot have: one without a name, a folder, or a device, which must not be replaced.

    Raises:
        ResultError: saying which.
    """
    if "\0" in str(path):
        raise _unwritable(path, "no file's name has a null character")
    if path.name in ("", ".."):
        raise _unwritable(path, "expected the name of a file")
    if os.path.exists(path) and not os.path.isfile(path):
        raise _unwritable(path, "is not a file")


def remove(*paths: Path) -> None:
    """Delete files; those that do not exist are skipped.

    Raises:
        ResultError: one cannot be removed.
    """
    for path in paths:
        try:
            path.unlink(missing_ok=True)
        except OSError as cause:
            raise ResultError(f"{path}: cannot be removed: {reason_of(cause)}") from cause


def _unwritable(path: Path, reason: str) -> ResultError:
    return ResultError(f"{one_line(str(path), LONGEST_NAME)}: cannot be written: {reason}")


def _keep_names(folder: Path) -> None:
    """Wait until the names in a folder are on disk: a moved or new file may otherwise be lost with the power."""
    if os.name == "nt":  # no folder can be opened there; NTFS keeps names in its own journal
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def replaced_folder(folder: Path, owns: Callable[[str], bool]) -> Iterator[Path]:
    """Yield a new folder, which replaces another one if no error occurs.

    The old one is kept until then, also if the writer fails or is killed. A writer that is killed leaves
    `<folder>.<random>.part` beside it.

    Args:
        folder: the path; what is in it may be replaced.
        owns: returns whether a file of this name is replaced with the folder; others are moved to the new one.

    Raises:
        ResultError: it cannot be written.
    """
    token = secrets.token_hex(4)
    try:
        place = Path(os.path.realpath(folder))
        if place == Path.cwd() or place in Path.cwd().parents:
            raise ResultError(
                f"{folder}: cannot be replaced, because it contains the working directory; try a new folder"
            )
        beside, aside = (place.with_name(f"{place.name}.{token}{end}.part") for end in ("", ".old"))
        beside.mkdir(parents=True)
    except (OSError, ValueError) as cause:
        raise ResultError(f"{one_line(str(folder), LONGEST_NAME)}: cannot be written: {reason_of(cause)}") from cause
    try:
        yield beside
        _swap(place, beside, aside)
    except OSError as cause:
        raise ResultError(f"{folder}: cannot be written: {reason_of(cause)}") from cause
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    if aside.exists():
        for path in aside.iterdir():
            if not owns(path.name) and not (place / path.name).exists():
                os.replace(path, place / path.name)
        shutil.rmtree(aside, ignore_errors=True)


def _swap(place: Path, beside: Path, aside: Path) -> None:
    """Move the new folder to its place and the old one aside; if that fails, the old one is back."""
    if not place.exists():
        os.replace(beside, place)
        return
    os.replace(place, aside)
    try:
        os.replace(beside, place)
    except BaseException:
        os.replace(aside, place)
        raise
