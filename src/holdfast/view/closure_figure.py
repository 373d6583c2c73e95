"""How well closure and energy were kept."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.simulation.balance import WORK_TERMS
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style
from holdfast.view.figure_style import BLACK, BLUE, COLUMN, GREEN, ORANGE, PURPLE, SKY, STYLE, VERMILLION

POINTS = 300  # as many as a column can show
SMALLEST_GAP = 1e-18  # where a logarithmic axis shows a gap of 0


def closure_and_energy_figure(run: Trajectory) -> Any:
    """Return a figure of the gaps at the grasps, the energies, and the energy balance.

    Args:
        run: a run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    Figure, rc_context = figure_style.matplotlib()
    with rc_context(STYLE):
        figure = Figure(figsize=(COLUMN, 6.4), layout="constrained")
        position, velocity, energy, balance = figure.subplots(4, 1, sharex=True, height_ratios=(1, 1, 1.6, 1))
        for panel, gaps, label in (
            (position, run.position_gap, "position gap\n[m or rad]"),
            (velocity, run.velocity_gap, "velocity gap\n[m/s or rad/s]"),
        ):
            panel.semilogy(*_worst(run.t, gaps[:, 0]), "--", color=VERMILLION, label="after the step")
            panel.semilogy(*_worst(run.t, gaps[:, 1]), "-", color=BLUE, label="after projection")
            panel.set_ylabel(label)
        for values, line, colour, label in _energies(run):
            energy.plot(run.t, values, line, color=colour, label=label)
        energy.set_ylabel("energy [J]")
        balance.plot(run.t, run.imbalance, "-", color=BLACK)
        balance.set_ylabel("imbalance [J]")
        balance.set_xlabel("time [s]")
        for panel in (position, energy):
            panel.legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=3, columnspacing=1.0)
        figure.align_ylabels()
    return figure


def _worst(t: Array, gaps: Array) -> tuple[Array, Array]:
    """Return the largest gap of every short stretch of time, and the stretch's end."""
    if len(t) < 2:
        return t, np.maximum(gaps, SMALLEST_GAP)
    # the first sample came from no step
    first = np.unique(np.linspace(1, len(t), min(len(t) - 1, POINTS), endpoint=False).astype(int))
    last = np.append(first[1:], len(t)) - 1
    return t[last], np.maximum(np.maximum.reduceat(gaps, first), SMALLEST_GAP)


def _energies(run: Trajectory) -> list[tuple[Array, str, str, str]]:
    """Return the curves of the energy panel; works and impacts that stay zero are left out."""
    curves = [
        (run.kinetic, "-", BLUE, "kinetic"),
        (run.potential - run.potential[0], "--", VERMILLION, "potential, change"),
    ]
    styles = (("-.", GREEN), (":", ORANGE), (":", PURPLE), ("-.", SKY), ("-", BLACK))
    names = [*(f"work of {term}" for term in WORK_TERMS), "impacts"]
    for name, done, (line, colour) in zip(names, (*run.work.T, run.impact), styles, strict=True):
        if done.any():
            curves.append((done, line, colour, name))
    return curves
