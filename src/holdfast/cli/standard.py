"""`-` in the place of a file's name: stdin, stdout."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from holdfast.cli.streams import WatchedStdout
from holdfast.errors import ResultError
from holdfast.io import typed

STANDARD = "-"


def is_standard(path: Path | None) -> bool:
    """Return whether a file's name stands for stdin or stdout: `-`."""
    return path is not None and str(path) == STANDARD


def read_stdin(most: int = typed.LARGEST_FILE) -> bytes:
    """Return what stdin has.

    Args:
        most: how many bytes it may have.

    Raises:
        SceneError: it cannot be read, or has more.
    """
    try:
        content = sys.stdin.buffer.read(most + 1)
    except (OSError, ValueError, AttributeError) as cause:  # a closed one is None
        raise typed.refusal("stdin", "cannot be read") from cause
    if len(content) > most:
        raise typed.refusal("stdin", f"expected at most {most / 2**20:g} MiB, got more")
    return content


def write_stdout(make: Callable[[Path], Any], name: str) -> None:
    """Write a file's content to stdout, which gets all of it or nothing.

    Args:
        make: writes the file at a path.
        name: of the file, whose ending may matter.
    """
    with tempfile.TemporaryDirectory() as folder:
        make(Path(folder) / name)
        content = (Path(folder) / name).read_bytes()
    if isinstance(sys.stdout, WatchedStdout):
        sys.stdout.write_bytes(content)


def read_input(path: Path, most: int = typed.LARGEST_FILE) -> tuple[bytes, str]:
    """Return the bytes of a file, or of stdin, and what messages call it.

    Raises:
        SceneError: it cannot be read, or is too large.
    """
    return (read_stdin(most), "stdin") if is_standard(path) else (typed.read_bytes(path, most), str(path))


def refuse_standard(path: Path | None, option: str) -> None:
    """Refuse `-` where a folder is written.

    Raises:
        ResultError: naming the option.
    """
    if is_standard(path):
        raise ResultError(f"{option}: expected a folder, got '-' (stdout), which takes single files only")
