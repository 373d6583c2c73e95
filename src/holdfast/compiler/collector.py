"""Python's garbage collector, paused while a program is compiled.

Tracing makes hundreds of thousands of nodes and instructions, all of them in use. The collector would inspect them
again and again, which took more than a third of the compile time.
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
    """Pause the garbage collector within the block and restore its state after it. Blocks of threads may overlap."""
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
