"""Tables on stdout, progress on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

import msgspec
from rich.console import Console
from rich.progress import track

T = TypeVar("T")

PIPE_WIDTH = 120  # columns when no terminal tells its width


class _Console(Console):
    """A console that raises where its reader has gone; rich would end the process by itself, with 1."""

    def on_broken_pipe(self) -> None:
        """Let the program say how it ends."""
        raise BrokenPipeError


def stdout() -> Console:
    """Return a console that prints names and messages as they are."""
    width = None if sys.stdout.isatty() else PIPE_WIDTH
    return _Console(width=width, markup=False, emoji=False, highlight=False)


def print_document(data: Any) -> None:
    """Print one JSON document on stdout; numbers that are not finite are null in it."""
    print(msgspec.json.format(msgspec.json.encode(data), indent=1).decode())


def with_progress(items: list[T], doing: str) -> Iterator[T] | Iterable[T]:
    """Return the items, with a progress bar on stderr if there are many and someone looks."""
    if len(items) < 2 or not sys.stderr.isatty():
        return items
    return track(items, description=doing, console=Console(stderr=True), transient=True)
