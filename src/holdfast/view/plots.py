"""The figures of a run, and how they become files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from os import PathLike
from typing import Any

import numpy as np

from holdfast.io.files import file_path
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import GraspRow, grasp_rows
from holdfast.simulation.balance import WORK_TERMS
from holdfast.simulation.trajectory import ArrayNotRecorded, Trajectory, require_run_of
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style as style
from holdfast.view.playback import base_travel
from holdfast.view.world_figure import world_forces_figure

POINTS = 300  # as many as the width of a figure can show
SMALLEST_GAP = 1e-18  # where a logarithmic axis shows a gap of 0
MOST_TIMED_SLIPS = 4  # largest number of instants of slip whose times are written beside them
NARROWEST_BAND = 1e-6  # width of a range of margins from which it is drawn, relative to the axis
BEYOND = 1e9  # N: further than any axis goes


def figures(chain: ClosedChain, run: Trajectory) -> dict[str, Any]:
    """Return the figures that have something to show, by name.

    Margins need a grasp with a limit, load shares two arms that hold the object, forces of the world an object that
    touches it, and each its recorded arrays.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    touching: Any = chain.touching
    choices: dict[str, tuple[Callable[[], Any], Callable[[], Any]]] = {
        "grasp_wrenches": (lambda: run.holding.any(), lambda: grasp_wrench_figure(chain, run)),
        "friction_margins": (lambda: np.isfinite(run.margin).any(), lambda: friction_margin_figure(chain, run)),
        "base_motion": (lambda: chain.floats, lambda: base_motion_figure(run)),
        "world_forces": (lambda: touching and run.touch_force.any(), lambda: world_forces_figure(touching, run)),
        "joint_torques": (lambda: chain.joint_count, lambda: joint_torque_figure(chain, run)),
        "load_share": (lambda: run.holding.any(axis=0).sum() > 1, lambda: load_share_figure(chain, run)),
        "closure_and_energy": (lambda: True, lambda: closure_and_energy_figure(run)),
    }
    found = {}
    for name, (shows_something, draw) in choices.items():
        with suppress(ArrayNotRecorded):
            if shows_something():
                found[name] = draw()
    return found


def save_plots(chain: ClosedChain, run: Trajectory, folder: str | PathLike[str]) -> list[str]:
    """Write the figures of a run into a folder as PNG and return the files' names.

    Args:
        chain: the chain that was simulated.
        run: its run.
        folder: the folder.

    Raises:
        StateError: `run` is not a run of this chain.
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

    The panels show force and moment of the arm on the object about the contact, world axes, and the norms of the
    force's motion and internal parts. If all moments are zero, they have no panels.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    rows_of_run = rows_of(chain, run)
    held = [i for i in range(len(rows_of_run)) if run.holding[:, i].any()]
    force = run.grasp_wrench[..., 3:]
    parts = [("all of it", "-", style.BLACK, force)]
    if "internal_wrench" in run.recorded:
        internal = run.internal_wrench[..., 3:]
        parts = [("motion part", "-", style.BLACK, force - internal)]
        parts.append(("internal part", "--", style.INTERNAL_COLOUR, internal))
    size = np.abs(run.grasp_wrench).max(axis=(0, 1), initial=0.0)
    rows = {"force [N]": 3, "moment [N m]": 0} if size[:3].max() > style.NOISE * size[3:].max() else {"force [N]": 3}
    with style.columns_of_panels(len(held), 1.4 * (len(rows) + 1), 0.3, (*rows, "|force| [N]")) as (figure, columns):
        for i, (*wrench, split) in zip(held, columns, strict=True):
            wrench[0].set_title(_title(rows_of_run[i]))
            for panel, first in zip(wrench, rows.values(), strict=True):
                for axis, (label, colour, line) in enumerate(style.COMPONENTS):
                    panel.plot(run.t, run.grasp_wrench[:, i, first + axis], line, color=colour, label=label)
            for label, line, colour, part in parts:
                split.plot(run.t, np.linalg.norm(part[:, i], axis=1), line, color=colour, label=label)
        split_lines = columns[0][-1].lines if held and len(parts) > 1 else []
        handles = [*columns[0][0].lines, *split_lines] if held else []
        style.without_spikes(figure, columns)
        for *_, split in columns:  # after all curves are drawn, because the panels of a row share an axis
            split.set_ylim(bottom=0)
        if held:
            figure.legend(handles=handles, loc="outside upper center", ncols=5, columnspacing=1.0)
    return figure


def rows_of(chain: ClosedChain, run: Trajectory) -> Sequence[GraspRow]:
    """Return what the rows of a run's wrenches and margins belong to."""
    return grasp_rows(chain) if run.setting is None else run.setting.rows


