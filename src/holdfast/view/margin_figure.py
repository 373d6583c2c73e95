"""How far the grasps were from giving way, and when they did."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style
from holdfast.view.figure_style import COLUMN, DANGER, STYLE, arm_look

MOST_NAMED = 4  # instants of slip with their times beside


def friction_margin_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the margin of every grasp that something limits, and of the instants of slip.

    Dotted, where internal forces could help: the largest margin that they allow.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    Figure, rc_context = figure_style.matplotlib()
    with rc_context(STYLE):
        figure = Figure(figsize=(COLUMN, 2.6), layout="constrained")
        panel = figure.subplots()
        panel.axhspan(-1e9, 0.0, color=DANGER, alpha=0.12, linewidth=0, zorder=0)
        panel.axhline(0.0, color=DANGER, linewidth=0.8)
        limited = [i for i in range(len(chain.names)) if np.isfinite(run.margin[:, i]).any()]
        shown = [0.0]
        for i in limited:
            colour, line = arm_look(i)
            panel.plot(run.t, _finite(run.margin[:, i]), linestyle=line, color=colour, label=chain.names[i])
            if np.isfinite(run.best_margin[:, i]).any():
                best = f"{chain.names[i]}, best possible"
                panel.plot(run.t, _finite(run.best_margin[:, i]), ":", color=colour, linewidth=0.8, label=best)
            shown += [*run.margin[:, i], *run.best_margin[:, i]]
        low, high = np.min(shown), np.max(np.array(shown)[np.isfinite(shown)])
        room = 0.08 * (high - low) or 1.0
        given_way = slips(chain, run)
        top = high + room * (1 + 2 * min(len(given_way), MOST_NAMED))
        panel.set_ylim(low - room, top)
        panel.set_xlim(run.t[0], run.t[-1] + 0.02 * ((run.t[-1] - run.t[0]) or 1.0))
        for k, (name, t) in enumerate(given_way):
            panel.axvline(t, color=DANGER, linewidth=0.8, linestyle="--")
            if k < MOST_NAMED:
                left = t > 0.6 * run.t[-1] + 0.4 * run.t[0]
                panel.annotate(
                    f"{name} gives way at {t:.4g} s", (t, top - 2 * k * room), (-3 if left else 3, -1),
                    textcoords="offset points", ha="right" if left else "left", va="top", fontsize=7, color=DANGER,
                )  # fmt: skip
        panel.set_ylabel("margin of the grasp [N]")
        panel.set_xlabel("time [s]")
        if limited:
            figure.legend(loc="outside upper center", ncols=2, columnspacing=1.0)
    return figure


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


def _finite(margin: Array) -> Array:
    """Return margins with gaps where nothing limits."""
    return np.where(np.isfinite(margin), margin, np.nan)
