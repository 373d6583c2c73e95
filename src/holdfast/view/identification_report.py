"""Figures and a page of an identification: what was measured and predicted, what is left, and the parameters."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np
from scipy.signal import periodogram

from holdfast.identification.assessment import UNIT_OF, Assessment
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style as style
from holdfast.view.report_page import Section, report_page, write_page

MOST_CHANNELS = 24  # of a figure
MOST_BARS = 40
ABREAST = 2
MOST_POINTS = 2000  # of a curve


def identification_figures(found: Assessment) -> dict[str, Any]:
    """Return matplotlib figures by name: measured and predicted signals, residuals, their spectra, and parameters.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    return {
        "measured_and_predicted": _signals(found),
        "residuals": _residuals(found),
        "spectrum_of_residuals": _spectra(found),
        "parameters": _parameters(found),
    }


def identification_page(found: Assessment, path: str | PathLike[str], title: str = "Identification") -> dict[str, Any]:
    """Write a self-contained HTML page of an identification, and return its figures.

    Args:
        found: what `identification.assess` returns.
        path: the file.
        title: title of the page.

    Raises:
        MissingExtra: matplotlib is not installed.
        ResultError: the file cannot be written.
    """
    figures, made = identification_figures(found), found.found
    whole, later = found.measured_rms, found.held_out
    residuals = [
        [name, f"{whole[k]:.4g}", f"{found.fitted[k]:.4g}", "" if later is None else f"{later[k]:.4g}"]
        for k, name in enumerate(found.channels)
    ]
    unit = UNIT_OF[found.by]
    sections = [
        Section("By what the fit is bad", found.criteria),
        Section("Measured and predicted", figures={"measured and predicted": figures["measured_and_predicted"]}),
        Section(
            "What is left",
            [
                "Held out: the last third of each recording, or the recording that was named, predicted by a fit to"
                " the rest. Slow residuals are friction or drift that the model does not have; white ones are noise."
            ],
            ["channel", f"measured [{unit} rms]", "left by the fit", "held out"],
            residuals,
            {"residuals": figures["residuals"], "their spectrum": figures["spectrum_of_residuals"]},
        ),
        Section(
            "Parameters before and after",
            ["Bars are standard deviations: before, those of the prior; after, those that the recordings leave."],
            ["parameter", "before", "+-", "after", "+-", "from"],
            _table(found),
            {"parameters": figures["parameters"]},
        ),
        Section("What the recordings do not tell", made.undetermined),
        Section("Notes", [note for note in made.notes if note not in found.criteria]),
    ]
    bad = len(found.criteria)
    verdict = f"Bad fit, by {bad} criteri{'on' if bad == 1 else 'a'}." if bad else "Good fit: every criterion is met."
    verdict += f" Misfit {made.misfit:.3g} (mean square of the residuals in units of their noise)."
    write_page(report_page(title, verdict, not bad, sections), path)
    return figures


def _table(found: Assessment) -> list[list[str]]:
    """Return the parameters as cells."""
    made = found.found
    whose = dict.fromkeys(made.kept, "the model") | dict.fromkeys(made.partly, "both")
    return [
        [name, f"{before:.5g}", f"{believed:.2g}", f"{after:.5g}", f"{bar:.2g}", whose.get(name, "the recordings")]
        for name, before, believed, after, bar in zip(
            made.names, made.before, made.believed, made.values, _bars(found), strict=True
        )
    ]


def _bars(found: Assessment) -> Array:
    """Return (p,) standard deviations of the values, also of those that are partly the prior's."""
    return np.sqrt(np.maximum(np.diag(found.found.covariance), 0.0))


