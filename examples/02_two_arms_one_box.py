"""Two arms carry one box along a path: the loop they form stays closed to rounding error at every step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.robots import panda
from holdfast.view.figure_style import BLACK, DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"


def main(out: Path = OUT) -> dict[str, float]:
    """Return the numbers that this example prints."""
    # Two Pandas 1.1 m apart face each other (poses: quaternion wxyz, then position) and hold a 3 kg box.
    arms = {"left": panda([1, 0, 0, 0, -0.55, 0, 0]), "right": panda([0, 0, 0, 1, 0.55, 0, 0])}
    box = hf.HeldObject.box(mass=3.0, x=0.3, y=0.2, z=0.2)
    grasps = {
        "left": hf.Grasp("rigid", hf.contact_frame([-0.15, 0, 0], into=[1, 0, 0])),
        "right": hf.Grasp("rigid", hf.contact_frame([0.15, 0, 0], into=[-1, 0, 0])),
    }
    assembly = hf.assemble(arms, box, grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.65])
    chain, state = assembly
    print(assembly.report)

    # Up by 0.25 m, to the right by 0.1 m, and tilted by 0.3 rad, within 1 s.
    path = RestToRest(state.object_frame, displacement=[0.1, 0, 0.25], turn=[0, 0.3, 0], duration=1.0)
    run = hf.simulate(chain, state, ObjectTracking(chain, path, internal_force=20.0), duration=1.0, step=0.02)

    goal = path.at(1.0).pose
    miss = float(np.linalg.norm(run.object_pose[-1, 4:] - goal.p))
    gap = float(run.position_gap[:, 1].max())
    draw(out, chain, run)
    print(f"the box ends {1e3 * miss:.4f} mm from its goal; the closure error stays below {gap:.1e} m")
    return {
        "mobility": assembly.report.mobility,
        "miss": miss,
        "gap": gap,
        "lifted": float(np.ptp(run.object_pose[:, 6])),
        "energy_error": float(np.abs(run.imbalance).max()),
    }


def draw(out: Path, chain: hf.ClosedChain, run: hf.simulation.Trajectory) -> None:
    """Draw arms and box from the side, where they began and where they ended."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * (0.15, 0.1)
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 3.6), layout="constrained")
        axes = figure.subplots()
        for k, strength in ((0, 0.35), (-1, 1.0)):
            state = run.state(k)
            for i, (name, arm) in enumerate(chain.arms.items()):
                at = forward_kinematics(arm, state.q[chain.joints[name]])
                points = np.array([arm.base.p, *(at.tip.p - reach for reach in at.reach), at.tip.p])
                label = f"{name}, {'at the end' if k else 'at the beginning'}"
                style: dict[str, Any] = {"color": arm_style(i)[0], "alpha": strength, "markersize": 3}
                axes.plot(points[:, 0], points[:, 2], "o-", label=label, **style)
            frame = state.object_frame
            outline = frame.p[[0, 2]] + corners @ frame.R[np.ix_([0, 2], [0, 2])].T
            axes.fill(*outline.T, color=BLACK, alpha=0.15 * strength)
            axes.plot(*outline.T, color=BLACK, alpha=strength)
        axes.plot(run.object_pose[:, 4], run.object_pose[:, 6], ":", color=BLACK, label="path of the box")
        axes.set(xlabel="x [m]", ylabel="z [m]", aspect="equal")
        figure.legend(loc="outside upper center", ncols=3)
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "02_two_arms_one_box.png", dpi=DPI)


if __name__ == "__main__":
    main()
