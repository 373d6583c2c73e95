"""The summary of a run as a table on the terminal."""

from __future__ import annotations

from typing import Any

from holdfast.simulation.summary import Summary

MOST_OCCURRENCES = 12  # lines; the rest is in summary.json
JOINT_UNITS = {"position": "rad or m", "rate": "rad/s or m/s", "effort": "N m or N"}


def summary_table(summary: Summary) -> Any:
    """Return the summary as a rich Table."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, show_header=False, pad_edge=False)
    table.add_column("quantity", no_wrap=True)
    table.add_column("value", no_wrap=True)
    for quantity, value in rows(summary):
        table.add_row(quantity, value)
    return table


def rows(summary: Summary) -> list[tuple[str, str]]:
    """Return (quantity, value with unit) of every line of the table."""
    most_angular, most_linear = summary.momentum_moved or (0.0, 0.0)
    unexplained = "not known: it needs a sample at every step"
    if summary.momentum_moved is None:
        unexplained = "not known for chains with branches"
    if summary.momentum_imbalance is not None:
        angular, linear = summary.momentum_imbalance
        unexplained = f"off by {angular:.1e} N m s of {most_angular:.3g}, {linear:.1e} N s of {most_linear:.3g}"
    lines = [
        ("simulated", f"{summary.last_time:g} s, {summary.samples} samples"),
        ("closure error (position)", f"{summary.worst_position_gap:.1e} m or rad"),
        ("closure error (velocity)", f"{summary.worst_velocity_gap:.1e} m/s or rad/s"),
        ("drift of one step, before projection", f"{summary.worst_step_drift:.1e} m or rad"),
        ("energy balance", f"off by {summary.energy_imbalance:.1e} J of {summary.energy_moved:.3g} J moved"),
        ("momentum balance", unexplained),
    ]
    for name, force in summary.peak_force.items():
        internal = summary.peak_internal_force.get(name)
        inner = "" if internal is None else f"; internal force {internal:.4g} N"
        lines.append((f"peak grasp wrench, {name}", f"{force:.4g} N, {summary.peak_moment[name]:.3g} N m{inner}"))
    lines += [(f"spin about the normal, {name}", f"{spin:.3g} rad") for name, spin in summary.spin.items()]
    lines += _margins(summary)
    if summary.peak_force:  # something has held the object
        lines.append(("worst condition of the grasps", f"{summary.worst_condition:.3g}"))
    if summary.torque_use is not None:
        share, joint = summary.torque_use
        lines.append(("largest torque", f"{100 * share:.0f} % of the limit of {joint}"))
    if summary.limit_excess is not None:
        excess, joint = summary.limit_excess
        lines.append(("joint limit passed", f"{joint} by {excess:.2g} rad or m"))
    return lines + _occurrences(summary)


def _margins(summary: Summary) -> list[tuple[str, str]]:
    lines = []
    for name, (margin, t) in summary.lowest_margin.items():
        text = f"{margin:.4g} N at t = {t:.6g} s"
        if name in summary.lowest_best_margin:
            best = summary.lowest_best_margin[name]
            most = "as large as you like" if best is None else f"at best {best:.4g} N"
            text = f"not unique: {most} by forces that load no joint; with the smallest forces {text}"
        lines.append((f"lowest margin, {name}", text))
    for quantity, (margin, joint, t) in summary.lowest_joint_margin.items():
        lines.append((f"lowest {quantity} margin", f"{margin:.3g} {JOINT_UNITS[quantity]}, {joint}, at t = {t:.6g} s"))
    return lines


def _occurrences(summary: Summary) -> list[tuple[str, str]]:
    first = sorted(summary.occurrences, key=lambda one: one.kind != "unresolved")  # casts doubt on all that follows
    shown = first[:MOST_OCCURRENCES]
    lines = [(f"t = {one.t:.9g} s", one.text) for one in shown]
    left = len(summary.occurrences) - len(shown)
    return lines + ([("and", f"{left} more, see summary.json")] if left else [])