def _panels(found: Assessment, height: float, sharey: bool = False) -> Any:
    """Return the number of channels shown, rows of panels, and the size of a figure."""
    count = min(len(found.channels), MOST_CHANNELS)
    rows = -(-count // ABREAST)
    return count, rows, (2 * style.COLUMN, height * rows + 0.5)


def _thinned(x: Array) -> Array:
    """Return at most so many samples of a curve as a figure can show."""
    return x[:: max(1, len(x) // MOST_POINTS)]


def _each_channel(found: Assessment, height: float, x_label: str, y_label: str, draw: Any) -> Any:
    """Return a figure with a panel for each channel, drawn by draw(panel, channel)."""
    count, rows, size = _panels(found, height)
    with style.new_figure(*size) as figure:
        panels = figure.subplots(rows, ABREAST, sharex=True, squeeze=False)
        for k, panel in enumerate(panels.flat):
            if k >= count:
                panel.set_axis_off()
                continue
            draw(panel, k)
            panel.set_title(style.drawn_text(found.channels[k]), loc="left")
        for panel in panels[:, 0]:
            panel.set_ylabel(y_label)
        for column in range(ABREAST):
            last = panels[(count - 1 - column) // ABREAST, column]
            last.set_xlabel(x_label)
            last.tick_params(labelbottom=True)
        handles, labels = panels.flat[0].get_legend_handles_labels()
        if len(labels) > 1:
            figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
    return figure


def _times(found: Assessment) -> list[Array]:
    """Return times from 0 on, each recording behind the one before."""
    shown, end = [], 0.0
    for t in found.t:
        shown.append(t - t[0] + end)
        end = float(shown[-1][-1]) + 0.02 * float(t[-1] - t[0])
    return shown


def _signals(found: Assessment) -> Any:
    """Return the figure of measured and predicted signals."""

    def draw(panel: Any, k: int) -> None:
        for i, (t, y, e) in enumerate(zip(_times(found), found.measured, found.errors, strict=True)):
            said = ("measured", "predicted") if i == 0 else (None, None)
            panel.plot(_thinned(t), _thinned(y[:, k]), color=style.OTHERS, linewidth=2.2, label=said[0])
            panel.plot(_thinned(t), _thinned(y[:, k] - e[:, k]), color=style.BLUE, linewidth=0.9, label=said[1])

    return _each_channel(found, 1.25, "time [s]", f"[{UNIT_OF[found.by]}]", draw)


def _residuals(found: Assessment) -> Any:
    """Return the figure of the residuals over time."""

    def draw(panel: Any, k: int) -> None:
        for t, e in zip(_times(found), found.errors, strict=True):
            panel.plot(_thinned(t), _thinned(e[:, k]), color=style.VERMILLION, linewidth=0.7)
        panel.axhline(0.0, color=style.BLACK, linewidth=0.5)

    return _each_channel(found, 1.0, "time [s]", f"[{UNIT_OF[found.by]}]", draw)


def _spectra(found: Assessment) -> Any:
    """Return the figure of the residuals' spectra, beside that of white noise of the same size."""
    longest = int(np.argmax([len(t) for t in found.t]))
    t, e = found.t[longest], found.errors[longest]
    even = np.linspace(t[0], t[-1], len(t))
    rate = (len(t) - 1) / max(float(t[-1] - t[0]), 1e-12)

    def draw(panel: Any, k: int) -> None:
        f, power = periodogram(np.interp(even, t, e[:, k]), rate, detrend="constant")
        width = max(1, len(f) // 150)
        bands = len(f[1:]) // width
        f, power = (x[1 : 1 + bands * width].reshape(bands, width).mean(axis=1) for x in (f, power))
        panel.loglog(f, np.sqrt(np.maximum(power, 1e-30)), color=style.VERMILLION, linewidth=0.9, label="residual")
        white = np.sqrt(2.0 * float(e[:, k].var()) / rate)
        panel.axhline(
            max(white, 1e-15), color=style.BLACK, linewidth=0.8, linestyle="--", label="white noise of its size"
        )

    return _each_channel(found, 1.1, "frequency [Hz]", f"[({UNIT_OF[found.by]})/√Hz]".replace("N m or N", "N m"), draw)


def _parameters(found: Assessment) -> Any:
    """Return the figure of parameters before and after, in units of the prior's deviation about the model's value."""
    made, bars = found.found, _bars(found)
    order = np.argsort(bars / np.maximum(made.believed, 1e-300))[:MOST_BARS]
    order = np.sort(order)
    unsure = {*made.kept, *made.partly}
    with style.new_figure(2 * style.COLUMN, 0.17 * len(order) + 0.9) as figure:
        panel = figure.subplots()
        unit = np.maximum(made.believed[order], 1e-300)
        x, dx = (made.values - made.before)[order] / unit, bars[order] / unit
        y = np.arange(len(order))[::-1]
        panel.barh(
            y, 2.0, left=-1.0, height=0.75, color="#e4e7ea", label="before: the model's value, ± the prior's deviation"
        )
        for told, colour, label in ((True, style.BLUE, "after, told by the recordings"),
                                    (False, style.ORANGE, "after, entirely or partly the model's")):  # fmt: skip
            of = np.array([(made.names[k] not in unsure) == told for k in order], bool)
            if of.any():
                panel.errorbar(
                    x[of], y[of], xerr=dx[of], fmt="o", markersize=3, color=colour, linewidth=1.1, label=label
                )
        panel.set_yticks(y, [style.drawn_text(made.names[k]) for k in order.tolist()])
        panel.set_ylim(-0.7, len(order) - 0.3)
        panel.grid(axis="y", visible=False)
        panel.set_xlabel("change, in standard deviations of the prior")
        figure.legend(loc="outside upper left", ncols=1)
    return figure
