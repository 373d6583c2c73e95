"""Two 7-joint arms lower a tilted box until its corners touch a table: by events and by steps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.robots import panda
from holdfast.view.figure_style import DPI, STYLE
from holdfast.world import HalfSpace, Touching, corners

OUT = Path(__file__).parent / "out"
EDGES, MASS, TILT = (0.3, 0.2, 0.1), 3.0, 0.04  # m, kg, rad
UNTIL, GAP, TOO_LITTLE = 0.2, 0.004, 1.0  # s, m, kg: for so much the torques do not hold the box


def lowered() -> tuple[hf.ClosedChain, hf.State, Any]:
    """Return the arms with the box at rest just above a table, and torques that nearly hold it."""
    bases = {"left": [1, 0, 0, 0, -0.55, 0, 0], "right": [0, 0, 0, 1, 0.55, 0, 0]}
    arms = {name: panda(base) for name, base in bases.items()}
    into = {"left": [1.0, 0, 0], "right": [-1.0, 0, 0]}
    grasps = {n: hf.Grasp("rigid", hf.contact_frame([-0.15 * x[0], 0, 0], into=x)) for n, x in into.items()}
    pose = hf.Pose.from_rpy(TILT, 0.0, 0.0)
    pose = hf.Pose(pose.R, [0.0, 0.0, 0.72])
    made = hf.assemble(arms, hf.HeldObject.box(MASS, *EDGES), grasps, object_pose=pose)
    lowest = min((pose.R @ x + pose.p)[2] for x in corners(*EDGES).values())
    below = {name: x for name, x in corners(*EDGES).items() if name[2] == "-"}
    touching = Touching(below, {"table": HalfSpace(offset=lowest - GAP, friction=0.5)})
    lighter = replace(made.chain, held_object=hf.HeldObject.box(MASS - TOO_LITTLE, *EDGES))
    tau = hf.holding_torques(lighter, made.state)
    return replace(made.chain, touching=touching), made.state, tau


def main(out: Path = OUT) -> dict[str, float]:
    """Lower the box both ways, print when corners touch and which laws the runs keep, and draw the gaps."""
    chain, start, tau = lowered()
    hold = lambda t, state, memory: (tau, memory)  # noqa: E731
    found, runs = {}, {}
    for contacts, step in (("events", 0.005), ("steps", 0.004), ("steps", 0.002)):
        run = hf.simulate(chain, start, hold, UNTIL, step, contacts=contacts)
        assert run.stopped is None, run.stopped
        name = f"{contacts} of {1e3 * step:g} ms"
        runs[name] = run
        touches = [f"{one.name} {one.kind} at {one.t:.6f} s" for one in run.occurrences]
        force = run.touch_force[-1].sum(axis=0)
        print(f"{name}: {'; '.join(touches)}")
        print(f"  at the end the table bears {force[2]:.3f} N, the box is at {run.object_pose[-1, 6]:.8f} m")
        print(
            f"  gaps >= {run.touch_gap.min():.1e} m, grasps closed to {run.position_gap[:, 1].max():.1e} m, energy"
            f" that no work explains {np.abs(run.imbalance).max():.1e} J, lost in impacts {-run.impact[-1]:.4f} J"
        )
        found[f"{name}: least gap"] = float(run.touch_gap.min())
        found[f"{name}: closure"] = float(run.position_gap[:, 1].max())
        found[f"{name}: height"] = float(run.object_pose[-1, 6])
    out.mkdir(exist_ok=True, parents=True)
    with rc_context(STYLE):
        figure = Figure(figsize=(6.4, 3.2), layout="constrained")
        axes = figure.subplots()
        for (name, run), line in zip(runs.items(), ("-", "--", ":"), strict=True):
            axes.plot(run.t, 1e3 * run.touch_gap.min(axis=1), line, label=name)
        axes.set(xlabel="time [s]", ylabel="least gap [mm]")
        axes.legend()
        figure.savefig(out / "24_box_on_a_table.png", dpi=DPI)
    return found


if __name__ == "__main__":
    main()
