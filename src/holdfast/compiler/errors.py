"""The compiler's error, and where in the traced function it happened."""

from __future__ import annotations

import linecache
import sys
import traceback
from pathlib import Path

import numpy as np

from holdfast.errors import HoldfastError

# Stack frames of these files belong to the compiler, to NumPy or to its spelling, not to the traced function.
_MACHINERY = (
    str(Path(__file__).parent),
    str(Path(np.__file__).parent),
    str(Path(__file__).parents[1] / "spatial" / "traced_array.py"),
)


class CompileError(HoldfastError):
    """The compiler cannot handle a traced function, a program or the arguments of a kernel."""


def place_of_call() -> str:
    """Return file, line and source of the innermost running line of a traced function."""
    frame = sys._getframe(1)
    while frame is not None:
        if not _is_machinery(frame.f_code.co_filename):
            return _described(frame.f_code.co_filename, frame.f_lineno)
        frame = frame.f_back
    return "an unknown place"


def place_of_failure(error: BaseException) -> str:
    """Return file, line and source of the innermost line of a traced function that an exception went through."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if not _is_machinery(frame.filename):
            return _described(frame.filename, frame.lineno or 0)
    return "an unknown place"


def _is_machinery(filename: str) -> bool:
    return filename.startswith(_MACHINERY) or filename.startswith("<__array_function__")


def _described(filename: str, line: int) -> str:
    source = linecache.getline(filename, line).strip()
    return f"{filename}:{line}" + (f": `{source}`" if source else "")
