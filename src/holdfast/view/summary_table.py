"""The summary of a run as a table on the terminal."""

from __future__ import annotations

from typing import Any

from holdfast.simulation.summary import Summary


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
    lines = [
        ("simulated", f"{summary.last_time:g} s, {summary.samples} samples"),
        ("closure error (position)", f"{summary.worst_position_gap:.1e} m or rad"),
        ("closure error (velocity)", f"{summary.worst_velocity_gap:.1e} m/s or rad/s"),
        ("drift of one step, before projection", f"{summary.worst_step_drift:.1e} m or rad"),
        ("energy balance", f"off by {summary.energy_imbalance:.1e} J of {summary.energy_moved:.3g} J moved"),
    ]
    for name, force in summary.peak_force.items():
        lines.append((f"peak grasp wrench, {name}", f"{force:.4g} N, {summary.peak_moment[name]:.3g} N m"))
    lines.append(("worst condition of the grasps", f"{summary.worst_condition:.3g}"))
    if summary.torque_use is not None:
        share, joint = summary.torque_use
        lines.append(("largest torque", f"{100 * share:.0f} % of the limit of {joint}"))
    if summary.limit_excess is not None:
        excess, joint = summary.limit_excess
        lines.append(("joint limit passed", f"{joint} by {excess:.2g} rad or m"))
    return lines
