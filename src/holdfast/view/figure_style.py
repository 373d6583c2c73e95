"""The look of figures: colours that everyone can tell apart, panels for the columns of a page, axes cut at spikes."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.errors import MissingExtra
from holdfast.io.files import one_line, write_atomically
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

# Okabe and Ito (2008): distinct under every common colour blindness
BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, BLACK = (
    "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#000000",
)  # fmt: skip
# x, y, z: colour and line style both tell them apart
COMPONENTS = (("x", BLUE, "-"), ("y", VERMILLION, "--"), ("z", GREEN, "-."))
# arms: vermillion is kept for what slips or exceeds a limit, purple for internal forces
ARM_COLOURS, ARM_LINES = (BLUE, ORANGE, SKY, GREEN, BLACK), ("-", "--", "-.", ":")
# joints of an arm: its colour from dark to light, and a dash each
JOINT_DASHES: tuple[Any, ...] = (
    "-", (0, (6, 1.5)), (0, (3, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (1, 1.2)), (0, (6, 1.2, 1, 1.2, 1, 1.2)),
    (0, (2, 2.5)),
)  # fmt: skip
DARKEST, LIGHTEST = -0.5, 0.45  # of these shades: black is -1, white is 1
OTHERS = "#bbbbbb"  # joints that are not told apart
INTERNAL_COLOUR, COMMANDED_COLOUR, DANGER = PURPLE, "#7B3F8C", VERMILLION
TRUNK_COLOUR = "#707883"  # grey: it belongs to no arm

NOISE = 1e-9  # N m per N: smaller moments are rounding
DPI = 200
LONGEST_LABEL = 32  # characters
ARMS_ABREAST = 4  # columns of panels in a row of a figure
COLUMN = 3.5  # inches: one column of a two-column page
STYLE: dict[Any, Any] = {  # keys and values of matplotlib's rcParams
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "lines.linewidth": 1.1,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
}
USUAL_SHARE = 0.95  # share of the samples that the usual range of a curve contains
SPIKE_RATIO = 4.0  # a peak is a spike from this multiple of the usual size
AXIS_ROOM = 1.5  # an axis with spikes ends at this multiple of the usual size
FEWEST_FOR_SPIKES = 20  # samples of a curve that can have a spike


def arm_style(index: int) -> tuple[str, str]:
    """Return colour and line style of the arm at an index in the chain's order; they differ for twenty arms."""
    turn, place = divmod(index, len(ARM_COLOURS))
    return ARM_COLOURS[place], ARM_LINES[(place + turn) % len(ARM_LINES)]


def labelled(index: int, name: str) -> dict[str, str]:
    """Return the keywords of `plot` for a curve of an arm or run, with its name for the legend."""
    colour, line = arm_style(index)
    return {"linestyle": line, "color": colour, "label": drawn_text(name)}


def part_colour(chain: ClosedChain, name: str) -> str:
    """Return the colour '#rrggbb' of an arm, or of "trunk"."""
    return arm_style(chain.names.index(name))[0] if name in chain.arms else TRUNK_COLOUR


