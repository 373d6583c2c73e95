"""Two arms place a box on a table: it comes down tilted, touches with an edge, is pressed flat, and they let go."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.view.figure_style import BLACK, DPI, STYLE, arm_style

HERE = Path(__file__).parent
OUT = HERE / "out"
SCENE = HERE / "place_on_table.toml"


def main(out: Path = OUT) -> dict[str, float]:
    """Return gaps, who carries the weight at the end, and what the account of energies leaves open."""
    out.mkdir(parents=True, exist_ok=True)
    scene = hf.load_scene(SCENE)
    given = scene.chain, scene.state, scene.controller, scene.duration, scene.step
    run = hf.simulate(*given, **scene.options, name="place on a table")
    weight = 9.81 * scene.chain.held_object.mass
    up = {"table": run.touch_force[:, :, 2].sum(axis=1)}
    up |= {name: run.grasp_wrench[:, k, 5] for k, name in enumerate(run.rows)}
    below = np.argsort(run.touch_gap[-1])[:4]  # the lower corners
    lands = float(run.t[np.argmax(up["table"] > 0.0)])
    flat = float(run.t[np.flatnonzero(run.touch_gap[:, below].max(axis=1) > 1e-9)[-1]])
    last = {name: float(force[-1]) for name, force in up.items()}
    print(f"an edge lands after {lands:.3f} s, the box lies flat from {flat:.3f} s on, the hands let go at 0.7 s;")
    print(f"then the table carries {last['table']:.3f} N of {weight:.3f} N")
    draw(run, below, up, weight, out)
    run.page(out / "26_place_on_a_table.html")
    return {"weight": weight, "lands": lands, "flat": flat, "lowest_gap": float(run.touch_gap.min()), **last,
            "closure": float(run.position_gap[:, 1].max()), "imbalance": float(np.abs(run.imbalance).max()),
            "moved": float(np.abs(run.work).max()), "speed": float(np.abs(run.object_twist[-1]).max()),
            "uneven": float(np.ptp(run.touch_gap[-1, below]))}  # fmt: skip


def draw(run: Any, below: np.ndarray, up: dict[str, np.ndarray], weight: float, out: Path) -> None:
    """Draw the distances of the corners, the force on each, and who carries how much."""
    with rc_context(STYLE):
        figure = Figure((7.0, 2.4), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        for place, k in enumerate(below):
            colour, line = arm_style(place)
            left.plot(run.t, 1e3 * run.touch_gap[:, k], color=colour, linestyle=line)
            middle.plot(run.t, run.touch_force[:, k, 2], color=colour, linestyle=line)
        right.plot(run.t, up["table"], color=BLACK, label="table")
        for k, name in enumerate(run.rows):
            right.plot(run.t, up[name], color=arm_style(k)[0], linestyle=arm_style(k)[1], label=f"{name} hand")
        right.axhline(weight, color="0.7", linewidth=0.6)
        right.legend()
        for axes, what in ((left, "gap of each corner [mm]"), (middle, "normal force [N]"), (right, "force, up [N]")):
            axes.set(xlabel="t [s]", title=what)
        middle.set_ylim(0, 60)
        right.set_ylim(-60, 60)
        figure.savefig(out / "26_place_on_a_table.png", dpi=DPI)


if __name__ == "__main__":
    main()
