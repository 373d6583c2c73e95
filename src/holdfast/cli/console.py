"""Tables on stdout, progress on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

import msgspec
from rich.console import Console
from rich.progress import track

T = TypeVar("T")

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


def with_progress(items: list[T], doing: str) -> Iterator[T] | Iterable[T]:
    """Return the items, with a progress bar on stderr if there are several and stderr is a terminal."""
    if len(items) < 2 or not sys.stderr.isatty():
        return items
    return track(items, description=doing, console=Console(stderr=True), transient=True)