def joint_style(colour: str, place: int, count: int) -> tuple[str, Any]:
    """Return shade and dash of one of `count` joints that are distinguished, for the colour of their arm."""
    shade = DARKEST + (LIGHTEST - DARKEST) * place / max(count - 1, 1)
    end = 255 if shade > 0 else 0
    channels = (round(channel + abs(shade) * (end - channel)) for channel in rgb(colour))
    return "#" + "".join(f"{channel:02x}" for channel in channels), JOINT_DASHES[place % len(JOINT_DASHES)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour '#rrggbb'."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


@contextlib.contextmanager
def stacked_panels(height: float, labels: Sequence[str], ratios: Sequence[float] | None = None) -> Iterator[Any]:
    """Yield a figure of one column, and its panels over time, one below the other.

    Args:
        height: height of the figure [inches].
        labels: labels of the panels' vertical axes.
        ratios: relative heights of the panels; equal by default.
    """
    with new_figure(COLUMN, height) as figure:
        panels = figure.subplots(len(labels), 1, sharex=True, height_ratios=ratios)
        for panel, label in zip(panels, labels, strict=True):
            panel.set_ylabel(label)
        panels[-1].set_xlabel("time [s]")
        yield figure, panels
        figure.align_ylabels()


@contextlib.contextmanager
def columns_of_panels(
    count: int, height: float, extra_height: float, labels: Sequence[str]
) -> Iterator[tuple[Any, list[Any]]]:
    """Yield a figure and, for each of several arms, a column of panels over time; columns stand four abreast.

    Args:
        count: number of arms.
        height: height of a column [inches].
        extra_height: height added for legends [inches].
        labels: labels of the panels of a column, from the top.
    """
    abreast, rows = min(max(count, 1), ARMS_ABREAST), len(labels)
    bands = -(-max(count, 1) // abreast)
    with new_figure(COLUMN * max(1.0, abreast / 2), height * bands + extra_height) as figure:
        panels = figure.subplots(rows * bands, abreast, sharex=True, sharey="row", squeeze=False)
        columns = [panels[rows * (k // abreast) :, k % abreast][:rows] for k in range(count)]
        yield figure, columns
        for k, column in enumerate(columns):
            column[-1].set_xlabel("time [s]")
            column[-1].tick_params(labelbottom=True)
            for panel, label in zip(column, labels, strict=True) if k % abreast == 0 else ():
                panel.set_ylabel(label)
        for panel in panels.flat:
            if not panel.lines:
                panel.set_axis_off()
        figure.align_ylabels()


def drawn_text(name: str) -> str:
    """Return a name as figures show it: printable, on one line, with dollar signs that do not enclose a formula.

    A space comes before an underscore, since matplotlib omits labels that begin with one, and empty ones, from legends.
    """
    shown = one_line(name, LONGEST_LABEL).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") or not shown else shown


def write_figure(figure: Any, path: Path) -> None:
    """Write a matplotlib figure as a PNG file.

    Raises:
        ResultError: the file cannot be written.
    """
    write_atomically(path, lambda file: draw_png(figure, file, DPI))


def draw_png(figure: Any, file: Any, dpi: int) -> None:
    """Draw a matplotlib figure into an open file; characters that its font lacks appear as boxes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        figure.savefig(file, format="png", dpi=dpi)


@contextlib.contextmanager
def new_figure(width: float, height: float) -> Iterator[Any]:
    """Yield an empty matplotlib Figure of a size [inches], in the style of all figures.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    Figure, rc_context = matplotlib()
    with rc_context(STYLE):
        yield Figure(figsize=(width, height), layout="constrained")


def matplotlib() -> tuple[Any, Any]:
    """Return matplotlib's Figure class and rc_context; no window, no global state.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    # a backend that matplotlib does not know ends its import, and figures in files need none
    backend = None if "matplotlib" in sys.modules else os.environ.pop("MPLBACKEND", None)
    try:
        from matplotlib import rc_context, rcParams
        from matplotlib.figure import Figure
    except ImportError as cause:
        raise MissingExtra("plots need matplotlib; try pip install 'holdfast[plot]'") from cause
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    if backend:
        with contextlib.suppress(ValueError):  # as matplotlib's import would have done, for whoever else draws
            rcParams["backend"] = backend
    return Figure, rc_context


def usual_range(curves: Sequence[Array]) -> tuple[float, float] | None:
    """Return the range to which an axis is cut because a spike would flatten the rest; None without a spike.

    Args:
        curves: (samples,) values of each curve; infinite values and NaN are ignored.
    """
    known = [curve[np.isfinite(curve)] for curve in curves if len(curve) >= FEWEST_FOR_SPIKES]
    known = [curve for curve in known if len(curve)]
    usual = max((float(np.quantile(np.abs(curve), USUAL_SHARE)) for curve in known), default=0.0)
    low, high = min(map(np.min, known), default=0.0), max(map(np.max, known), default=0.0)
    if usual == 0.0 or max(-low, high) <= SPIKE_RATIO * usual:
        return None
    return max(float(low), -AXIS_ROOM * usual), min(float(high), AXIS_ROOM * usual)


def without_spikes(
    figure: Any, columns: Sequence[Sequence[Any]], shown: Sequence[Sequence[float]] | None = None
) -> None:
    """Cut the axis of each row of panels to the usual range of its curves; a legend explains the arrows to peaks.

    Args:
        figure: the figure.
        columns: columns of panels; those of a row share their axis.
        shown: for each row, values that its axis must contain.
    """
    rows = list(zip(*columns, strict=True))
    handles = [cut_spikes(row, values) for row, values in zip(rows, shown or [()] * len(rows), strict=False)]
    found = [handle for handle in handles if handle is not None]
    if found:
        figure.legend(handles=found[:1], loc="outside lower right")


def cut_spikes(panels: Sequence[Any], shown: Sequence[float] = ()) -> Any | None:
    """Cut the axis that panels share to the usual range of their curves, and name the peaks beyond it.

    Args:
        panels: the panels.
        shown: values that the axis must contain.

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
        peaks = [peak for line in lines for peak in _extremes(line)]
        above, below = (max(peaks, key=lambda p: p[0]), high + margin), (min(peaks, key=lambda p: p[0]), low - margin)
        for sign, ((y, t, line), end) in ((1.0, above), (-1.0, below)):
            if sign * y > sign * end:
                _point_out(panel, t, end, sign * 0.25 * (high - low), f"{y:,.4g}", line.get_color())
    text = "beyond the axis, to the number beside it"
    return panels[0].plot([], [], "^", color="#444444", markersize=4, label=text)[0]


def _extremes(line: Any) -> list[tuple[float, float, Any]]:
    """Return (value, time, curve) of the largest and the smallest value of a curve; nothing if none is finite."""
    x, y = (np.asarray(data, dtype=float) for data in line.get_data())
    ends = (np.nanargmax(y), np.nanargmin(y)) if np.isfinite(y).any() else ()
    return [(float(y[k]), float(x[k]), line) for k in ends]


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
