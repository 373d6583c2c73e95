"""The exit codes, and robust use of the standard streams, which may be closed, full, or a closed pipe."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from typing import Any, Self, TextIO, cast

from holdfast import progress

EXIT_BAD_INPUT, EXIT_REFUSED, EXIT_FAULT, EXIT_NO_MEMORY, EXIT_INTERRUPTED = 2, 3, 70, 71, 130
EXIT_OUTPUT, EXIT_READER_GONE = 74, 141  # EX_IOERR of sysexits.h; 128 + SIGPIPE


def open_streams() -> bool:
    """Make the standard streams safe to use; return whether stdout is open.

    A closed stream is replaced by /dev/null, because otherwise the next file to be opened would get its number.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, which is that of the closed stream
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # escape characters that the terminal cannot encode
            stream.reconfigure(errors="backslashreplace")
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    return sys.stdout is not None


def say(line: str) -> None:
    """Print a line on stderr; a stderr that cannot be written is silenced, as it would fail again at exit."""
    if not progress.say(line):
        _silence(sys.stderr)


def complain(problem: str) -> None:
    """Print an error as one line on stderr, if stderr can be written."""
    say(f"holdfast: error: {' '.join(problem.split())}")


class WatchedStdout:
    """A replacement for stdout that stores its first error, so that it can be told from errors of other files.

    Attributes:
        fault: the first error; None if there was none.
    """

    def __init__(self) -> None:
        self._stream = sys.stdout
        self.fault: OSError | None = None

    def __enter__(self) -> Self:
        sys.stdout = cast(TextIO, self)
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            self.flush()
        sys.stdout = self._stream
        if self.fault is not None:
            _silence(self._stream)

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the stream, such as its encoding or `isatty`."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text."""
        with self._remembering():
            return self._stream.write(text)

    def write_bytes(self, content: bytes) -> None:
        """Write bytes as they are, after the text so far."""
        with self._remembering():
            self._stream.flush()
            self._stream.buffer.write(content)

    def flush(self) -> None:
        """Flush the stream."""
        with self._remembering():
            self._stream.flush()

    @contextlib.contextmanager
    def _remembering(self) -> Iterator[None]:
        try:
            yield
        except OSError as cause:
            self.fault = self.fault or cause
            raise


def _silence(stream: TextIO) -> None:
    """Redirect a stream to /dev/null, so that flushing its buffer at exit raises no error."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
