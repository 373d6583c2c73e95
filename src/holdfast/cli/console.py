"""Tables on stdout, progress on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any, TypeVar

import msgspec
from rich.console import Console

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
