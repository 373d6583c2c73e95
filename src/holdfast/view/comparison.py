"""Figures of several runs: their curves over each other, and the distribution of a number over many runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np

from holdfast.errors import StateError
from holdfast.io.files import file_path
from holdfast.model.serial_chain import serial_chain
from holdfast.simulation.trajectory import Trajectory, require_run_of
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style as style
from holdfast.view.inline import Figures
from holdfast.view.playback import base_travel, torque_use
from holdfast.view.plots import worst_gaps

MOST_COMPARED = len(style.ARM_COLOURS) * len(style.ARM_LINES)  # runs with distinct styles

HAND_ROWS = FORCE_ROW, MOMENT_ROW, INTERNAL_ROW, MARGIN_ROW, TORQUE_ROW = (
    "force [N]", "moment [N m]", "internal [N]", "margin [N]", "torque [%]",
)  # fmt: skip
LIMIT_LINES = {MARGIN_ROW: 0.0, TORQUE_ROW: 100.0}

Runs = Mapping[str, Trajectory]
Curves = dict[str, Sequence[Array | None]]  # (samples,) of each run, None for those without, by label


def compare_runs(runs: Runs) -> dict[str, Any]:
    """Return figures that overlay several runs, which the legend names.

    - `hands`: for every arm that has a grasp in one of the runs, the norms of its force and moment on the object about
      the contact and of the internal force, the margin of its grasp, and the largest torque relative to its limit.
    - `object`: the position of the object and its rotation since the start of the run, world axes.
    - `balance`: kinetic energy, energy not accounted for by work, and the position gap at the grasps.

    The runs may belong to different chains; arms with the same name share a column.

    Args:
        runs: 2 to 20 runs that contain their chain, by the name to show.

    Returns:
        Matplotlib figures by name, which a notebook displays together.

    Raises:
        MissingExtra: matplotlib is not installed.
        StateError: there are too few or too many runs, or a value is not a run with samples and a chain.
    """
    if not isinstance(runs, Mapping) or not 2 <= len(runs) <= MOST_COMPARED:
        got = f"{len(runs)}" if isinstance(runs, Mapping) else f"a {type(runs).__name__}"
        raise StateError(
            f"runs: expected 2 to {MOST_COMPARED} runs by name, got {got}; try"
            " compare_runs({'first': a, 'second': b})"
        )
    whole: dict[str, Trajectory] = {}
    for name, run in runs.items():
        if not hasattr(run, "whole_run"):
            raise StateError(f"runs: '{name}': expected a run, got a {type(run).__name__}; try what simulate returns")
        whole[str(name)] = found = run.whole_run()
        serial_chain(_chain(found), f"runs: '{name}': chain")
        require_run_of(_chain(found), found)
    hands = {"hands": _hands_figure(whole)} if _holding(whole) else {}
    return Figures({**hands, "object": _object_figure(whole), "balance": _balance_figure(whole)})


def _holding(runs: Runs) -> list[str]:
    """Return the arms that have a grasp in at least one of the runs, in the order of the runs' names."""
    held = {
        name: None
        for run in runs.values()
        for i, name in enumerate(_chain(run).names)
        if run.holding[:, i].any()
    }  # fmt: skip
    return list(held)


def _hands_figure(runs: Runs) -> Any:
    """Return a figure with a column of panels for every arm with a grasp, without rows that would be empty."""
    arms = _holding(runs)
    hands = {name: [_of_hand(run, name) for run in runs.values()] for name in arms}
    rows = [row for row in HAND_ROWS if any(of[row] is not None for of_runs in hands.values() for of in of_runs)]
    with style.columns_of_panels(len(arms), 1.25 * len(rows), 0.4, rows) as (figure, columns):
        for name, column in zip(arms, columns, strict=True):
            column[0].set_title(style.drawn_text(name))
            for panel, row in zip(column, rows, strict=True):
                _draw(panel, runs, [of[row] for of in hands[name]])
                if row in LIMIT_LINES:
                    panel.axhline(LIMIT_LINES[row], color=style.DANGER, linewidth=0.8)
        style.without_spikes(figure, columns)
        for column in columns:  # after all curves are drawn, because the panels of a row share an axis
            for panel, row in zip(column, rows, strict=True):
                panel.set_ylim(bottom=None if row == MARGIN_ROW else 0.0)
        _name_runs(figure, runs)
    return figure