def _title(row: GraspRow) -> str:
    """Return the name of a row and, if it has one in the initial state, the kind of its grasp."""
    return style.drawn_text(row.name) + ("" if row.grasp is None else f" ({row.grasp.kind})")


def joint_torque_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the joint torques and of their share of the limits, one column per arm and for a trunk.

    The joints of an arm differ in the shade of its colour and in dash. Of more than seven joints, the seven that come
    nearest to their limits (without limits, those with the largest torques) are distinguished; the others are grey.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    driven = [name for name, joints in chain.joints_of.items() if any(joint.actuated for joint in joints)]
    named = 0.13 * max((min(len(chain.joints_of[name]), len(style.JOINT_DASHES)) for name in driven), default=0)
    labels = (_label(chain), "share of limit [%]")
    with style.columns_of_panels(len(driven), 3.0 + named, 0.2, labels) as (figure, columns):
        for name, (torque, share) in zip(driven, columns, strict=True):
            torque.set_title(style.drawn_text(name))
            _draw(chain, run, name, torque, share)
            told_apart = [line for line in torque.lines if not line.get_label().startswith("_")]
            share.legend(handles=told_apart, loc="upper center", bbox_to_anchor=(0.5, -0.4), borderaxespad=0)
        style.without_spikes(figure, columns, ((), (0.0, 100.0)))
        for _, share in columns:  # after all curves are drawn, because the panels of a row share an axis
            share.set_ylim(0, max(105.0, share.get_ylim()[1]))
    return figure


