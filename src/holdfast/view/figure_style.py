"""How figures look: colours that everyone can tell apart, sizes for one column of a page."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from holdfast.errors import MissingExtra
from holdfast.io.files import one_line, write_atomically
from holdfast.model.closed_chain import ClosedChain

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
INTERNAL_COLOUR, DANGER = PURPLE, VERMILLION
TRUNK_COLOUR = "#707883"  # grey: it belongs to no arm

NOISE = 1e-9  # N m per N: smaller moments are rounding
DPI = 200
LONGEST_LABEL = 32  # characters
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


def arm_style(index: int) -> tuple[str, str]:
    """Return colour and line style of the arm at an index of the chain's order; no two of twenty arms look alike."""
    turn, place = divmod(index, len(ARM_COLOURS))
    return ARM_COLOURS[place], ARM_LINES[(place + turn) % len(ARM_LINES)]


def part_colour(chain: ClosedChain, name: str) -> str:
    """Return the colour '#rrggbb' of an arm, or of "trunk"."""
    return arm_style(chain.names.index(name))[0] if name in chain.arms else TRUNK_COLOUR


def joint_style(colour: str, place: int, count: int) -> tuple[str, Any]:
    """Return shade and dash of the joint at a place among the `count` that are told apart, for an arm's colour."""
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
        height: of the figure [inches].
        labels: of the panels' axes.
        ratios: heights of the panels relative to one another; equal ones by default.
    """
    with new_figure(COLUMN, height) as figure:
        panels = figure.subplots(len(labels), 1, sharex=True, height_ratios=ratios)
        for panel, label in zip(panels, labels, strict=True):
            panel.set_ylabel(label)
        panels[-1].set_xlabel("time [s]")
        yield figure, panels
        figure.align_ylabels()


def drawn_text(name: str) -> str:
    """Return a name as figures show it: printable, on one line, dollar signs as such instead of formulas between them.

    A space comes before a low line, since matplotlib leaves labels that begin with one, or are empty, out of legends.
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
    """Draw a matplotlib figure into an open file; characters that its font lacks are boxes."""
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