def _of_hand(run: Trajectory, name: str) -> dict[str, Array | None]:
    """Return the curves of an arm by row; None for a run without this arm, and for a quantity without a limit."""
    chain = _chain(run)
    if name not in chain.names:
        return dict.fromkeys(HAND_ROWS)
    i = chain.names.index(name)
    margin, use = run.margin[:, i], torque_use(chain, name, run.tau)
    return {
        FORCE_ROW: np.linalg.norm(run.grasp_wrench[:, i, 3:], axis=1),
        MOMENT_ROW: np.linalg.norm(run.grasp_wrench[:, i, :3], axis=1),
        INTERNAL_ROW: np.linalg.norm(run.internal_wrench[:, i, 3:], axis=1),
        MARGIN_ROW: np.where(np.isfinite(margin), margin, np.nan) if np.isfinite(margin).any() else None,
        TORQUE_ROW: None if use is None else 100 * use,
    }


def _object_figure(runs: Runs) -> Any:
    """Return the figure of the object's position and rotation."""
    poses = [run.object_pose for run in runs.values()]
    parts: Curves = {f"{name} [m]": [pose[:, 4 + axis] for pose in poses] for axis, name in enumerate("xyz")}
    parts["turn [rad]"] = [np.linalg.norm(base_travel(pose).turn, axis=1) for pose in poses]
    return _over_each_other(runs, parts, 5.2)


def _balance_figure(runs: Runs) -> Any:
    """Return the figure of the energies, and of the gaps after projection on a logarithmic axis."""
    parts: Curves = {"kinetic energy [J]": [run.kinetic for run in runs.values()]}
    parts["imbalance [J]"] = [run.imbalance for run in runs.values()]
    figure = _over_each_other(runs, {**parts, "position gap\n[m or rad]": [None] * len(runs)}, 4.6)
    gap = figure.axes[-1]
    for i, run in enumerate(runs.values()):
        colour, line = style.arm_style(i)
        gap.semilogy(*worst_gaps(run.t, run.position_gap[:, 1]), linestyle=line, color=colour)
    return figure


def _over_each_other(runs: Runs, parts: Curves, height: float) -> Any:
    """Return a figure with panels below each other, by label, and in each of them the curves of all runs."""
    with style.stacked_panels(height, list(parts)) as (figure, panels):
        for panel, curves in zip(panels, parts.values(), strict=True):
            _draw(panel, runs, curves)
        _name_runs(figure, runs)
    return figure


def _draw(panel: Any, runs: Runs, curves: Sequence[Array | None]) -> None:
    """Draw a curve of every run that has one, each narrower than those below, so that equal curves remain visible."""
    for i, ((name, run), found) in enumerate(zip(runs.items(), curves, strict=True)):
        if found is not None:
            panel.plot(run.t, found, linewidth=2.0 - 0.9 * i / (len(runs) - 1), **style.labelled(i, name))


def _name_runs(figure: Any, runs: Runs) -> None:
    """Add one legend of the runs for all panels."""
    found = {line.get_label(): line for panel in figure.axes for line in panel.lines}
    names = [style.drawn_text(name) for name in runs]
    handles = [found[name] for name in names if name in found]
    longest = max(map(len, names))
    figure.legend(handles=handles, loc="outside upper center", ncols=max(1, min(4, 48 // (longest + 6))))


def _chain(run: Trajectory) -> Any:
    return run.require_setting().chain


def plot_distribution(title: str, values: Array, levels: Array, path: str | PathLike[str] | None) -> Any:
    """Return a matplotlib Figure of the share of runs below each value; infinite values are outside the axes.

    Args:
        title: title of the values, with their unit.
        values: (levels,) quantiles, ascending.
        levels: (levels,) levels of the quantiles, 0 to 1.
        path: PNG file to write the figure to; None for no file.

    Raises:
        MissingExtra: matplotlib is not installed.
        ResultError: the file cannot be written.
    """
    place = None if path is None else file_path(path, "path")
    with style.new_figure(style.COLUMN, 2.4) as figure:
        panel = figure.subplots()
        panel.step(values, levels, where="post", color=style.BLUE)
        panel.set_ylim(0.0, 1.0)
        panel.set_xlabel(style.drawn_text(title))
        panel.set_ylabel("share of the runs")
    if place is not None:
        style.write_figure(figure, place)
    return figure
