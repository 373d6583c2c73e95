"""The metadata in record.npz: how a record was made, and which pieces of it are there."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from holdfast.simulation.rollout.record import RolloutArguments

RECORD = "record.npz"


class RecordMeta(msgspec.Struct, forbid_unknown_fields=True):
    """How a record was made.

    Attributes:
        format, format_version: which layout this is.
        holdfast: the version that wrote it.
        step: h [s]; None of a record that was put together from arrays.
        every: steps from one record to the next.
        duration: requested duration [s].
        options: of `Rollout.step`.
        names: of the recorded arrays.
        pieces: number of records in each piece.
        complete: whether the rollout reached its end.
    """

    format: str = "holdfast-record"
    format_version: int = 1
    holdfast: str = ""
    step: float | None = None
    every: int = 1
    duration: float = 0.0
    options: dict[str, Any] = {}
    names: list[str] = []
    pieces: list[int] = []
    complete: bool = True


def meta_of_record(arguments: RolloutArguments | None) -> RecordMeta:
    """Return the content of the record's metadata before its first record; of arrays alone without `arguments`."""
    from holdfast import __version__

    if arguments is None:
        return RecordMeta(holdfast=__version__)
    options = {name: x if x is None or np.isfinite(x) else None for name, x in arguments.options.items()}
    return RecordMeta(
        holdfast=__version__,
        step=arguments.step,
        every=arguments.every,
        duration=arguments.duration,
        options=options,
        complete=False,
    )
