"""Two arms hold a box in an unstable equilibrium; a regulator from the exact linearisation stabilises it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.linalg import solve_continuous_are

import holdfast as hf
from holdfast.robots import HOME, panda
from holdfast.view.figure_style import BLUE, DANGER, DPI, STYLE

OUT = Path(__file__).parent / "out"
STEP, DURATION = 0.01, 1.0  # s
PUSH = 1e-3  # of the state, in the units of its coordinates


def balanced() -> tuple[hf.ClosedChain, hf.State]:
    """Return two Pandas that hold a box, at rest."""
    box = hf.HeldObject.box(mass=3.0, x=0.4, y=0.3, z=0.2)
    arms = {"left": panda().at(hf.Pose.translation(0, 0.35, 0)), "right": panda().at(hf.Pose.translation(0, -0.35, 0))}
    grasps = {
        "left": hf.Grasp("rigid", hf.contact_frame([0, 0.15, 0], into=[0, -1, 0])),
        "right": hf.Grasp("rigid", hf.contact_frame([0, -0.15, 0], into=[0, 1, 0])),
    }
    chain, state = hf.assemble(arms, box, grasps, q=dict.fromkeys(arms, HOME["panda"]))
    return chain, state


def main(out: Path = OUT) -> dict[str, float]:
    """Return the numbers that this example prints."""
    chain, still = balanced()
    torques = hf.holding_torques(chain, still)

    # Sixteen coordinates: eight freedoms of the closed chain, and their rates.
    model = hf.linearise(chain, still, torques)
    freedoms = len(model.A) // 2
    Q, R = np.diag(np.repeat([30.0, 1.0], freedoms)), np.eye(chain.joint_count)
    gain = np.linalg.solve(R, model.B.T @ solve_continuous_are(model.A, model.B, Q, R))
    falling = np.linalg.eigvals(model.A).real.max()
    held = np.linalg.eigvals(model.A - model.B @ gain).real.max()

    # A little off, along every freedom; projected, because the grasps hold exactly.
    off = model.basis @ np.full(len(model.A), PUSH)
    n = chain.joint_count
    turned = hf.Pose.from_rpy(*off[n : n + 3]).R @ still.object_frame.R
    pose = hf.Pose(turned, still.object_frame.p + off[n + 3 : n + 6])
    moved = hf.State(still.q + off[:n], off[n + 6 : 2 * n + 6], pose, off[2 * n + 6 :])
    begin = hf.project(chain, moved)[0]

    def regulator(t: float, state: hf.State, memory: None) -> tuple[np.ndarray, None]:
        return torques - gain @ model.coordinates(state), memory

    def constant(t: float, state: hf.State, memory: None) -> tuple[np.ndarray, None]:
        return torques, memory

    runs = [hf.simulate(chain, begin, law, DURATION, STEP) for law in (constant, regulator)]
    sizes = [np.array([np.linalg.norm(model.coordinates(run.state(k))) for k in range(len(run.t))]) for run in runs]
    draw(out, runs[0].t, sizes)
    print(f"fastest growth {falling:+.2f} 1/s without control, {held:+.2f} 1/s with it")
    print(f"off by {sizes[0][0]:.4f} at first; after {DURATION} s {sizes[0][-1]:.4f} without, {sizes[1][-1]:.4f} with")
    return {
        "falling": float(falling),
        "held": float(held),
        "start": float(sizes[0][0]),
        "without": float(sizes[0][-1]),
        "regulated": float(sizes[1][-1]),
    }


def draw(out: Path, t: np.ndarray, sizes: list[np.ndarray]) -> None:
    """Draw how far off both runs are."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 2.8), layout="constrained")
        axes = figure.subplots()
        names = ("torques that hold it", "and the regulator")
        for size, colour, name in zip(sizes, (DANGER, BLUE), names, strict=True):
            axes.semilogy(t[: len(size)], size, color=colour, label=name)
        axes.set_xlabel("time [s]")
        axes.set_ylabel("distance from rest")
        axes.legend(frameon=False)
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "11_balance.png", dpi=DPI)


if __name__ == "__main__":
    main()
