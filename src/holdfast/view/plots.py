"""Figures of a run: the wrenches at the grasps, and how well closure and energy were kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from holdfast.dynamics.split import split
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import WORK_TERMS
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style
from holdfast.view.figure_style import BLACK, BLUE, COLUMN, COMPONENTS, GREEN, ORANGE, PURPLE, SKY, STYLE, VERMILLION

ARMS_ABREAST = 4
POINTS = 300  # as many as a column can show
SMALLEST_GAP = 1e-18  # where a logarithmic axis shows a gap of 0


def save_plots(chain: ClosedChain, run: Trajectory, folder: Path) -> list[str]:
    """Write every figure of a run into a folder as PNG and return the files' names.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    figures = {
        "grasp_wrenches.png": grasp_wrench_figure(chain, run),
        "closure_and_energy.png": closure_and_energy_figure(run),
    }
    for name, figure in figures.items():
        figure.savefig(folder / name, dpi=figure_style.DPI)
    return list(figures)


def grasp_wrench_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the grasp wrenches, one column of panels per arm that holds.

    Force and moment of the arm on the object about the contact, world axes, and the norms
    of the force's motion and internal parts.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    Figure, rc_context = figure_style.matplotlib()
    names = list(chain.grasps)
    abreast = min(max(len(names), 1), ARMS_ABREAST)
    bands = -(-max(len(names), 1) // abreast)
    times, motion, internal = _split_forces(chain, run)
    with rc_context(STYLE):
        figure = Figure(figsize=(COLUMN * max(1.0, abreast / 2), 4.2 * bands + 0.3), layout="constrained")
        panels = figure.subplots(3 * bands, abreast, sharex=True, sharey="row", squeeze=False)
        for k, name in enumerate(names):
            band, column = divmod(k, abreast)
            force, moment, parts = panels[3 * band : 3 * band + 3, column]
            i = chain.names.index(name)
            force.set_title(f"{name} ({chain.grasps[name].kind})")
            for panel, first in ((force, 3), (moment, 0)):
                for axis, (label, colour, line) in enumerate(COMPONENTS):
                    panel.plot(run.t, run.grasp_wrench[:, i, first + axis], line, color=colour, label=label)
            parts.plot(times, motion[:, i], "-", color=BLACK, label="motion part")
            parts.plot(times, internal[:, i], "--", color=PURPLE, label="internal part")
            parts.set_ylim(bottom=0)
            parts.set_xlabel("time [s]")
            parts.tick_params(labelbottom=True)
            if column == 0:
                for panel, label in ((force, "force [N]"), (moment, "moment [N m]"), (parts, "|force| [N]")):
                    panel.set_ylabel(label)
        for panel in panels.flat:
            if not panel.lines:
                panel.set_axis_off()
        figure.align_ylabels()
        if names:
            handles = [line for panel in (panels[0, 0], panels[2, 0]) for line in panel.lines]
            figure.legend(handles=handles, loc="outside upper center", ncols=5, columnspacing=1.0)
    return figure


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
    """Return the curves of the energy panel; works that stay zero are left out."""
    curves = [
        (run.kinetic, "-", BLUE, "kinetic"),
        (run.potential - run.potential[0], "--", VERMILLION, "potential, change"),
    ]
    styles = (("-.", GREEN), (":", ORANGE), (":", PURPLE), ("-.", SKY))
    for term, done, (line, colour) in zip(WORK_TERMS, run.work.T, styles, strict=True):
        if done.any():
            curves.append((done, line, colour, f"work of {term}"))
    return curves


def _split_forces(chain: ClosedChain, run: Trajectory) -> tuple[Array, Array, Array]:
    """Return times (points,), and norms of the motion and internal forces (points, arms)."""
    chosen = np.unique(np.linspace(0, len(run) - 1, min(len(run), POINTS)).astype(int))
    parts = [split(chain, run.state(k), run.grasp_wrench[k]) for k in chosen]
    motion = np.array([np.linalg.norm(part.motion[:, 3:], axis=1) for part in parts])
    internal = np.array([np.linalg.norm(part.internal[:, 3:], axis=1) for part in parts])
    return run.t[chosen], motion, internal
