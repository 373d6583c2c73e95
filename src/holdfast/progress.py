"""Progress of long work: a bar in a notebook's cell or on a terminal; elsewhere an occasional line on stderr.

Work of which nobody said whether to show it, such as compiling at a first call, is shown to people only: in a notebook
or on a terminal, by the main process, and if it takes longer than a second.
"""

from __future__ import annotations

import html
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from typing import Any, TypeVar

from holdfast.errors import ModelError

Report = TypeVar("Report")

SILENCE = 10.0  # seconds between lines of progress if no bar can be drawn
REFRESH = 0.2  # seconds between two updates of a notebook's bar
PATIENCE = 1.0  # seconds after which work is shown that nobody asked to be shown

# Function of the completed fraction, 0 to 1, or None while it is unknown, and of the text beside the bar.
Shown = Callable[[float | None, str], None]

_detail: ContextVar[Callable[[str], object] | None] = ContextVar("detail", default=None)  # of what `busy` shows


def say(line: str) -> bool:
    """Print a line on stderr, and return whether stderr can be written."""
    try:
        print(line, file=sys.stderr, flush=True)
    except (OSError, ValueError):
        return False
    return True


@contextmanager
def reporting(
    progress: bool | Callable[[Report], object] | None,
    doing: str,
    begin: str,
    shown: Callable[[Report], tuple[float, str]],
    time_left: bool = True,
) -> Iterator[Callable[[Report], object]]:
    """Yield the function to call with the progress: that of the caller, or one that moves a bar.

    Args:
        progress: True for a bar, a function to call with the progress, None for neither; or False, which also hides
            the work within.
        doing: as for `progress_bar`.
        begin: as for `progress_bar`.
        shown: function of a report that returns the completed fraction and the text to show.
        time_left: as for `progress_bar`.

    Raises:
        ModelError: `progress` is none of these.
    """
    if progress is True:
        with progress_bar(doing, begin, time_left=time_left) as show:
            yield lambda at: show(*shown(at))
    elif callable(progress):
        yield progress
    elif progress is False:
        with busy(False, doing):
            yield lambda at: None
    elif progress is None:
        yield lambda at: None
    else:
        raise ModelError(f"progress: expected True, False or a function, got {type(progress).__name__}; try True")


@contextmanager
def busy(progress: bool | None, doing: str, begin: str = "the first time takes longest") -> Iterator[None]:
    """Show that work whose progress is unknown is being done.

    Args:
        progress: True to show it. False to show neither it nor any work within it. None to show it to people if it
            takes long, unless it is a part of other such work.
        doing: as for `progress_bar`.
        begin: as for `progress_bar`.

    Raises:
        ModelError: the flag is not True, False or None.
    """
    if not isinstance(progress, bool | None):
        raise ModelError(f"progress: expected True, False or None, got {type(progress).__name__}")
    if progress is None and (_detail.get() is not None or not _seen()):
        yield
        return
    if progress is None:
        bar = _late_bar(doing)
    else:
        bar = progress_bar(doing, begin, time_left=False) if progress else nullcontext(_hidden)
    with bar as show:
        latest = "done"

        def tell(text: str) -> None:
            nonlocal latest
            latest = text
            show(None, text)

        token = _detail.set(tell)
        try:
            yield
        finally:
            _detail.reset(token)
        show(1.0, latest)


def detail(text: str) -> None:
    """Show a text beside the work that `busy` shows at the moment."""
    if (tell := _detail.get()) is not None:
        tell(text)


def _hidden(part: float | None, text: str) -> None:
    """Show nothing."""


def _seen() -> bool:
    """Return whether people look at what this process shows."""
    parent = getattr(sys.modules.get("multiprocessing.process"), "parent_process", lambda: None)()
    return parent is None and (in_notebook() or _on_terminal())


def _on_terminal() -> bool:
    """Return whether stderr is a terminal, without a bar of `_terminal` on it."""
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def _late_bar(doing: str) -> Iterator[Shown]:
    """Yield what `progress_bar` yields; the bar appears after `PATIENCE`."""
    lock, ends, over = threading.Lock(), ExitStack(), False
    show, latest = _hidden, (None, "")

    def appear() -> None:
        nonlocal show
        with lock, suppress(OSError, ValueError):  # of a stderr that has been closed
            if not over:
                show = ends.enter_context(progress_bar(doing, time_left=False))
                show(*latest)

    def kept(part: float | None, text: str) -> None:
        nonlocal latest
        with lock:
            latest = part, text
            show(*latest)

    timer = threading.Timer(PATIENCE, appear)
    timer.daemon = True
    timer.start()
    try:
        yield kept
    finally:
        timer.cancel()
        with lock:
            over = True
            ends.close()


def of_time(whole: float) -> Callable[[float], tuple[float, str]]:
    """Return the function that shows a time within a duration [s]."""
    return lambda t: (t / whole, f"{t:.3f} of {whole:g} s")


@contextmanager
def progress_bar(
    doing: str, begin: str = "", say: Callable[[str], object] = say, time_left: bool = True
) -> Iterator[Shown]:
    """Yield the function that shows the progress of work.

    The bar of work that never reports its progress moves to and fro. In a notebook, a line with the time taken remains.

    Args:
        doing: description of the work, such as "simulating run".
        begin: line to print at the beginning if there is neither a notebook nor a terminal; if empty, the first and the
            last report are printed instead.
        say: function that prints such a line.
        time_left: whether to show the remaining time, unless the work itself does.
    """
    if in_notebook():
        with _cell(doing, time_left) as show:
            yield show
    elif _on_terminal():
        with _terminal(doing, time_left) as show:
            yield show
    else:
        if begin:
            say(f"{doing}: {begin}")
        due = time.monotonic() + (SILENCE if begin else 0.0)

        def line(part: float | None, text: str) -> None:
            nonlocal due
            if time.monotonic() >= due or (part == 1.0 and not begin):
                due = time.monotonic() + SILENCE
                say(f"{doing}: {text}")

        yield line


def in_notebook() -> bool:
    """Return whether this runs in the kernel of a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return getattr(shell, "kernel", None) is not None


@contextmanager
def _cell(doing: str, time_left: bool) -> Iterator[Shown]:
    """Show the progress element of HTML, which needs no widgets."""
    from IPython import display

    def picture(bar: str, text: str) -> Any:
        return display.HTML(f"{bar}{html.escape(doing)}{': ' if text else ''}{html.escape(text)}")

    start, due, latest = time.monotonic(), 0.0, ""
    place: Any = display.display(picture("<progress></progress> ", ""), display_id=True)

    def show(part: float | None, text: str) -> None:
        nonlocal due, latest
        now, latest = time.monotonic(), text
        if now >= due:
            due = now + REFRESH
            left = f", {(now - start) * (1 - part) / part:.0f} s left" if time_left and part else ""
            value = "" if part is None else f' max="1" value="{part:.4f}"'
            place.update(picture(f"<progress{value}></progress> ", text + left))

    try:
        yield show
    finally:
        took = f"{time.monotonic() - start:.1f} s"
        place.update(picture("", f"{latest}, took {took}" if latest else took))


@contextmanager
def _terminal(doing: str, time_left: bool) -> Iterator[Shown]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    what, text = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[said]}"))
    left = [TimeRemainingColumn()] if time_left else []
    with Progress(what, BarColumn(), text, *left, console=Console(stderr=True)) as bar:
        task, due = bar.add_task(doing, total=None, said=""), 0.0

        def show(part: float | None, text: str) -> None:
            nonlocal due
            if time.monotonic() >= due or part == 1.0:
                due = time.monotonic() + REFRESH
                bar.update(task, completed=part, total=None if part is None else 1.0, said=text)

        yield show
