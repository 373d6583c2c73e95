"""A grip that slips and catches: two jaws yield until a block slides down between them, then close firmly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.view.figure_style import DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"
EDGE, MASS, MU, G = 0.1, 1.5, 0.4, 9.81  # of the block [m], [kg], friction, [m/s^2]
START, YIELDS, CLOSES, FIRM = (
    30.0,
    40.0,
    0.45,
    35.0,
)  # squeeze [N], its loss [N/s], then at this time [s] this again [N]
SIDES = {"left": -1.0, "right": 1.0}


def jaws() -> tuple[hf.ClosedChain, hf.State]:
    """Return a block between two soft pads, each on a slide."""
    arms, grasps = {}, {}
    for name, side in SIDES.items():
        pad = hf.contact_frame([side * EDGE / 2, 0, 0], into=[-side, 0, 0])
        slide = hf.Joint("prismatic", [1, 0, 0], name="x")
        jaw = hf.Link(0.4, np.zeros(3), 1e-4 * np.eye(3))
        base = hf.Pose.translation(side * EDGE / 2, 0, 0)
        arms[name] = hf.Arm([slide], [jaw], tip=hf.Pose(pad.R, np.zeros(3)), base=base)
        grasps[name] = hf.Grasp("softfinger", pad, hf.Friction(MU, torsion_radius=0.01))
    chain = hf.ClosedChain(arms, hf.HeldObject.box(MASS, EDGE, EDGE, EDGE), grasps, gravity=[0, 0, -G])
    return chain, hf.State(np.zeros(2), np.zeros(2), [1, 0, 0, 0, 0, 0, 0], np.zeros(6))


def squeeze(t: float, state: hf.State, memory: Any) -> tuple[np.ndarray, Any]:
    """Return the jaws' forces: less and less, then firm."""
    force = START - YIELDS * t if t < CLOSES else FIRM
    return np.array([force, -force]), memory


def on_paper() -> dict[str, float]:
    """Return when the block slips and stops, and how far it falls: m a = m g - 2 mu f."""
    slips = (START - MASS * G / (2 * MU)) / YIELDS
    s, slowing = CLOSES - slips, 2 * MU * FIRM / MASS - G
    speed = MU * YIELDS * s**2 / MASS
    fall = MU * YIELDS * s**3 / (3 * MASS) + speed**2 / (2 * slowing)
    return {"slips": slips, "stops": CLOSES + speed / slowing, "fall": fall}


def main(out: Path = OUT) -> dict[str, float]:
    """Return by how much times, fall and energies differ from those on paper."""
    out.mkdir(parents=True, exist_ok=True)
    chain, state = jaws()
    run = hf.simulate(chain, state, squeeze, 0.8, 0.05, breakpoints=[CLOSES], on_slip="slide", name="slipping grip")
    for one in run.occurrences:
        print(f"{one.t:.6f} s: {one.text}")
    paper = on_paper()
    when = {kind: next(one.t for one in run.occurrences if one.kind == kind) for kind in ("slip", "stick")}
    fall, lost = -float(run.object_pose[-1, 6]), -float(run.work[-1].sum())
    print(f"falls {1e3 * fall:.3f} mm ({1e3 * paper['fall']:.3f} on paper); friction takes {1e3 * lost:.2f} mJ")
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 3.4), layout="constrained")
        force, height = figure.subplots(2, sharex=True)
        pressing, rubbing = np.abs(run.grasp_wrench[:, 0, 3]), np.abs(run.grasp_wrench[:, 0, 5])
        force.plot(run.t, MU * pressing, color="0.6", label="friction that a hand can give")
        force.plot(run.t, rubbing, color=arm_style(0)[0], label="friction of the left hand")
        force.set(ylabel="force [N]", ylim=(0, 1.1 * MU * FIRM))
        force.legend()
        times = np.linspace(0, run.t[-1], 400)
        fallen = [1e3 * run.state_at(t).object_pose[6] for t in times]
        height.plot(times, fallen, color=arm_style(1)[0])
        height.set(xlabel="time [s]", ylabel="height [mm]")
        for axes in (force, height):
            axes.axvspan(paper["slips"], paper["stops"], color="0.93")
        figure.savefig(out / "25_a_grip_that_slips.png", dpi=DPI)
    return {"slip_error": abs(when["slip"] - paper["slips"]), "stick_error": abs(when["stick"] - paper["stops"]),
            "fall_error": abs(fall - paper["fall"]), "energy_error": abs(lost - MASS * G * fall),
            "imbalance": float(np.abs(run.imbalance).max()), "holds": float(run.holding[-1].all())}  # fmt: skip


if __name__ == "__main__":
    main()
