"""Axes that a short spike does not flatten: they show the usual range, and arrows name what goes beyond."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from holdfast.spatial.scalar import Array

USUAL_SHARE = 0.95  # share of the samples that the usual range contains
SPIKE_RATIO = 4.0  # a peak so many times the usual size is a spike
AXIS_ROOM = 1.5  # the axis reaches to so many times the usual size
FEWEST_SAMPLES = 20  # samples of a curve that can have a spike


def usual_range(curves: Sequence[Array]) -> tuple[float, float] | None:
    """Return the range to which an axis is cut because a spike would flatten the rest; None without a spike.

    Args:
        curves: (samples,) values of each curve; what is not finite does not count.
    """
    known = [curve[np.isfinite(curve)] for curve in curves if len(curve) >= FEWEST_SAMPLES]
    known = [curve for curve in known if len(curve)]
    usual = max((float(np.quantile(np.abs(curve), USUAL_SHARE)) for curve in known), default=0.0)
    low, high = min(map(np.min, known), default=0.0), max(map(np.max, known), default=0.0)
    if usual == 0.0 or max(-low, high) <= SPIKE_RATIO * usual:
        return None
    return max(float(low), -AXIS_ROOM * usual), min(float(high), AXIS_ROOM * usual)


def cut_spikes(panels: Sequence[Any], shown: Sequence[float] = ()) -> Any | None:
    """Cut the axis that panels share to the usual range of their curves, and name the peaks beyond it.

    Args:
        panels: the panels.
        shown: further values that the axis contains.

    Returns:
        A handle for the legend; None if there is no spike.
    """
    drawn = [[line for line in panel.lines if line.get_transform() == panel.transData] for panel in panels]
    found = usual_range([np.asarray(line.get_ydata(), dtype=float) for lines in drawn for line in lines])
    if found is None:
        return None
    low, high = min([found[0], *shown]), max([found[1], *shown])
    margin = 0.05 * (high - low)
    panels[0].set_ylim(low - margin, high + margin)
    for panel, lines in zip(panels, drawn, strict=True):
        peaks = [(float(y[k]), float(x[k]), line) for line in lines for x, y, k in _extremes(line)]
        above, below = (max(peaks, key=lambda p: p[0]), high + margin), (min(peaks, key=lambda p: p[0]), low - margin)
        for sign, ((y, t, line), end) in ((1.0, above), (-1.0, below)):
            if sign * y > sign * end:
                _point_out(panel, t, end, sign * 0.25 * (high - low), f"{y:,.4g}", line.get_color())
    return panels[0].plot([], [], "^", color="#444444", markersize=4, label="beyond the axis, to the number beside it")[
        0
    ]


def _extremes(line: Any) -> list[tuple[Array, Array, int]]:
    """Return times, values and the index of the largest and of the least value of a curve."""
    x, y = (np.asarray(data, dtype=float) for data in line.get_data())
    return [(x, y, int(k(y))) for k in (np.nanargmax, np.nanargmin)] if np.isfinite(y).any() else []


def _point_out(panel: Any, t: float, end: float, inwards: float, text: str, colour: str) -> None:
    """Draw an arrow to the end of the axis at a time, with a number at its tail on the side that has room."""
    begin, last = panel.dataLim.intervalx
    late = t > 0.5 * (begin + last)
    panel.annotate(
        "", (t, end), (t, end - inwards), arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 0.8}
    )
    panel.annotate(
        text, (t, end - inwards), (-4 if late else 4, 0), textcoords="offset points",
        ha="right" if late else "left", va="center", fontsize=7, color=colour,
    )  # fmt: skip
