"""How far the grasps were from giving way, and when they did."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array
from holdfast.view.figure_style import COLUMN, DANGER, arm_style, drawn_text, new_figure

MOST_TIMED_SLIPS = 4  # instants of slip with their times beside
NARROWEST_BAND = 1e-6  # of the axis: wider ranges of margins are drawn
BEYOND = 1e9  # N: further than any axis goes


def friction_margin_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the margin of every grasp that something limits, and of the instants of slip.

    Where the grasp forces are not unique, a band shows the margins that they leave open.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    limited = [i for i in range(len(chain.names)) if np.isfinite(run.margin[:, i]).any()]
    with new_figure(COLUMN, 2.6) as figure:
        panel = figure.subplots()
        panel.axhspan(-BEYOND, 0.0, color=DANGER, alpha=0.12, linewidth=0, zorder=0)
        panel.axhline(0.0, color=DANGER, linewidth=0.8)
        for i in limited:
            colour, line = arm_style(i)
            panel.plot(run.t, _finite(run.margin[:, i]), linestyle=line, color=colour, label=drawn_text(chain.names[i]))
        low, high = _range(run.margin)
        for i in limited:
            worst, best = (np.clip(m[:, i], -BEYOND, BEYOND) for m in (run.worst_margin, run.best_margin))
            if (best - worst > NARROWEST_BAND * (high - low)).any():
                panel.fill_between(run.t, worst, best, color=arm_style(i)[0], alpha=0.15, linewidth=0)
        _mark_slips(panel, run, slips(chain, run), low, high)
        panel.set_ylabel("margin of the grasp [N]")
        panel.set_xlabel("time [s]")
        if limited:
            figure.legend(loc="outside upper center", ncols=4, columnspacing=1.0)
    return figure


def _mark_slips(panel: Any, run: Trajectory, found: list[tuple[str, float]], low: float, high: float) -> None:
    """Set the axes about margins from low to high, with room above for the instants of slip; draw those."""
    begin, end = float(run.t[0]), float(run.t[-1])
    line = 0.16 * (high - low)
    top = high + line * (0.5 + min(len(found), MOST_TIMED_SLIPS))
    panel.set_ylim(low - 0.5 * line, top)
    panel.set_xlim(begin, end + 0.02 * ((end - begin) or 1.0))
    for k, (name, t) in enumerate(found):
        panel.axvline(t, color=DANGER, linewidth=0.8, linestyle="--")
        if k < MOST_TIMED_SLIPS:
            late = t > 0.6 * end + 0.4 * begin
            panel.annotate(
                f"{drawn_text(name)} gives way at {t:.4g} s", (t, top - k * line), (-3 if late else 3, -1),
                textcoords="offset points", ha="right" if late else "left", va="top", fontsize=7, color=DANGER,
            )  # fmt: skip


def slips(chain: ClosedChain, run: Trajectory) -> list[tuple[str, float]]:
    """Return arm and time [s] of every instant at which a grasp's margin becomes negative, in order of time.

    The run's log has them to the last digits; of a run without one, the samples are joined by
    straight lines.
    """
    logged = [(one.name, one.t) for one in run.occurrences if one.kind == "violation" and one.quantity == "grasp"]
    if logged:
        return logged
    found = []
    for i, name in enumerate(chain.names):
        margin = run.margin[:, i]
        if margin[0] < 0:
            found.append((name, float(run.t[0])))
        for k in np.flatnonzero((margin[:-1] >= 0) & (margin[1:] < 0)):
            share = margin[k] / (margin[k] - margin[k + 1]) if np.isfinite(margin[k]) else 1.0
            found.append((name, float(run.t[k] + share * (run.t[k + 1] - run.t[k]))))
    return sorted(found, key=lambda slip: slip[1])


def _range(margin: Array) -> tuple[float, float]:
    """Return the least and largest finite margin, 0 between them; never the same."""
    known = margin[np.isfinite(margin)]
    low, high = float(known.min(initial=0.0)), float(known.max(initial=0.0))
    return (low, high) if high > low else (low, low + 1.0)


def _finite(margin: Array) -> Array:
    """Return margins with gaps where nothing limits."""
    return np.where(np.isfinite(margin), margin, np.nan)
