"""The notes on a robot's file, shown to the caller who loads it."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

from holdfast.errors import ModelWarning


def show_notes(notes: Iterable[str], stacklevel: int = 3) -> None:
    """Show the notes of one load as one `ModelWarning`; without notes, nothing.

    Args:
        notes: notes, each shown once.
        stacklevel: 3 for the caller of the function that calls this one.
    """
    if lines := list(dict.fromkeys(notes)):
        warnings.warn("\n".join(lines), ModelWarning, stacklevel=stacklevel)
