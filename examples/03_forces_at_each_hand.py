"""The force at each hand while two arms lift a box: the motion part adds up to m (a - g), the internal part to zero."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import holdfast as hf
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.robots import iiwa14
from holdfast.view.figure_style import DPI
from holdfast.view.plots import grasp_wrench_figure

OUT = Path(__file__).parent / "out"
INTERNAL_FORCE = 30.0  # N


def main(out: Path = OUT) -> dict[str, float]:
    """Return the numbers that this example prints."""
    arms = {"left": iiwa14([1, 0, 0, 0, -0.7, 0, 0]), "right": iiwa14([0, 0, 0, 1, 0.7, 0, 0])}
    box = hf.HeldObject.box(mass=5.0, x=0.3, y=0.3, z=0.2)
    grasps = {
        "left": hf.Grasp("rigid", hf.contact_frame([-0.15, 0, 0], into=[1, 0, 0])),
        "right": hf.Grasp("rigid", hf.contact_frame([0.15, 0, 0], into=[-1, 0, 0])),
    }
    chain, state = hf.assemble(arms, box, grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.6])
    path = RestToRest(state.object_frame, displacement=[0, 0, 0.2], turn=[0.5, 0, 0], begin=0.1, duration=0.8)
    run = hf.simulate(chain, state, ObjectTracking(chain, path, internal_force=INTERNAL_FORCE), duration=1.0, step=0.01)

    # A wrench is [moment; force] of the arm on the box about its contact, world axes.
    force = run.grasp_wrench[..., 3:]  # (samples, arms, 3)
    newton = box.mass * (run.object_acceleration[:, 3:] - chain.gravity)
    error = float(np.abs(force.sum(axis=1) - newton).max())

    # The motion part moves the box; the internal part only loads it, and adds up to zero.
    internal = run.internal_wrench[..., 3:]

    figure = grasp_wrench_figure(chain, run)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "03_forces_at_each_hand.png", dpi=DPI)

    print(f"at rest, left hand: {np.round(force[0, 0], 2) + 0.0} N, right hand: {np.round(force[0, 1], 2) + 0.0} N")
    print(f"largest at one hand: {np.linalg.norm(force, axis=2).max():.2f} N, internally {internal[0, 0, 0]:.2f} N")
    print(f"largest |sum of forces - m (a - g)|: {error:.1e} N")
    return {
        "weight": float(-box.mass * chain.gravity[2]),
        "left_up": float(force[0, 0, 2]),
        "right_up": float(force[0, 1, 2]),
        "internal_force": float(internal[0, 0, 0]),
        "internal_sum": float(np.abs(internal.sum(axis=1)).max()),
        "largest": float(np.linalg.norm(force, axis=2).max()),
        "newton_error": error,
    }


if __name__ == "__main__":
    main()
