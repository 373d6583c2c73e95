"""The figures of a run, and how they become files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import repeat
from os import PathLike
from typing import Any

import numpy as np

from holdfast.io.files import file_path
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import WORK_TERMS
from holdfast.simulation.trajectory import Trajectory, require_run_of
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style as style
from holdfast.view.base_travel import base_travel
from holdfast.view.figure_style import COLUMN, COMPONENTS, arm_style, drawn_text, new_figure, stacked_panels
from holdfast.view.margin_figure import friction_margin_figure
from holdfast.view.spikes import cut_spikes

ARMS_ABREAST = 4
POINTS = 300  # as many as a column can show
SMALLEST_GAP = 1e-18  # where a logarithmic axis shows a gap of 0


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
    if chain.floats:
        found["base_motion"] = base_motion_figure(run)
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
    return write_figures(figures(chain, run), folder)


def write_figures(drawn: Mapping[str, Any], folder: str | PathLike[str]) -> list[str]:
    """Write figures by name into a folder as PNG and return the files' names.

    Raises:
        ResultError: a file cannot be written.
    """
    place = file_path(folder, "folder")
    for name, figure in drawn.items():
        style.write_figure(figure, place / f"{name}.png")
    return [f"{name}.png" for name in drawn]


def grasp_wrench_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the grasp wrenches, one column of panels per arm that holds.

    Force and moment of the arm on the object about the contact, world axes, and the norms
    of the force's motion and internal parts. If all moments are zero, they have no panels.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    held = [i for i in range(len(chain.names)) if run.holding[:, i].any()]
    internal = run.internal_wrench[..., 3:]
    norms = [np.linalg.norm(part, axis=2) for part in (run.grasp_wrench[..., 3:] - internal, internal)]
    looks = (("motion part", "-", style.BLACK), ("internal part", "--", style.INTERNAL_COLOUR))
    size = np.abs(run.grasp_wrench).max(axis=(0, 1), initial=0.0)
    rows = {"force [N]": 3, "moment [N m]": 0} if size[:3].max() > style.NOISE * size[3:].max() else {"force [N]": 3}
    with columns_of_panels(len(held), 1.4 * (len(rows) + 1), 0.3, (*rows, "|force| [N]")) as (figure, columns):
        for i, (*wrench, split) in zip(held, columns, strict=True):
            wrench[0].set_title(_title(chain, i))
            for panel, first in zip(wrench, rows.values(), strict=True):
                for axis, (label, colour, line) in enumerate(COMPONENTS):
                    panel.plot(run.t, run.grasp_wrench[:, i, first + axis], line, color=colour, label=label)
            for norm, (label, line, colour) in zip(norms, looks, strict=True):
                split.plot(run.t, norm[:, i], line, color=colour, label=label)
        handles = [*columns[0][0].lines, *columns[0][-1].lines] if held else []
        without_spikes(figure, columns)
        for *_, split in columns:  # once all are drawn: those of a row have one axis
            split.set_ylim(bottom=0)
        if held:
            figure.legend(handles=handles, loc="outside upper center", ncols=5, columnspacing=1.0)
    return figure


@contextmanager
def columns_of_panels(
    count: int, height: float, extra_height: float, labels: Sequence[str]
) -> Iterator[tuple[Any, list[Any]]]:
    """Yield a figure and, for each of several arms, a column of panels over time; columns stand four abreast.

    Args:
        count: of arms.
        height: of a column [inches].
        extra_height: height added for legends [inches].
        labels: of the panels of a column, from above.
    """
    abreast, rows = min(max(count, 1), ARMS_ABREAST), len(labels)
    bands = -(-max(count, 1) // abreast)
    with new_figure(COLUMN * max(1.0, abreast / 2), height * bands + extra_height) as figure:
        panels = figure.subplots(rows * bands, abreast, sharex=True, sharey="row", squeeze=False)
        columns = [panels[rows * (k // abreast) :, k % abreast][:rows] for k in range(count)]
        yield figure, columns
        for k, column in enumerate(columns):
            column[-1].set_xlabel("time [s]")
            column[-1].tick_params(labelbottom=True)
            for panel, label in zip(column, labels, strict=True) if k % abreast == 0 else ():
                panel.set_ylabel(label)
        for panel in panels.flat:
            if not panel.lines:
                panel.set_axis_off()
        figure.align_ylabels()


def _title(chain: ClosedChain, arm: int) -> str:
    """Return an arm's name and, if it begins with one, its grasp's kind."""
    name = chain.names[arm]
    return drawn_text(name) + (f" ({chain.grasps[name].kind})" if name in chain.grasps else "")


def joint_torque_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the drives' torques, and of their share of the limits, one column per arm and for a trunk.

    An arm has its colour, its joints differ by shade and dash. Of an arm with more than seven joints the seven that
    come nearest to their limits (or, without limits, with the largest torques) are told apart, the others are grey.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    driven = [name for name, joints in chain.joints_of.items() if joints]
    named = 0.13 * max((min(len(chain.joints_of[name]), len(style.JOINT_DASHES)) for name in driven), default=0)
    with columns_of_panels(len(driven), 3.0 + named, 0.2, (_label(chain), "share of limit [%]")) as (figure, columns):
        for name, (torque, share) in zip(driven, columns, strict=True):
            torque.set_title(drawn_text(name))
            _draw(chain, run, name, torque, share)
            share.legend(handles=_told_apart(torque), loc="upper center", bbox_to_anchor=(0.5, -0.4), borderaxespad=0)
        without_spikes(figure, columns, ((), (0.0, 100.0)))
        for _, share in columns:  # once all are drawn: those of a row have one axis
            share.set_ylim(0, max(105.0, share.get_ylim()[1]))
    return figure


def _told_apart(panel: Any) -> list[Any]:
    return [line for line in panel.lines if not line.get_label().startswith("_")]


def without_spikes(
    figure: Any, columns: Sequence[Sequence[Any]], shown: Sequence[Sequence[float]] | None = None
) -> None:
    """Cut the axis of each row of panels to what is usual, and explain the arrows, if there are any, in a legend.

    Args:
        figure: the figure.
        columns: of panels; those of a row share their axis.
        shown: of each row, values that its axis contains.
    """
    rows = zip(*columns, strict=True)
    handles = [cut_spikes(row, values) for row, values in zip(rows, shown or repeat(()), strict=False)]
    found = [handle for handle in handles if handle is not None]
    if found:
        figure.legend(handles=found[:1], loc="outside lower right")


def _draw(chain: ClosedChain, run: Trajectory, name: str, torque: Any, share: Any) -> None:
    """Draw the torques of one arm, or of "trunk", into its two panels."""
    joints, tau = chain.joints_of[name], run.tau[:, chain.joints[name]]
    limits = np.array([joint.effort_limit for joint in joints])
    limited = np.isfinite(limits)
    use = np.where(limited, 100 * np.abs(tau) / limits, 0.0)
    most = (use if limited.any() else np.abs(tau)).max(axis=0)
    first = sorted(np.argsort(-most, kind="stable")[: len(style.JOINT_DASHES)])
    for k, joint in enumerate(joints):
        colour, line, label = style.OTHERS, "-", "_"
        if k in first:
            colour, line = style.joint_style(style.part_colour(chain, name), first.index(k), len(first))
            label = drawn_text(joint.name or f"joint{k + 1}")
        torque.plot(run.t, tau[:, k], linestyle=line, color=colour, label=label)
        if limited[k]:
            share.plot(run.t, use[:, k], linestyle=line, color=colour, label=label)
    if limited.any():
        share.axhline(100.0, color=style.DANGER, linewidth=0.8)


def _label(chain: ClosedChain) -> str:
    turning = {joint.turns for joint in chain.all_joints}
    if turning == {True, False}:
        return "torque, force\n[N m, N]"
    return "torque [N m]" if True in turning else "force [N]"


def base_motion_figure(run: Trajectory) -> Any:
    """Return a figure of a floating base: how far it has come and turned from where it was first, and how fast it is.

    World axes; the turn is the rotation vector from the first attitude.

    Args:
        run: a run of a chain whose base floats.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    travel = base_travel(run.base_pose)
    labels = ("shift [m]", "turn [rad]", "velocity [m/s]", "turning [rad/s]")
    with stacked_panels(5.6, labels) as (figure, panels):
        for panel, values in zip(panels, (*travel, run.base_twist[:, 3:], run.base_twist[:, :3]), strict=True):
            for axis, (name, colour, line) in enumerate(COMPONENTS):
                panel.plot(run.t, values[:, axis], line, color=colour, label=name)
        figure.legend(handles=panels[0].lines, loc="outside upper center", ncols=3, columnspacing=1.0)
    return figure


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
    net = np.linalg.norm(run.grasp_wrench[..., 3:].sum(axis=1), axis=1)
    defined = run.load_share.any(axis=1, keepdims=True)  # there is a net force
    shares = np.where(defined, 100 * run.load_share, np.nan)
    with stacked_panels(3.2, ("load share [%]", "net force [N]"), (1.6, 1)) as (figure, (share, force)):
        for i, name in enumerate(chain.names):
            if run.holding[:, i].any():
                colour, line = arm_style(i)
                share.plot(run.t, shares[:, i], linestyle=line, color=colour, label=drawn_text(name))
        share.set_ylim(*_wide_enough(shares))
        force.plot(run.t, net, "-", color=style.BLACK)
        force.set_ylim(0, 1.08 * net.max() or 1.0)
        without_spikes(figure, [(share, force)], ((0.0, 100.0), (0.0,)))
        if share.lines:
            figure.legend(handles=share.lines, loc="outside upper center", ncols=4, columnspacing=1.0)
    return figure


