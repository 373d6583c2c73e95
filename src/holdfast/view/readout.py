"""The numbers of one moment of a film as HTML: a table with a row for each arm, and the singularity meter."""

from __future__ import annotations

import html

import numpy as np

from holdfast.view.figure_style import DANGER, GREEN, ORANGE, arm_look
from holdfast.view.film import Film
from holdfast.view.page_panel import meter

HEADINGS = ("", "force [N]", "internal [N]", "moment [N m]", "margin [N]", "torque [%]")
ZONES = f"{GREEN} 28%,{ORANGE} 38%,{ORANGE} 62%,{DANGER} 72%"
METER = f"height:8px;border-radius:4px;background:linear-gradient(90deg,{ZONES})"
NEEDLE = "position:relative;top:-3px;width:3px;height:14px;background:#000"


def readout(film: Film, moment: int) -> str:
    """Return the wrenches of a moment, the margins, how near the torques are to their limits, and the condition."""
    rows = "".join(_row(film, moment, i, name) for i, name in enumerate(film.chain.names))
    head = "".join(f"<th style='text-align:right;font-weight:normal'>{heading}</th>" for heading in HEADINGS)
    shown = meter(film)
    share, nearest = shown["values"][moment] or 0.0, shown["names"][shown["nearest"][moment]]
    return (
        f"<div style='padding:0 1em;font-size:.8em'><b>t = {film.t[moment]:.3f} s</b>"
        f"<table style='width:100%'><tr>{head}</tr>{rows}</table>"
        f"condition of the grasps {film.condition[moment]:.3g}; regular to singular, nearest: {html.escape(nearest)}"
        f"<div style='{METER}'><div style='{NEEDLE};left:{99 * share:.1f}%'></div></div></div>"
    )


def chip(index: int, name: str) -> str:
    """Return an arm's name beside a square of its colour, as HTML."""
    return f"<span style='color:{arm_look(index)[0]}'>&#9632;</span> {html.escape(name)}"


def _row(film: Film, moment: int, i: int, name: str) -> str:
    use = film.torque_use(name)
    moments, forces = film.wrench[moment, i, :3], film.wrench[moment, i, 3:]
    values = (
        float(np.linalg.norm(forces)),
        float(np.linalg.norm(film.internal[moment, i, 3:])),
        float(np.linalg.norm(moments)),
        float(film.margin[moment, i]),
        np.inf if use is None else 100 * float(use[moment]),
    )
    cells = "".join(f"<td style='text-align:right'>{_short(value)}</td>" for value in values)
    return f"<tr><td style='white-space:nowrap'>{chip(i, name)}</td>{cells}</tr>"


def _short(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return "0" if abs(value) < 1e-9 else f"{value:.3g}"
