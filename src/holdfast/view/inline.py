"""Display of runs and figures in notebooks, and of pages in the browser."""

from __future__ import annotations

import base64
import io
import tempfile
import webbrowser
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from holdfast.errors import HoldfastError, MissingExtra, ResultError
from holdfast.progress import in_notebook
from holdfast.simulation.summary import Summary, summarise
from holdfast.simulation.trajectory import require_run_of, text_of
from holdfast.view import summary_table
from holdfast.view.embedded import escaped
from holdfast.view.figure_style import draw_png
from holdfast.view.plots import figures

PAGE_HEIGHT = 620  # height of a page in a notebook [pixels]
INLINE_DPI = 110


class Figures(dict[str, Any]):
    """Matplotlib figures by name, which a notebook displays one by one or together."""

    def __init__(self, figures: Mapping[str, Any]) -> None:
        super().__init__(figures)
        for figure in self.values():  # matplotlib does this only if pyplot is in use
            figure._repr_png_ = partial(png, figure)

    def _repr_html_(self) -> str:
        return "".join(image(figure, name) for name, figure in self.items())


class InlinePage:
    """A page inside a notebook's cell.

    Attributes:
        text: content of the HTML file.
        title: title of the page.
    """

    def __init__(self, text: str, title: str) -> None:
        self.text, self.title = text, title

    def __repr__(self) -> str:
        return f"<page of '{self.title}'>"

    def _repr_html_(self) -> str:
        page = escaped(self.text)
        title = escaped(self.title)
        return f'<iframe title="{title}" srcdoc="{page}" style="width:100%;height:{PAGE_HEIGHT}px;border:0"></iframe>'


def shown(page: str, title: str) -> InlinePage | Path:
    """Return a page that a notebook displays; outside a notebook, open the page in the browser and return its file.

    Raises:
        ResultError: no browser can be opened.
    """
    if in_notebook():
        return InlinePage(page, title)
    with tempfile.NamedTemporaryFile("w", suffix=".html", prefix="holdfast_", delete=False, encoding="utf-8") as file:
        file.write(page)
    path = Path(file.name)
    if not webbrowser.open(path.as_uri()):
        raise ResultError(f"show: no browser opens here; the page is {path}. Try run.page(path) and open it elsewhere")
    return path


def png(figure: Any) -> bytes:
    """Return a matplotlib figure as a PNG file."""
    file = io.BytesIO()
    draw_png(figure, file, INLINE_DPI)
    return file.getvalue()


def image(figure: Any, name: str) -> str:
    """Return a matplotlib figure as an HTML image."""
    data = base64.b64encode(png(figure)).decode()
    return f'<img alt="{escaped(name)}" src="data:image/png;base64,{data}">'


def html_of_summary(summary: Summary) -> str:
    """Return the table of `holdfast summary` in HTML."""
    rows = summary_table.rows(summary)
    lines = "".join(f"<tr><td>{escaped(left)}</td><td>{escaped(right)}</td></tr>" for left, right in rows)
    return f"<table>{lines}</table>"


def html_of_run(run: Any) -> str | None:
    """Return a run's summary beside its first figure; None if it has neither, so that its text is shown."""
    try:
        whole = run.whole_run()
        chain = whole.require_setting().chain
        require_run_of(chain, whole)
        lines = html_of_summary(summarise(chain, whole)) if whole.has_every_array else ""
    except HoldfastError:
        return None
    head = f"<b>{escaped(text_of(whole))}</b>"
    try:
        drawn = figures(chain, whole)
    except MissingExtra:
        drawn = {}
    if not drawn:
        return head + lines
    name, figure = next(iter(drawn.items()))
    return f'{head}<div style="display:flex;gap:2em;align-items:start">{lines}{image(figure, name)}</div>'
