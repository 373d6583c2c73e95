"""Who carries the load."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.trajectory import Trajectory
from holdfast.view import figure_style
from holdfast.view.figure_style import BLACK, COLUMN, STYLE, arm_look


def load_share_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the part of the net force on the object that each arm carries, and of that force.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    Figure, rc_context = figure_style.matplotlib()
    net = np.linalg.norm(run.grasp_wrench[..., 3:].sum(axis=1), axis=1)
    defined = run.load_share.any(axis=1, keepdims=True)  # there is a net force
    shares = np.where(defined, 100 * run.load_share, np.nan)
    with rc_context(STYLE):
        figure = Figure(figsize=(COLUMN, 3.2), layout="constrained")
        share, force = figure.subplots(2, 1, sharex=True, height_ratios=(1.6, 1))
        for i, name in enumerate(chain.names):
            if run.holding[:, i].any():
                colour, line = arm_look(i)
                share.plot(run.t, shares[:, i], linestyle=line, color=colour, label=name)
        share.set_ylabel("load share [%]")
        share.set_ylim(*_wide_enough(shares))
        force.plot(run.t, net, "-", color=BLACK)
        force.set_ylabel("net force [N]")
        force.set_ylim(0, 1.08 * net.max() or 1.0)
        force.set_xlabel("time [s]")
        figure.align_ylabels()
        if share.lines:
            figure.legend(handles=share.lines, loc="outside upper center", ncols=4, columnspacing=1.0)
    return figure


def _wide_enough(shares: Any) -> tuple[float, float]:
    """Return limits of an axis that shows 0 to 100 %, and what lies beyond."""
    known = shares[np.isfinite(shares)]
    low, high = float(np.min(known, initial=0.0)), float(np.max(known, initial=100.0))
    return low - 0.04 * (high - low), high + 0.04 * (high - low)
