"""What shows which threads batches start."""

from __future__ import annotations

from _thread import get_ident, start_new_thread
from typing import Any

import pytest

from holdfast.compiler import threads


def started_threads(patch: pytest.MonkeyPatch, processors: int, least_work: int | None = None) -> list[int]:
    """Return a list that grows with every thread that a batch starts, by the number of the thread that starts it.

    Args:
        patch: what undoes the following.
        processors: how many processors seem to be free.
        least_work: the number of operations for which a thread is started; None leaves it as it is.
    """
    started: list[int] = []

    def start(function: Any, arguments: Any) -> int:
        started.append(get_ident())
        return start_new_thread(function, arguments)

    patch.setattr(threads, "start_new_thread", start)
    patch.setattr(threads, "free_processors", lambda: processors)
    if least_work is not None:
        patch.setattr(threads, "LEAST_WORK", least_work)
    return started
