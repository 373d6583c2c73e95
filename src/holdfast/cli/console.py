"""Tables and documents on stdout, progress on stderr, and `-` as the name of stdin or stdout."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from rich.console import Console

from holdfast.cli.streams import WatchedStdout
from holdfast.errors import ResultError
from holdfast.io import typed
from holdfast.progress import progress_bar

Item = TypeVar("Item")

PIPE_WIDTH = 120  # columns if stdout is not a terminal


class _Console(Console):
    """A console that raises an error if the pipe is closed; rich would exit with code 1."""

    def on_broken_pipe(self) -> None:
        """Raise an error, so that the program chooses the exit code."""
        raise BrokenPipeError


def stdout() -> Console:
    """Return a console that prints names and messages without interpreting markup in them."""
    width = None if sys.stdout.isatty() else PIPE_WIDTH
    return _Console(width=width, markup=False, emoji=False, highlight=False)


def print_document(data: Any) -> None:
    """Print one JSON document on stdout, with null for numbers that are not finite."""
    print(msgspec.json.format(msgspec.json.encode(data), indent=1).decode())


def with_progress(items: list[Item], doing: str) -> Iterator[Item]:
    """Yield the items, with a progress bar on stderr if there are several and stderr is a terminal."""
    if len(items) < 2 or not sys.stderr.isatty():
        yield from items
        return
    with progress_bar(doing) as show:
        for k, item in enumerate(items):
            show(k / len(items), f"{k} of {len(items)}")
            yield item
        show(1.0, f"{len(items)} of {len(items)}")


def is_standard(path: Path | None) -> bool:
    """Return whether a path is `-`, which stands for stdin or stdout."""
    return path is not None and str(path) == "-"


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


def refuse_standard(out: Path | None) -> None:
    """Refuse `-` for `--out` where it names a folder to write.

    Raises:
        ResultError: the path is `-`.
    """
    if is_standard(out):
        raise ResultError("--out: expected a folder, got '-' (stdout), which takes single files only")
