"""Write how contacts of one object come out beside MuJoCo and Drake: a figure, and a table in docs/how_to/contact.md.

    python benchmarks/contact_figure.py [--write docs/how_to/contact.md]

Four scenes with the same bodies, points, friction and steps of 1 ms everywhere; the points are spheres of 5 mm:

slope   a box stands on a slope of 15 degrees, below its angle of friction: it should not move
table   a box falls 20 mm flat onto a table and rests there: no point should be within it
edge    a tilted box strikes the table with an edge, without restitution: the turning rate after that is known
arms    two Pandas under an impedance lower a tilted box onto a table (holdfast and MuJoCo)

MuJoCo and Drake have their defaults, and once hard settings that their manuals suggest for contacts. What is missing of
both is left out: `pip install mujoco-core`, `pip install drake`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.contact_scenes import (
    BEGINS,
    DEFAULT,
    ENDS,
    HARD,
    LASTS,
    STEP,
    Course,
    arms_by_holdfast,
    arms_by_mujoco,
    by_drake,
    by_holdfast,
    by_mujoco,
    rate_on_paper,
    scenes,
)
from holdfast.view import figure_style
from holdfast.view.figure_style import BLUE, GREEN, ORANGE, SKY, STYLE, VERMILLION


def courses(report: Callable[[str], None]) -> Iterator[Course]:
    """Yield every course that can be computed here."""
    ways: list[tuple[Callable[..., Course], tuple[object, ...]]] = [(arms_by_holdfast, ())]
    ways += [(by_holdfast, (scene,)) for scene in scenes()]
    for settings in (DEFAULT, HARD):
        ways += [(by, (scene, settings)) for by in (by_mujoco, by_drake) for scene in scenes()]
        ways += [(arms_by_mujoco, (settings,))]
    for way, given in ways:
        try:
            found = way(*given)
        except ImportError as missing:
            report(f"left out: {missing}")
            continue
        report(f"{found.scene}: {found.who}")
        yield found


COLOURS = {"holdfast": (BLUE, "-"), f"MuJoCo {DEFAULT}": (VERMILLION, "-"), f"MuJoCo {HARD}": (ORANGE, "--"),
           f"Drake {DEFAULT}": (GREEN, "-"), f"Drake {HARD}": (SKY, "--")}  # fmt: skip
LEAST = 1e-10  # mm: no creep at all is drawn there
AFTER = 0.003  # s after an impact


def shown(who: str) -> str:
    """Return simulator and settings without its version."""
    name, _, settings = who.partition(", ")
    return f"{name.split()[0]} {settings}".strip()


def creep(one: Course) -> float:
    """Return how fast the box on a slope moves once it has settled [mm/s]."""
    way = np.linalg.norm(one.pose[-1, 4:] - one.pose[round(BEGINS / STEP) - 1, 4:])
    return 1e3 * float(way) / (ENDS - BEGINS)


def after_impact(one: Course) -> float:
    """Return the turning rate shortly after the impact [rad/s]."""
    struck = int(np.argmax(one.force > 0.0))
    return float(one.twist[struck + round(AFTER / STEP), 1])


HEADINGS = ("", "creep on the slope [mm/s]", "deepest when it falls [mm]", "then at rest [mm]", "turning rate [rad/s]",
            "deepest under the arms [mm]", "step of the free box [µs]", "step with two arms [µs]")  # fmt: skip


def table(found: list[Course]) -> str:
    """Return the numbers as a Markdown table."""
    by: dict[str, dict[str, Course]] = {}
    for one in found:
        by.setdefault(one.who, {})[one.scene] = one
    rows = [HEADINGS, ("---",) * len(HEADINGS)]
    for who, of in by.items():
        fall, arms = of["table"], of.get("arms")
        own = depth(fall.gap.min()), depth(fall.gap[-1]), f"{after_impact(of['edge']):.3f}"
        with_arms = ("-", "-") if arms is None else (depth(arms.gap.min()), costs(arms))
        rows.append((who, f"{creep(of['slope']):.1e}", *own, with_arms[0], costs(fall), with_arms[1]))
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def costs(one: Course) -> str:
    """Return the processor time of a step [us], and of one of many systems in brackets."""
    return f"{1e6 * one.cost:,.0f}" + (f" ({1e6 * one.together:,.1f})" if one.together is not None else "")


def depth(gap: float) -> str:
    """Return how deep a point is within the plane [mm]."""
    return f"{max(-1e3 * gap, 0.0):.1e}"


def figure(found: list[Course]) -> Any:
    """Return creep, gap, turning rate, and the table's force under the arms."""
    Figure, rc_context = figure_style.matplotlib()
    with rc_context(STYLE):
        made = Figure(figsize=(7.0, 4.8), layout="constrained")
        panels = dict(zip(("slope", "table", "edge", "arms"), made.subplots(2, 2).flat, strict=True))
        start = {scene.name: scene.pose.p for scene in scenes()}
        for one in found:
            colour, line = COLOURS[shown(one.who)]
            look: Any = {"color": colour, "linestyle": line, "linewidth": 0.9}
            if one.scene == "slope":
                way = 1e3 * np.linalg.norm(one.pose[:, 4:] - start["slope"], axis=1)
                panels["slope"].semilogy(one.t, np.maximum(way, LEAST), label=shown(one.who), **look)
            elif one.scene == "table":
                panels["table"].plot(one.t, 1e3 * one.gap, **look)
            elif one.scene == "edge":
                panels["edge"].plot(1e3 * one.t, one.twist[:, 1], **look)
            else:
                panels["arms"].plot(one.t, one.force, **look)
        edge = rate_on_paper(next(one for one in scenes() if one.name == "edge"))
        panels["edge"].axhline(edge, color="0.7", linewidth=0.6)
        panels["slope"].set(xlabel="time [s]", title="creep on a slope [mm]")
        panels["table"].set(xlabel="time [s]", title="lowest point of a falling box [mm]")
        panels["table"].set(xlim=(0.05, 0.12), ylim=(-5, 2))
        panels["edge"].set(xlabel="time [ms]", title="turning rate of a box that strikes with an edge [rad/s]")
        panels["edge"].set_xlim(0, 30)
        panels["arms"].set(xlabel="time [s]", title="force of the table under two arms [N]")
        panels["arms"].set(xlim=(0.25, LASTS), ylim=(0, 60))
        made.legend(*panels["slope"].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return made


BEGIN, END = "<!-- peers:begin -->\n", "<!-- peers:end -->\n"


def main() -> None:
    """Compute, print the table, and with `--write` put it into the page and the figure beside it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path, help="the page")
    page = parser.parse_args().write
    found = list(courses(lambda text: print(text, file=sys.stderr)))
    made = table(found)
    print(made)
    edge = next(one for one in scenes() if one.name == "edge")
    print(f"on paper it turns at {rate_on_paper(edge):.3f} rad/s right after the impact")
    if page is None:
        return
    before, opened, rest = page.read_text().partition(BEGIN)
    _, closed, after = rest.partition(END)
    if not (opened and closed):
        parser.error(f"{page}: expected {BEGIN.strip()} and after it {END.strip()}")
    page.write_text(f"{before}{BEGIN}{made}{END}{after}")
    figure(found).savefig(Path(__file__).parents[1] / "docs" / "images" / "contact.png", dpi=figure_style.DPI)


if __name__ == "__main__":
    main()
