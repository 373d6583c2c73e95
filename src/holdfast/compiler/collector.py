"""Python's collector of garbage, held back while a program is made.

Its nodes and instructions come by the hundred thousand, are all in use, and were looked through
again and again: more than a third of the time.
"""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Iterator

_LOCK = threading.Lock()
_pauses = 0
_wanted = True


@contextlib.contextmanager
def paused() -> Iterator[None]:
    """Collect no garbage within; afterwards all is as before. Several threads may be within."""
    global _pauses, _wanted
    with _LOCK:
        if not _pauses:
            _wanted = gc.isenabled()
            gc.disable()
        _pauses += 1
    try:
        yield
    finally:
        with _LOCK:
            _pauses -= 1
            if not _pauses and _wanted:
                gc.enable()
