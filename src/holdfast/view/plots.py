"""The figures of a run as files."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np

from holdfast.io.files import file_path, write_atomically
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.trajectory import Trajectory, require_run_of
from holdfast.view import figure_style
from holdfast.view.closure_figure import closure_and_energy_figure
from holdfast.view.margin_figure import friction_margin_figure
from holdfast.view.share_figure import load_share_figure
from holdfast.view.torque_figure import joint_torque_figure
from holdfast.view.wrench_figure import grasp_wrench_figure


def figures(chain: ClosedChain, run: Trajectory) -> dict[str, Any]:
    """Return the figures that have something to show, by name.

    Without a limited grasp there are no margins, with one arm that holds no shares.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    holding = int(run.holding.any(axis=0).sum())
    found: dict[str, Any] = {}
    if holding:
        found["grasp_wrenches"] = grasp_wrench_figure(chain, run)
    if np.isfinite(run.margin).any():
        found["friction_margins"] = friction_margin_figure(chain, run)
    found["joint_torques"] = joint_torque_figure(chain, run)
    if holding > 1:
        found["load_share"] = load_share_figure(chain, run)
    found["closure_and_energy"] = closure_and_energy_figure(run)
    return found


def save_plots(chain: ClosedChain, run: Trajectory, folder: str | PathLike[str]) -> list[str]:
    """Write the figures of a run into a folder as PNG and return the files' names.

    Args:
        chain: the chain that was simulated.
        run: its run.
        folder: where to.

    Raises:
        StateError: what is no run, or not of this chain.
        MissingExtra: matplotlib is not installed.
        ResultError: a file cannot be written.
    """
    require_run_of(chain, run)
    names, place = [], file_path(folder, "folder")
    for name, figure in figures(chain, run).items():
        names.append(f"{name}.png")

        def draw(file: Any, figure: Any = figure) -> None:
            figure.savefig(file, format="png", dpi=figure_style.DPI)

        write_atomically(place / names[-1], draw)
    return names