def _draw(chain: ClosedChain, run: Trajectory, name: str, torque: Any, share: Any) -> None:
    """Draw the torques of one arm, or of "trunk", into its two panels."""
    joints = [
        (changed(joint, name=f"{joint.name or f'joint{k + 1}'}{axis}"), joint.actuated)
        for k, joint in enumerate(chain.joints_of[name])
        for axis in ((" x", " y", " z") if joint.type.quaternion else ("",))
    ]
    tau = run.tau[:, chain.joints[name]][:, [drives for _, drives in joints]]
    joints = [joint for joint, drives in joints if drives]
    limits = np.array([joint.effort_limit for joint in joints])
    limited = np.isfinite(limits)
    use = np.where(limited, 100 * np.abs(tau) / limits, 0.0)
    most = (use if limited.any() else np.abs(tau)).max(axis=0)
    first = sorted(np.argsort(-most, kind="stable")[: len(style.JOINT_DASHES)])
    for k, joint in enumerate(joints):
        colour, line, label = style.OTHERS, "-", "_"
        if k in first:
            colour, line = style.joint_style(style.part_colour(chain, name), first.index(k), len(first))
            label = style.drawn_text(joint.name)
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
    """Return a figure of a floating base: shift and rotation from its initial pose, and its velocity, world axes.

    Args:
        run: a run of a chain whose base floats.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    travel = base_travel(run.base_pose)
    labels = ("shift [m]", "turn [rad]", "velocity [m/s]", "turning [rad/s]")
    with style.stacked_panels(5.6, labels) as (figure, panels):
        for panel, values in zip(panels, (*travel, run.base_twist[:, 3:], run.base_twist[:, :3]), strict=True):
            for axis, (name, colour, line) in enumerate(style.COMPONENTS):
                panel.plot(run.t, values[:, axis], line, color=colour, label=name)
        figure.legend(handles=panels[0].lines, loc="outside upper center", ncols=3, columnspacing=1.0)
    return figure


def load_share_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the share of the net force on the object that each arm carries, and of that force.

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
    with style.stacked_panels(3.2, ("load share [%]", "net force [N]"), (1.6, 1)) as (figure, (share, force)):
        for i, name in enumerate(chain.names):
            if run.holding[:, i].any():
                share.plot(run.t, shares[:, i], **style.labelled(i, name))
        share.set_ylim(*_wide_enough(shares))
        force.plot(run.t, net, "-", color=style.BLACK)
        force.set_ylim(0, 1.08 * net.max() or 1.0)
        style.without_spikes(figure, [(share, force)], ((0.0, 100.0), (0.0,)))
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
    with style.stacked_panels(6.4, labels, (1, 1, 1.6, 1)) as (figure, (position, velocity, energy, balance)):
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
    """Return the ends of at most `POINTS` short intervals of time, and the largest gap within each."""
    if len(t) < 2:
        return t, np.maximum(gaps, SMALLEST_GAP)
    # the first sample is not the result of a step
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


def friction_margin_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the margin of every grasp with a limit, and of the instants of slip.

    Where the grasp forces are not unique, a band shows the possible margins.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    names = [row.name for row in rows_of(chain, run)]
    limited = [i for i in range(len(names)) if np.isfinite(run.margin[:, i]).any()]
    with style.new_figure(style.COLUMN, 2.6) as figure:
        panel = figure.subplots()
        panel.axhspan(-BEYOND, 0.0, color=style.DANGER, alpha=0.12, linewidth=0, zorder=0)
        panel.axhline(0.0, color=style.DANGER, linewidth=0.8)
        for i in limited:
            margin = np.where(np.isfinite(run.margin[:, i]), run.margin[:, i], np.nan)
            panel.plot(run.t, margin, **style.labelled(i, names[i]))
        low, high = _range(run.margin)
        for i in limited if "worst_margin" in run.recorded else ():
            worst, best = (np.clip(m[:, i], -BEYOND, BEYOND) for m in (run.worst_margin, run.best_margin))
            if (best - worst > NARROWEST_BAND * (high - low)).any():
                panel.fill_between(run.t, worst, best, color=style.arm_style(i)[0], alpha=0.15, linewidth=0)
        _mark_slips(panel, run, slips(chain, run), low, high)
        panel.set_ylabel("margin of the grasp [N]")
        panel.set_xlabel("time [s]")
        if limited:
            figure.legend(loc="outside upper center", ncols=4, columnspacing=1.0)
    return figure


def _mark_slips(panel: Any, run: Trajectory, found: list[tuple[str, float]], low: float, high: float) -> None:
    """Set the axes to the margins from low to high, with room above for the instants of slip, and draw these."""
    begin, end = float(run.t[0]), float(run.t[-1])
    line = 0.16 * (high - low)
    top = high + line * (0.5 + min(len(found), MOST_TIMED_SLIPS))
    panel.set_ylim(low - 0.5 * line, top)
    panel.set_xlim(begin, end + 0.02 * ((end - begin) or 1.0))
    for k, (name, t) in enumerate(found):
        panel.axvline(t, color=style.DANGER, linewidth=0.8, linestyle="--")
        if k < MOST_TIMED_SLIPS:
            late = t > 0.6 * end + 0.4 * begin
            panel.annotate(
                f"{style.drawn_text(name)} gives way at {t:.4g} s", (t, top - k * line), (-3 if late else 3, -1),
                textcoords="offset points", ha="right" if late else "left", va="top", fontsize=7, color=style.DANGER,
            )  # fmt: skip


def slips(chain: ClosedChain, run: Trajectory) -> list[tuple[str, float]]:
    """Return arm and time [s] of every instant at which a grasp's margin becomes negative, in order of time.

    They are taken from the run's log; without one, the margin is interpolated linearly between the samples.
    """
    logged = [(one.name, one.t) for one in run.occurrences if one.kind == "violation" and one.quantity == "grasp"]
    if logged:
        return logged
    found = []
    for i, (name, *_) in enumerate(rows_of(chain, run)):
        margin = run.margin[:, i]
        if margin[0] < 0:
            found.append((name, float(run.t[0])))
        for k in np.flatnonzero((margin[:-1] >= 0) & (margin[1:] < 0)):
            share = margin[k] / (margin[k] - margin[k + 1]) if np.isfinite(margin[k]) else 1.0
            found.append((name, float(run.t[k] + share * (run.t[k + 1] - run.t[k]))))
    return sorted(found, key=lambda slip: slip[1])


def _range(margin: Array) -> tuple[float, float]:
    """Return the smallest and the largest finite margin, extended to contain 0; they always differ."""
    known = margin[np.isfinite(margin)]
    low, high = float(known.min(initial=0.0)), float(known.max(initial=0.0))
    return (low, high) if high > low else (low, low + 1.0)
