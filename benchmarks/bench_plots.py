"""Figures of a benchmark run: time against arms, against joints, and per state against batch size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.bench import acceptance
from benchmarks.bench.entries import LIBRARY, PUBLIC
from holdfast.view import figure_style
from holdfast.view.figure_style import BLACK, BLUE, COLUMN, GREEN, ORANGE, PURPLE, SKY, STYLE, VERMILLION

Document = dict[str, Any]
# library, method, label, colour, line, marker
CURVES = (
    ("pinocchio", "constraintDynamics, free", "Pinocchio constraintDynamics, free object", VERMILLION, "--", "s"),
    ("pinocchio", "constraintDynamics, tree", "Pinocchio constraintDynamics, tree", ORANGE, "-.", "D"),
    ("pinocchio", "lcaba", "Pinocchio lcaba, tuned, better form", GREEN, "--", "^"),
    ("mujoco", "mj_forward", "MuJoCo mj_forward, soft welds, best solver", PURPLE, "-.", "v"),
    ("pinocchio", "aba", "Pinocchio aba, no grasps (floor)", SKY, ":", "x"),
)


def save(document: Document, folder: Path) -> list[str]:
    """Write every figure and return the files' names."""
    systems = document["systems"]
    figures = {
        "bench_arms.png": curves([r for r in systems if r["joints"] == 7], "arms", "arms of 7 joints"),
        "bench_links.png": curves([r for r in systems if r["arms"] == 2], "joints", "joints of each of 2 arms"),
        "bench_batch.png": batch_curve(document),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        figure.savefig(folder / name, dpi=figure_style.DPI)
    return list(figures)


def curves(records: list[dict[str, Any]], along: str, label: str) -> Any:
    """Return a log-log figure of microseconds per evaluation.

    Args:
        records: of systems.
        along: the size on the horizontal axis, "arms" or "joints".
        label: of that axis.
    """
    records = sorted(records, key=lambda record: record[along])
    Figure, rc_context = figure_style.matplotlib()
    with rc_context(STYLE):
        figure = Figure(figsize=(1.45 * COLUMN, 3.6), layout="constrained")
        panel = figure.subplots()
        own = [(r[along], _entry(r, LIBRARY, PUBLIC)["microseconds"]) for r in records]
        _own_curve(panel, own, "holdfast")
        for library, method, name, colour, line, marker in CURVES:
            points = [(r[along], e["microseconds"]) for r in records if (e := _entry(r, library, method))]
            if points:
                panel.loglog(*zip(*points, strict=True), line, color=colour, marker=marker, markersize=4, label=name)
        _axes(panel, [record[along] for record in records], label)
        figure.legend(loc="outside upper center", ncols=2, columnspacing=1.2)
    return figure


def batch_curve(document: Document) -> Any:
    """Return a log-log figure of microseconds per state against the states in one call."""
    found = document["batches"]
    record = next(r for r in document["systems"] if r["name"] == found["system"])
    sizes = [row["size"] for row in found["sizes"]]
    Figure, rc_context = figure_style.matplotlib()
    with rc_context(STYLE):
        figure = Figure(figsize=(1.45 * COLUMN, 3.2), layout="constrained")
        panel = figure.subplots()
        _own_curve(panel, [(row["size"], row["microseconds"]) for row in found["sizes"]], "holdfast, batch")
        single = _entry(record, LIBRARY, PUBLIC)["microseconds"]
        panel.axhline(single, color=BLACK, linestyle=":", label="holdfast, one state a call")
        for library, label, colour, line in (
            ("pinocchio", "Pinocchio {}, in a loop", ORANGE, "--"),
            ("mujoco", "MuJoCo {}, in a loop (soft welds)", PURPLE, "-."),
        ):
            if rival := acceptance.fastest(record, library):
                name = label.format(rival["name"])
                panel.axhline(rival["microseconds"], color=colour, linestyle=line, label=name)
        _axes(panel, sizes, f"states in one call ({found['system']}, one thread)", "us per state")
        figure.legend(loc="outside upper center", ncols=2, columnspacing=1.2)
    return figure


def _own_curve(panel: Any, points: list[tuple[int, float]], name: str) -> None:
    """Draw our times: thicker than the others' and in front of them."""
    style = {"color": BLUE, "marker": "o", "markersize": 5, "linewidth": 2.4, "zorder": 3}
    panel.loglog(*zip(*points, strict=True), "-", label=name, **style)


def _entry(record: dict[str, Any], library: str, method: str) -> Any:
    """Return the fastest accurate entry whose name begins so, else a floor or an own entry of that name."""
    named = (e for e in record["entries"] if e["library"] == library and e["name"].startswith(method))
    return (acceptance.fastest(record, library, method) if library != LIBRARY else None) or next(named, None)


def _axes(panel: Any, ticks: list[int], label: str, times: str = "us per evaluation") -> None:
    panel.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
    panel.xaxis.minorticks_off()
    panel.yaxis.set_major_formatter(lambda value, _: f"{value:,g}")
    panel.set_xlabel(label)
    panel.set_ylabel(times.replace("us", "µs"))