def _wide_enough(shares: Any) -> tuple[float, float]:
    """Return limits of an axis that shows 0 to 100 %, and what lies beyond."""
    known = shares[np.isfinite(shares)]
    low, high = float(np.min(known, initial=0.0)), float(np.max(known, initial=100.0))
    return low - 0.04 * (high - low), high + 0.04 * (high - low)


def closure_and_energy_figure(run: Trajectory) -> Any:
    """Return a figure of the gaps at the grasps, the energies, and the energy balance.

    Args:
        run: a run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    labels = ("position gap\n[m or rad]", "velocity gap\n[m/s or rad/s]", "energy [J]", "imbalance [J]")
    with stacked_panels(6.4, labels, (1, 1, 1.6, 1)) as (figure, (position, velocity, energy, balance)):
        for panel, gaps in ((position, run.position_gap), (velocity, run.velocity_gap)):
            panel.semilogy(*worst_gaps(run.t, gaps[:, 0]), "--", color=style.VERMILLION, label="after the step")
            panel.semilogy(*worst_gaps(run.t, gaps[:, 1]), "-", color=style.BLUE, label="after projection")
        for values, line, colour, label in _energies(run):
            energy.plot(run.t, values, line, color=colour, label=label)
        balance.plot(run.t, run.imbalance, "-", color=style.BLACK)
        for panel in (position, energy):
            panel.legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=3, columnspacing=1.0)
    return figure


def worst_gaps(t: Array, gaps: Array) -> tuple[Array, Array]:
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
        (run.kinetic, "-", style.BLUE, "kinetic"),
        (run.potential - run.potential[0], "--", style.VERMILLION, "potential, change"),
    ]
    styles = (("-.", style.GREEN), (":", style.ORANGE), (":", style.PURPLE), ("-.", style.SKY), ("-", style.BLACK))
    names = [*(f"work of {term}" for term in WORK_TERMS), "impacts"]
    for name, done, (line, colour) in zip(names, (*run.work.T, run.impact), styles, strict=True):
        if done.any():
            curves.append((done, line, colour, name))
    return curves
