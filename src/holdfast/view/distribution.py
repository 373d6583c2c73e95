"""How a number is distributed over many runs."""

from __future__ import annotations

from os import PathLike
from typing import Any

from holdfast.io.files import file_path
from holdfast.spatial.scalar import Array
from holdfast.view.figure_style import BLUE, COLUMN, drawn_text, new_figure, write_figure


def plot_distribution(title: str, values: Array, levels: Array, path: str | PathLike[str] | None) -> Any:
    """Return a matplotlib Figure of the share of runs below each value; infinite ones lie outside it.

    Args:
        title: of the values, with their unit.
        values: quantiles, ascending.
        levels: theirs.
        path: of a PNG file to write it to; None: of none.

    Raises:
        MissingExtra: matplotlib is not installed.
        ResultError: the file cannot be written.
    """
    place = None if path is None else file_path(path, "path")
    with new_figure(COLUMN, 2.4) as figure:
        panel = figure.subplots()
        panel.step(values, levels, where="post", color=BLUE)
        panel.set_ylim(0.0, 1.0)
        panel.set_xlabel(drawn_text(title))
        panel.set_ylabel("share of the runs")
    if place is not None:
        write_figure(figure, place)
    return figure
