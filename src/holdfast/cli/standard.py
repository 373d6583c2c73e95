"""Reading stdin and writing stdout where `-` is given as a file name."""

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
    """Return whether a path is `-`, which stands for stdin or stdout."""
    return path is not None and str(path) == STANDARD


def read_stdin(most: int = typed.LARGEST_TEXT) -> bytes:
    """Return the content of stdin.

    Args:
        most: largest allowed number of bytes.

    Raises:
        SceneError: stdin cannot be read, or has more bytes.
    """
    try:
        content = sys.stdin.buffer.read(most + 1)
    except (OSError, ValueError, AttributeError) as cause:  # a closed stdin is None
        raise typed.refusal("stdin", "cannot be read") from cause
    if len(content) > most:
        raise typed.refusal("stdin", f"expected at most {most / 2**20:g} MiB, got more")
    return content


def write_stdout(make: Callable[[Path], Any], name: str) -> None:
    """Write a file's content to stdout, either completely or not at all.

    Args:
        make: function that writes the file to a path.
        name: name of the file, whose extension may matter.
    """
    with tempfile.TemporaryDirectory() as folder:
        make(Path(folder) / name)
        content = (Path(folder) / name).read_bytes()
    if isinstance(sys.stdout, WatchedStdout):
        sys.stdout.write_bytes(content)


def read_input(path: Path, most: int = typed.LARGEST_TEXT) -> tuple[bytes, str]:
    """Return the bytes of a file or of stdin, and its name for messages.

    Raises:
        SceneError: it cannot be read, or is too large.
    """
    return (read_stdin(most), "stdin") if is_standard(path) else (typed.read_bytes(path, most), str(path))


def refuse_standard(path: Path | None, option: str) -> None:
    """Refuse `-` for options that name a folder to write.

    Raises:
        ResultError: the path is `-`; the message names the option.
    """
    if is_standard(path):
        raise ResultError(f"{option}: expected a folder, got '-' (stdout), which takes single files only")
