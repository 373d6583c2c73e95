"""Figures and a page of a calibration: what is open in each posture, and the corrections with their bars."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np

from holdfast.calibration.calibrate import Calibration
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style as style
from holdfast.view.report_page import Section, report_page, write_page

PER_UNIT = 1e3  # milliradians and millimetres are shown
MOST_CORRECTIONS = 60  # of a figure


def calibration_figures(found: Calibration) -> dict[str, Any]:
    """Return matplotlib figures by name: residuals by posture, and parameters before and after.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    return {"residuals_by_posture": _residuals(found), "parameters": _parameters(found)}


def calibration_page(found: Calibration, path: str | PathLike[str], title: str = "Calibration") -> dict[str, Any]:
    """Write a self-contained HTML page of a calibration, and return its figures.

    Args:
        found: what `calibrate` returns.
        path: the file.
        title: title of the page.

    Raises:
        MissingExtra: matplotlib is not installed.
        ResultError: the file cannot be written.
    """
    figures, later = calibration_figures(found), found.held_out or {}
    left = [
        [_title(name), *_milli(pair), *(_milli(later[name]) if name in later else ("", ""))]
        for name, pair in found.errors.items()
    ]
    verdict = "Bad fit, for the reasons below." if found.notes else "Good fit: nothing to remark."
    sections = [
        Section("By what the fit is bad", found.notes),
        Section(
            "What is open in each posture",
            ["Angles and lengths by which closures are open after the fit, with the object's pose that fits best."],
            ["closure", "fitted [mrad rms]", "[mm rms]", "held out [mrad rms]", "[mm rms]"],
            left,
            {"residuals by posture": figures["residuals_by_posture"]},
        ),
        Section(
            "Parameters before and after",
            ["Corrections to the model. Bars are standard deviations: after, those that the postures leave."],
            ["correction", "before", "+-", "after", "+-", "unit", "from"],
            _table(found),
            {"parameters": figures["parameters"]},
        ),
        Section("What the postures do not determine", found.undetermined or ["Every correction is determined."]),
    ]
    write_page(report_page(title, verdict, not found.notes, sections), path)
    return figures


def _title(name: Any) -> str:
    return name if isinstance(name, str) else "/".join(map(str, name))


def _milli(pair: tuple[float, float]) -> tuple[str, str]:
    """Return an angle and a length in thousandths."""
    return f"{PER_UNIT * pair[0]:.3g}", f"{PER_UNIT * pair[1]:.3g}"


def _bars(found: Calibration) -> Array:
    """Return (p,) standard deviations of the values."""
    return np.sqrt(np.maximum(np.diag(found.covariance), 0.0))


def _table(found: Calibration) -> list[list[str]]:
    """Return the corrections as cells."""
    whose = dict.fromkeys(found.kept, "the model") | dict.fromkeys(found.partly, "both")
    problem, cells = found.problem, []
    for k, (name, value, bar) in enumerate(zip(found.names, found.values.tolist(), _bars(found).tolist(), strict=True)):
        known = f"{PER_UNIT * problem.sizes[k]:.3g}" if problem.known[k] else "not known"
        unit = "mrad" if problem.layout.unknowns[k].turns else "mm"
        left = "not known" if name in found.kept and not problem.known[k] else f"{PER_UNIT * bar:.2g}"
        cells.append([name, "0", known, f"{PER_UNIT * value:+.4g}", left, unit, whose.get(name, "the postures")])
    return cells


def _residuals(found: Calibration) -> Any:
    """Return the figure of the open angles and lengths of every closure, posture by posture."""
    with style.new_figure(2 * style.COLUMN, 3.4) as figure:
        panels, start = figure.subplots(2, 1, sharex=True), 0
        postures = np.arange(len(found.residuals))
        for i, meeting in enumerate(found.problem.layout.meetings):
            middle = start + len(meeting.turns)
            stop = middle + len(meeting.shifts)
            for panel, part in zip(panels, (slice(start, middle), slice(middle, stop)), strict=True):
                if part.stop > part.start:
                    size = PER_UNIT * np.linalg.norm(found.residuals[:, part], axis=1)
                    colour, _ = style.arm_style(i)
                    panel.plot(postures, size, ".-", color=colour, label=style.drawn_text(_title(meeting.name)))
            start = stop
        for panel, label in zip(panels, ("open angle [mrad]", "open length [mm]"), strict=True):
            panel.set_ylabel(label)
            panel.set_ylim(bottom=0.0)
        if (few := np.flatnonzero(found.weights < 0.5)).size:
            for panel in panels:
                panel.plot(few, 0 * few, "x", color=style.DANGER, clip_on=False, label="counts less")
        panels[-1].set_xlabel("posture")
        labelled = next((panel for panel in panels if panel.lines), panels[0])
        figure.legend(*labelled.get_legend_handles_labels(), loc="outside upper right", ncols=4)
        figure.align_ylabels()
    return figure


def _parameters(found: Calibration) -> Any:
    """Return the figure of the corrections: angles on the left, lengths on the right; before, all are 0."""
    bars, unsure = _bars(found), {*found.kept, *found.partly}
    turns = np.array([one.turns for one in found.problem.layout.unknowns], bool)
    parts = [(of[:MOST_CORRECTIONS], unit) for of, unit in (
        (np.flatnonzero(turns), "mrad"), (np.flatnonzero(~turns), "mm")) if len(of)]  # fmt: skip
    height = 0.17 * max(len(of) for of, _ in parts) + 0.9
    with style.new_figure(2 * style.COLUMN, max(height, 1.6)) as figure:
        panels = figure.subplots(1, len(parts), squeeze=False)[0]
        for panel, (of, unit) in zip(panels, parts, strict=True):
            y = np.arange(len(of))[::-1]
            for k, place in zip(of.tolist(), y.tolist(), strict=True):
                if found.problem.known[k]:
                    size = PER_UNIT * found.problem.sizes[k]
                    panel.barh(place, 2 * size, left=-size, height=0.75, color="#e4e7ea")
            for told in (True, False):
                chosen = np.array([(found.names[k] not in unsure) == told for k in of], bool)
                if not chosen.any():
                    continue
                x, dx = PER_UNIT * found.values[of][chosen], PER_UNIT * bars[of][chosen]
                colour = style.BLUE if told else style.ORANGE
                label = "told by the postures" if told else "entirely or partly the model's"
                how: dict[str, Any] = {"fmt": "o", "markersize": 3, "linewidth": 1.1, "label": label}
                panel.errorbar(x, y[chosen], xerr=dx, color=colour, **how)
            panel.axvline(0.0, color=style.BLACK, linewidth=0.8, linestyle="--", label="the model, before")
            panel.set_yticks(y, [style.drawn_text(found.names[k]) for k in of.tolist()])
            panel.set_ylim(-0.7, len(of) - 0.3)
            panel.grid(axis="y", visible=False)
            panel.set_xlabel(f"correction [{unit}]")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure
