"""The roofline of this processor: what it computes at most, and what it can fetch for it from its nearest cache.

Reference: Williams, Waterman, Patterson, "Roofline: an insightful visual performance model for multicore
architectures", Communications of the ACM 52(4), 2009.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.bench.clock import least_time
from holdfast.compiler.kernel import aligned
from holdfast.compiler.targets import cpu
from holdfast.compiler.targets.llvm.functions import declarations, number_type
from holdfast.view import figure_style
from holdfast.view.figure_style import BLACK, BLUE, COLUMN, GREEN, ORANGE, STYLE, VERMILLION

CHAINS = 12  # independent sums, so that none waits for the one before, in fewer registers than there are
TURNS = 20_000  # of a loop
HELD = 2048  # doubles that are read again and again: a third of the nearest cache


class Roof(NamedTuple):
    """The limits of one processor level for a number of lanes.

    Attributes:
        rate: operations in a nanosecond, an fma being two.
        bandwidth: bytes in a nanosecond from the nearest cache.
    """

    rate: float
    bandwidth: float


def roof(level: str, lanes: int) -> Roof:
    """Measure the limits."""
    with cpu.made_for(cpu.level(level)):
        fma = _seconds(lanes, "fma") / (TURNS * CHAINS * lanes)
        load = _seconds(lanes, "load") / (TURNS * CHAINS * lanes)
    return Roof(2e-9 / fma, 8e-9 / load)


def _seconds(lanes: int, what: str) -> float:
    """Return the least time of a loop."""
    code = cpu.Code(_loop(lanes, what), "loop")
    run, memory = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(code.address), aligned(HELD + CHAINS * lanes)
    address = memory.ctypes.data
    return least_time(lambda: run(address), 20, 30)


def _loop(lanes: int, what: str) -> str:
    """Return a loop of independent chains of fma, or of sums of numbers in memory."""
    T = number_type(lanes)
    suffix = "f64" if lanes == 1 else f"v{lanes}f64"
    mask = HELD - 1
    lines = [
        *declarations(lanes),
        "define void @loop(ptr %memory) nounwind {",
        "entry:",
        f"  %x = load {T}, ptr %memory, align 8",
        "  br label %turn",
        "turn:",
        "  %k = phi i64 [ 0, %entry ], [ %k.next, %turn ]",
        *(f"  %sum{j} = phi {T} [ %x, %entry ], [ %next{j}, %turn ]" for j in range(CHAINS)),
        f"  %begin = mul i64 %k, {CHAINS * lanes}",
        f"  %from = and i64 %begin, {mask}",
        "  %row = getelementptr double, ptr %memory, i64 %from",
    ]
    for j in range(CHAINS):
        if what == "fma":
            lines.append(f"  %next{j} = call {T} @llvm.fma.{suffix}({T} %sum{j}, {T} %x, {T} %x)")
        else:
            lines += [
                f"  %at{j} = getelementptr double, ptr %row, i64 {j * lanes}",
                f"  %read{j} = load {T}, ptr %at{j}, align 8",
                f"  %next{j} = fadd {T} %sum{j}, %read{j}",
            ]
    lines += ["  %k.next = add i64 %k, 1", f"  %more = icmp slt i64 %k.next, {TURNS}"]
    lines += ["  br i1 %more, label %turn, label %done", "done:"]
    lines += [f"  store volatile {T} %next{j}, ptr %memory, align 8" for j in range(CHAINS)]
    return "\n".join([*lines, "  ret void", "}"])


# level, one system or lanes: label, colour, marker, line
LOOKS = {
    ("x86-64-v3", False): ("AVX2, one system", ORANGE, "s", ":"),
    ("x86-64-v3", True): ("AVX2, 4 systems in lanes", VERMILLION, "D", "--"),
    ("x86-64-v4", False): ("AVX-512, one system", GREEN, "^", ":"),
    ("x86-64-v4", True): ("AVX-512, 8 systems in lanes", BLUE, "o", "-"),
}


def save(rows: Sequence[Any], folder: Path) -> str:
    """Draw rows of `registers` under their roofs, and the numbers in use along the first; return the file's name.

    Code for lanes that runs for one system is left out.
    """
    rows = [row for row in rows if row.wide == (row.systems > 1)]
    Figure, rc_context = figure_style.matplotlib()
    with rc_context(STYLE):
        figure = Figure(figsize=(2.1 * COLUMN, 3.3), layout="constrained")
        panel, beside = figure.subplots(1, 2, width_ratios=(1.25, 1))
        _roofs(panel, rows)
        _pressure(beside, rows)
        names = enumerate(dict.fromkeys(row.name for row in rows), 1)
        figure.supxlabel("   ".join(f"{k} {name}" for k, name in names), size=6)
        figure.legend(*panel.get_legend_handles_labels(), loc="outside upper center", ncols=4, columnspacing=1.2)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "roofline.png", dpi=figure_style.DPI)
    return "roofline.png"


def _roofs(panel: Any, rows: Sequence[Any]) -> None:
    names = list(dict.fromkeys(row.name for row in rows))
    found = [row.intensity for row in rows]
    span = np.geomspace(0.8 * min(found), 1.6 * max(found), 100)
    for (level, wide), (label, colour, marker, line) in LOOKS.items():
        own = [row for row in rows if row.level == level and row.wide == wide]
        if wide and own:
            limits = roof(level, max(row.systems for row in own))
            panel.loglog(span, np.minimum(limits.rate, limits.bandwidth * span), line, color=colour, linewidth=1.0)
        for row in own:
            panel.loglog(row.intensity, row.rate, marker, color=colour, markersize=8, alpha=0.55, markeredgewidth=0)
            panel.annotate(f"{names.index(row.name) + 1}", (row.intensity, row.rate), ha="center", va="center", size=5)
        panel.plot([], [], marker, color=colour, linestyle=line if wide else "", label=label, markersize=5)
    panel.set_xlabel("operations for every byte read or written")
    panel.set_ylabel("operations in a nanosecond")
    limits = panel.get_xlim(), panel.get_ylim()
    for axis, ticks in ((panel.xaxis, (0.1, 0.15, 0.2, 0.3, 0.5, 1.0)), (panel.yaxis, (1, 2, 5, 10, 20, 50, 100, 200))):
        axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.minorticks_off()
    panel.set_xlim(limits[0])
    panel.set_ylim(limits[1])


def _pressure(panel: Any, rows: Sequence[Any]) -> None:
    row = max((row for row in rows if row.name == rows[0].name), key=lambda row: row.systems)
    panel.plot(row.counts.live, color=BLACK, linewidth=0.8)
    for registers, label, colour in ((16, "AVX2 has 16 registers", VERMILLION), (32, "AVX-512 has 32", BLUE)):
        panel.axhline(registers, color=colour, linewidth=1.0, linestyle="--", label=label)
    panel.legend(loc="upper left")
    panel.set_xlabel(f"instruction of {row.name}")
    panel.set_ylabel("numbers in use")
