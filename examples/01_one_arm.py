"""One arm holds a box still, then its motors are switched off: the force at the hand is m (a - g), before and after."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.robots import ur5e
from holdfast.view.figure_style import BLACK, COMPONENTS, DPI, STYLE

OUT = Path(__file__).parent / "out"
OFF = 0.1  # when the drives go off [s]


def main(out: Path = OUT) -> dict[str, float]:
    """Return the numbers that this example prints."""
    # A UR5e that stands at the world's origin holds a 2 kg box by its lower face; z of the grasp points into the box.
    box = hf.HeldObject.box(mass=2.0, x=0.2, y=0.2, z=0.2)
    grasp = hf.Grasp("rigid", hf.Pose.translation(0, 0, -0.1))
    chain, state = hf.assemble({"arm": ur5e()}, box, {"arm": grasp})

    # Torques that hold it, and the force at the hand under them.
    holding = hf.holding_torques(chain, state)
    still = hf.forward_dynamics(chain, state, holding)
    weight = -box.mass * chain.gravity

    # A controller is a function (t, state, memory) -> (torques, memory). This one stops at t = OFF.
    def drives(t: float, state: hf.State, memory: None) -> tuple[np.ndarray, None]:
        return holding if t < OFF else np.zeros(6), memory

    run = hf.simulate(chain, state, drives, duration=0.4, step=0.0125, breakpoints=[OFF])
    force = run.grasp_wrench[:, 0, 3:]
    newton = box.mass * (run.object_acceleration[:, 3:] - chain.gravity)
    draw(out, run.t, force, newton)

    print(f"force at the hand, holding still: {np.round(still['arm'].grasp_wrench[3:], 3) + 0.0} N; the box weighs")
    print(f"    {weight[2]:.3f} N; the torque of the shoulder lift joint is {holding[1]:.1f} N m")
    print(f"just after the motors are switched off: {np.linalg.norm(force[run.t > OFF][0]):.2f} N")
    print(f"largest |f - m (a - g)| of the whole run: {np.abs(force - newton).max():.1e} N")
    return {
        "weight": float(weight[2]),
        "held": float(still["arm"].grasp_wrench[5]),
        "acceleration_held": float(np.abs(still.qdd).max()),
        "after": float(np.linalg.norm(force[run.t > OFF][0])),
        "newton_error": float(np.abs(force - newton).max()),
        "energy_error": float(np.abs(run.imbalance).max()),
        "energy_moved": float(run.kinetic.max()),
    }


def draw(out: Path, t: np.ndarray, force: np.ndarray, newton: np.ndarray) -> None:
    """Draw the force at the hand over time, and m (a - g) beside it."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 2.8), layout="constrained")
        axes = figure.subplots()
        for k, (name, colour, line) in enumerate(COMPONENTS):
            axes.plot(t, force[:, k], line, color=colour, label=f"f along {name}")
        marks = axes.plot(t[::2], newton[::2], "o", color=BLACK, markersize=2.5, fillstyle="none")
        marks[0].set_label("m (a - g)")
        axes.axvline(OFF, color="#888888", linewidth=0.8)
        axes.annotate("drives off", (OFF, 0.7), (4, 0), xycoords=("data", "axes fraction"), textcoords="offset points")
        axes.set(xlabel="time [s]", ylabel="force of the arm on the box [N]")
        figure.legend(loc="outside upper center", ncols=4)
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "01_one_arm.png", dpi=DPI)


if __name__ == "__main__":
    main()
