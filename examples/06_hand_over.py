"""One arm carries a box to another, which grips it in motion: the impulses at both hands, and the momentum balance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.robots import panda
from holdfast.simulation.events import Attach, Release
from holdfast.view.figure_style import BLACK, DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"
MEETING, GRIP, LET_GO, END = [1, 0, 0, 0, 0, 0, 0.6], 0.4, 0.5, 0.8  # wxyz_xyz; s


def main(out: Path = OUT) -> dict[str, float | str]:
    """Return the numbers that this example prints."""
    arms = {"left": panda([1, 0, 0, 0, -0.55, 0, 0]), "right": panda([0, 0, 0, 1, 0.55, 0, 0])}
    box = hf.HeldObject.box(mass=2.0, x=0.2, y=0.2, z=0.2)
    left = hf.Grasp("rigid", hf.contact_frame([-0.1, 0, 0], into=[1, 0, 0]))
    right = hf.Grasp("rigid", hf.contact_frame([0.1, 0, 0], into=[-1, 0, 0]))

    # Where they meet, both hold. Before, the left arm alone has the box 0.1 m nearer to itself; the right one waits.
    _, met = hf.assemble(arms, box, {"left": left, "right": right}, object_pose=MEETING)
    alone = hf.ClosedChain(arms, box, {"left": left})
    start = hf.close(alone, replace(met, object_pose=np.array(MEETING) - [0, 0, 0, 0, 0.1, 0, 0]), hold_object=True)

    # The box passes the meeting place at 0.4 s, at its highest speed; there the right hand closes around it.
    path = RestToRest(start.object_frame, displacement=[0.2, 0, 0], duration=2 * GRIP)
    events: list[Attach | Release] = [Attach(GRIP, "right", right, here=True), Release(LET_GO, "left")]
    run = hf.simulate(alone, start, ObjectTracking(alone, path), END, step=0.02, events=events)

    # Two samples have the time of the grip: just before and just after it.
    before, after = run.object_twist[(run.t >= GRIP - 1e-9) & (run.t <= GRIP + 1e-9)]
    grip = next(one for one in run.occurrences if one.kind == "attach")
    impulse = np.array(grip.impulses)[:, 3:]  # N s, of each hand on the box
    change = box.mass * (after - before)[3:]
    draw(out, run)

    print(f"the box is slowed from {before[3]:.4f} to {after[3]:.4f} m/s; impulses of the hands along x: left")
    print(f"    {impulse[0, 0]:+.4f} N s, right {impulse[1, 0]:+.4f} N s, their sum {impulse.sum(axis=0)[0]:+.4f} N s")
    print(f"m times the change of velocity: {change[0]:+.4f} N s; kinetic energy lost: {-grip.energy_change:.4f} J")
    return {
        "change": float(change[0]),
        "impulse": float(impulse.sum(axis=0)[0]),
        "impulse_error": float(np.abs(impulse.sum(axis=0) - change).max()),
        "energy_change": grip.energy_change,
        "momentum_error": float(np.abs(run.momentum_imbalance).max()),
        "momentum_moved": float(np.abs(run.momentum).max()),
        "holds_at_end": ", ".join(np.array(alone.names)[run.holding[-1]]),
    }


def draw(out: Path, run: hf.simulation.Trajectory) -> None:
    """Draw the speed of the box, and what each hand lifts and pushes."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 4.2), layout="constrained")
        speed, push, lift = figure.subplots(3, 1, sharex=True)
        speed.plot(run.t, run.object_twist[:, 3], "-", color=BLACK)
        for k, name in enumerate(("left", "right")):
            colour, line = arm_style(k)
            push.plot(run.t, run.grasp_wrench[:, k, 3], linestyle=line, color=colour, label=name)
            lift.plot(run.t, run.grasp_wrench[:, k, 5], linestyle=line, color=colour)
        for axes in (speed, push, lift):
            for t in (GRIP, LET_GO):
                axes.axvline(t, color="#888888", linewidth=0.8)
        for t, text in ((GRIP, "right grips "), (LET_GO, " left lets go")):
            side = "right" if text.endswith(" ") else "left"
            speed.text(t, 0.04, text, ha=side, transform=speed.get_xaxis_transform(), fontsize=7)
        speed.set(ylabel="speed along x [m/s]")
        push.set(ylabel="force along x [N]")
        lift.set(ylabel="force up [N]", xlabel="time [s]")
        figure.align_ylabels()
        figure.legend(handles=push.lines[:2], loc="outside upper center", ncols=2)
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "06_hand_over.png", dpi=DPI)


if __name__ == "__main__":
    main()
