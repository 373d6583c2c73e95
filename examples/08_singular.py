"""A parallelogram linkage folds flat: solved up to that point, refused there, with an explanation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.view.figure_style import BLUE, DANGER, DPI, STYLE

OUT = Path(__file__).parent / "out"
CRANK, APART = 0.3, 0.5  # m
DOWN = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0.0]])  # columns: axes of a frame whose x lies along the world's y


def linkage() -> hf.ClosedChain:
    """Return two cranks that turn about y in a vertical plane, and a bar hinged to both of their ends."""
    axle = hf.Joint("revolute", [0, 1, 0], name="axle")
    rod = hf.Link(1.0, [CRANK / 2, 0, 0], np.diag([0, 1, 1]) * CRANK**2 / 12)
    crank = hf.Arm([axle], [rod], tip=hf.Pose(DOWN, [CRANK, 0, 0]))
    arms = {"left": crank, "right": crank.at(hf.Pose.translation(APART, 0, 0))}
    grasps = {
        "left": hf.Grasp("hinge", hf.Pose(DOWN, [-APART / 2, 0, 0])),
        "right": hf.Grasp("hinge", hf.Pose(DOWN, [APART / 2, 0, 0])),
    }
    return hf.ClosedChain(arms, hf.HeldObject.box(mass=2.0, x=APART, y=0.05, z=0.05), grasps)


def at(angle: float) -> hf.State:
    """Return the state with both cranks at an angle above the horizontal, at rest."""
    end = [CRANK * np.cos(angle) + APART / 2, 0, CRANK * np.sin(angle)]
    return hf.State([-angle, -angle], [0, 0], [1, 0, 0, 0, *end])


def main(out: Path = OUT) -> dict[str, object]:
    """Return the numbers that this example prints."""
    chain = linkage()
    angles = np.geomspace(1.0, 1e-4, 9)
    found = [hf.forward_dynamics(chain, at(angle), np.zeros(2)) for angle in angles]
    told = [hf.diagnose(chain, at(angle)) for angle in angles]
    conditions = np.array([one.condition for one in told])

    # What it must be: one crank angle, energy m g CRANK sin(angle) (bar) and two times half of it (cranks of 1 kg).
    inertia = 2.0 * CRANK**2 + 2 * (1.0 * CRANK**2 / 3)
    expected = 9.81 * CRANK * np.cos(angles) * (2.0 + 2 * 0.5) / inertia
    error = float(np.abs([result.qdd[0] for result in found] - expected).max())

    # Flat, it could go on as a parallelogram or as a crossed linkage. No number would be both.
    try:
        hf.forward_dynamics(chain, at(0.0), np.zeros(2))
        refusal = ""
    except hf.errors.SingularChainError as refused:
        refusal = str(refused)

    draw(out, np.rad2deg(angles), conditions)
    flat = hf.diagnose(chain, at(0.0))
    print(f"at 1 rad, {told[0].report().splitlines()[0]}")
    print(f"down to 1e-4 rad the angular accelerations are right to {error:.1e} rad/s^2")
    print(f"flat: {refusal}")
    print(*flat.report().splitlines()[:2], sep="\n")
    return {
        "error": error,
        "refusal": refusal,
        "flat": flat.status,
        "status": found[0].status.name,
        "growth": float(np.log(conditions[-1] / conditions[-3]) / np.log(angles[-3] / angles[-1])),
    }


def draw(out: Path, angles: np.ndarray, conditions: np.ndarray) -> None:
    """Draw the condition number over the angle."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 2.8), layout="constrained")
        axes = figure.subplots()
        axes.loglog(angles, conditions, "o-", color=BLUE, markersize=3)
        axes.text(0.75, 0.93, "flat: refused", transform=axes.transAxes, ha="right", color=DANGER)
        axes.invert_xaxis()
        axes.set(xlabel="angle of the cranks above flat [degrees]", ylabel="condition number [1]")
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "08_singular.png", dpi=DPI)


if __name__ == "__main__":
    main()
