"""Runs `holdfast`, or the run that remembers, and dies by SIGKILL at a given moment.

    python -m tests.acceptance.dying BOOK AT simulate SCENE --out FOLDER ...
    python -m tests.acceptance.dying BOOK AT remembering DURATION FOLDER [--resume]

It writes to BOOK how many samples every finished flush has put on disk. AT counts moves of files into
a result folder; instead of the one of that number comes death. With 0 it lives.
"""

import os
import signal
import sys
from pathlib import Path

from holdfast.io import result_folder
from holdfast.io.result_folder import ResultWriter

# a flush for every second sample, so that a short run has many
result_folder.CHUNK, result_folder.LONGEST_WAIT = 2, float("inf")
flush, replace = ResultWriter.flush, os.replace
moves = 0


def keep_books(path: str) -> None:
    """Write down every flush, after it."""
    book = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def kept(writer: ResultWriter) -> None:
        flush(writer)
        os.write(book, f"{writer.samples}\n".encode())

    ResultWriter.flush = kept


def die_at(at: int) -> None:
    """Die between the writing of a file and its move."""

    def dying(source: os.PathLike, target: os.PathLike) -> None:
        global moves
        moves += str(source).endswith(".part") and Path(target).suffix in (".json", ".npz", ".toml")
        if moves == at:
            os.kill(os.getpid(), signal.SIGKILL)
        replace(source, target)

    os.replace = dying


if __name__ == "__main__":
    book, at, command, *arguments = sys.argv[1:]
    keep_books(book)
    if at != "0":
        die_at(int(at))
    if command == "remembering":
        from tests.io.remembering import run

        run(Path(arguments[1]), resume="--resume" in arguments, duration=float(arguments[0]))
    else:
        from holdfast.cli import main

        sys.exit(main([command, *arguments]))
