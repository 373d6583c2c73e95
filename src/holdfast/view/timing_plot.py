"""The figure of a timed path: its speed, what limits it where, and the room that is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np

from holdfast.io.files import file_path
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style as style

COLOURS = (style.BLUE, style.ORANGE, style.GREEN, style.PURPLE, style.SKY, style.VERMILLION)
HEADROOM = 1.25  # the axis of speeds ends at this multiple of the largest


def plot_timing(
    nodes: Array,
    speeds: Mapping[str, Array],
    limited_by: Sequence[Mapping[str, float]],
    room: Array,
    duration: float,
    path: str | PathLike[str] | None,
) -> Any:
    """Return a matplotlib Figure of a timed path.

    Args:
        nodes: (m,) shares of the path.
        speeds: (m,) speeds at the nodes by name; the first is that of the timing.
        limited_by: of each interval, the names of what limits it, the most important first.
        room: (m - 1,) force that is left in each interval [N].
        duration: the time that the path takes [s].
        path: PNG file to write the figure to; None for no file.

    Raises:
        MissingExtra: matplotlib is not installed.
        ResultError: the file cannot be written.
    """
    place = None if path is None else file_path(path, "path")
    forces = np.isfinite(room).any()
    with style.new_figure(2 * style.COLUMN, 3.4 if forces else 2.6) as figure:
        panels = np.atleast_1d(figure.subplots(1 + forces, 1, sharex=True, height_ratios=[2.4, 1.0][: 1 + forces]))
        for (name, values), line in zip(speeds.items(), ("-", "--", ":"), strict=True):
            first = line == "-"
            colour = style.BLACK if first else style.TRUNK_COLOUR
            panels[0].plot(nodes, values, line, color=colour, zorder=4 if first else 3, label=name)
        fastest = next(iter(speeds.values()))
        _shaded(panels[0], nodes, fastest, [next(iter(one), "") for one in limited_by])
        panels[0].set_ylim(0.0, HEADROOM * fastest.max())
        panels[0].set_ylabel("speed [1/s]")
        panels[0].set_title(f"Fastest timing of a path: {duration:.3g} s")
        if forces:
            panels[1].stairs(np.maximum(room, 0.0), nodes, color=style.BLACK, zorder=3)
            panels[1].set_ylim(0.0, None)
            panels[1].set_ylabel("room [N]")
            figure.align_ylabels()
        panels[-1].set(xlabel="share of the path", xlim=(nodes[0], nodes[-1]))
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper")
    if place is not None:
        style.write_figure(figure, place)
    return figure


def _shaded(panel: Any, nodes: Array, speed: Array, names: Sequence[str]) -> None:
    """Shade what is below the speed by the name of what limits it, in order of the way for which it does."""
    way = dict.fromkeys(names, 0.0)
    for name, width in zip(names, np.diff(nodes), strict=True):
        way[name] += width
    way.pop("", None)
    ordered = sorted(way, key=lambda name: -way[name])
    colours = dict(zip(ordered, COLOURS, strict=False))
    places = [k for k in range(1, len(names)) if names[k] != names[k - 1]]
    for first, last in zip([0, *places], [*places, len(names)], strict=True):
        part = slice(first, last + 1)
        colour = colours.get(names[first], style.OTHERS)
        panel.fill_between(nodes[part], speed[part], color=colour, alpha=0.45, linewidth=0.0)
    shown = [(style.drawn_text(f"limited by {name}"), colour) for name, colour in colours.items()]
    if len(ordered) > len(colours):
        shown.append(("limited by others", style.OTHERS))
    for label, colour in shown:
        panel.fill_between([], [], color=colour, alpha=0.45, linewidth=0.0, label=label)
