"""Palletisers keep a load level by two parallelograms each: what the rods carry, and one load on two of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.view.figure_style import DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"
TURN = hf.Pose.from_rpy(0, 0, np.pi / 2).R  # a frame whose x axis is that of the pins, y
ALONG_Z, ALONG_X, BESIDE = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), 0.2  # the bars at q = 0, and the rods' distance [m]
# per bar: on what it stands, where, along what, and its mass [kg]
BARS: dict[str, tuple[Any, ...]] = {
    "column": (None, (0, 0, 0), (0, 0, 0.5), 60.0),
    "upper": ("column", (0, 0, 0.5), ALONG_Z, 25.0),
    "knee": ("upper", ALONG_Z, (0, 0, BESIDE), 3.0),
    "fore": ("knee", (0, 0, 0), ALONG_X, 15.0),
    "hand": ("fore", ALONG_X, (0, 0, -BESIDE), 5.0),
    "lower rod": ("column", (-BESIDE, 0, 0.5), ALONG_Z, 4.0),
    "upper rod": ("knee", (0, 0, BESIDE), ALONG_X, 4.0),
    "plate": ("hand", (0, 0, -BESIDE), (0, 0, 0), 1.0),
}
POSTURE = np.array([0.0, 0.3, -0.3, 0.2, -0.2, 0.3, 0.2, 0.0])  # [rad]


def palletiser(base: hf.Pose) -> hf.Arm:
    """Return an arm that turns on its column; knee and hand stay level, and a plate turns below the hand."""
    joints, links, loops = [], [], {}
    for name, (_, at, along, mass) in BARS.items():
        way, axis = np.array(along), (0, 0, 1) if name in ("column", "plate") else (0, 1, 0)
        inertia = mass / 12 * (way @ way * np.eye(3) - np.outer(way, way)) + 1e-2 * np.eye(3)
        placement, motor = hf.Pose.translation(*at), name in ("column", "upper", "fore")
        joints += [hf.Joint("revolute", axis, placement, name, actuated=motor)]
        links += [hf.Link(mass, way / 2, inertia, name)]
    for rod, end, at in (("lower rod", "knee", (-BESIDE, 0, 0)), ("upper rod", "hand", (0, 0, BESIDE))):
        loops[rod] = hf.Closure(rod, end, hf.Grasp("hinge", hf.Pose(TURN, at)), hf.Pose(TURN, BARS[rod][2]))
    return hf.Arm(joints, links, base=base, parents=[on for on, *_ in BARS.values()], loops=loops)


def carried(count: int, offset: float = 0.0) -> tuple[hf.ClosedChain, hf.State]:
    """Return palletisers that face each other with a load in the middle, whose mass centre is off by x = offset."""
    first = palletiser(hf.Pose.identity())
    middle = hf.dynamics.link_poses(first, POSTURE)[-1] @ hf.Pose.translation(0.4, 0, -0.15)
    second = palletiser(hf.Pose.from_rpy(0, 0, np.pi, xyz=(2 * middle.p[0], 0, 0)))
    arms = dict([("near", first), ("far", second)][:count])
    plates = {name: hf.dynamics.link_poses(arm, POSTURE)[-1] for name, arm in arms.items()}
    grasps = {(name, "plate"): hf.Grasp("rigid", middle.inverse() @ at) for name, at in plates.items()}
    chain = hf.ClosedChain(arms, hf.HeldObject(40.0, np.diag([1.0, 2.5, 2.5]), (offset, 0, 0)), grasps)
    return chain, hf.State(np.tile(POSTURE, count), np.zeros(8 * count), middle)


def draw(axes: Any, chain: hf.ClosedChain, state: hf.State, width: float) -> None:
    """Draw bars, knees, hands and the load from the side."""
    lines = [*((bar, row[2]) for bar, row in BARS.items()), ("knee", (-BESIDE, 0, 0)), ("hand", (0, 0, BESIDE))]
    for k, (name, arm) in enumerate(chain.arms.items()):
        bodies = dict(zip(BARS, hf.dynamics.link_poses(arm, state.q[chain.joints[name]]), strict=True))
        for body, end in lines:
            x, _, z = bodies[body].p[:, None] + bodies[body].R @ np.array([(0.0, 0.0, 0.0), end]).T
            axes.plot(x, z, color=arm_style(k)[0], linewidth=width)
    x, z = state.object_frame.p[[0, 2], None] + np.array([[-3, 3, 3, -3, -3], [-1, -1, 1, 1, -1]]) * 0.15
    axes.plot(x, z, color="0.5", linewidth=width)


def main(out: Path = OUT) -> dict[str, float]:
    """Return how holding torques depend on the place of the load, its tilt while two lift it, and energies."""
    out.mkdir(parents=True, exist_ok=True)
    held = [hf.holding_torques(*carried(1, offset)) for offset in (0.0, 0.3)]
    print("one, load in the middle and 0.3 m further out:", *(np.round(tau[[0, 1, 3]], 3) + 0.0 for tau in held))
    chain, state = carried(2)
    found: Any = hf.diagnose(chain, state)
    print(f"two: rank {found.rank} of {found.rows}, mobility {found.mobility}: {found.parts[0].words}")
    torque, driven = hf.holding_torques(chain, state), np.array([joint.actuated for joint in chain.all_joints])
    still = float(np.abs(hf.forward_dynamics(chain, state, torque).qdd).max())

    def lift(t: float, now: hf.State, memory: Any) -> tuple[np.ndarray, Any]:
        return 1.1 * torque - 100.0 * driven * now.qd, memory

    run = hf.simulate(chain, state, lift, 0.2, 1e-2)
    tilt = max(float(np.abs(run.state(k).object_frame.R - np.eye(3)).max()) for k in range(len(run)))
    rise, gained = float(np.ptp(run.object_pose[[0, -1], 6])), np.ptp((run.kinetic + run.potential)[[0, -1]])
    print(f"lifted by {rise:.4f} m, tilted by {tilt:.0e}; work {run.work[-1].sum():.3f} J, gained {gained:.3f} J")
    with rc_context(STYLE):
        figure = Figure(figsize=(6, 2.6), layout="constrained")
        axes = figure.subplots()
        for sample, width in ((0, 0.6), (-1, 1.6)):
            draw(axes, chain, run.state(sample), width)
        axes.set(xlabel="[m]", ylabel="[m]", aspect="equal")
        figure.savefig(out / "20_palletisers.png", dpi=DPI)
    return {"offset": float(np.abs(held[1] - held[0]).max()), "still": still, "tilt": tilt,
            "rise": rise, "energy_error": float(np.abs(run.imbalance).max())}  # fmt: skip


if __name__ == "__main__":
    main()
