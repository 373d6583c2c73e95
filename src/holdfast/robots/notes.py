"""The notes on a robot's file, shown to the caller who loads it."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable

from holdfast.errors import ModelWarning


def show_notes(notes: Iterable[str]) -> None:
    """Show the notes of one load as one `ModelWarning`, at the caller's line; without notes, nothing.

    Args:
        notes: notes, each shown once.
    """
    if lines := list(dict.fromkeys(notes)):
        warnings.warn("\n".join(lines), ModelWarning, stacklevel=_level_of_caller())


def _level_of_caller() -> int:
    """Return the stack level of the first frame outside this library, as `show_notes` counts it."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "holdfast":
        frame, level = frame.f_back, level + 1
    return level
