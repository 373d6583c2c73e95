"""Two free-flying robots bend round a beam that both have in their grippers: all momentum stays what it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.integrate import simpson

import holdfast as hf
from holdfast.dynamics import forest_balance, forest_close, forest_diagnose, forest_simulate
from holdfast.model.forest import BodyJoint, Forest, ForestBody, JointCoupling
from holdfast.view.figure_style import DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"
ARM, HOME = hf.robots.ur5e(), np.array([0.0, -1.2, 1.6, -1.97, -1.571, 0.0])  # rad
HALF, WIDTH, GRIP, DURATION, STEP = 1.0, 0.06, 40.0, 0.5, 2e-2  # of the beam [m], of a finger [N], [s]
COUNT = ARM.joint_count + 3  # bodies of a robot: hull, arm, two fingers


def robot(first: int) -> list[ForestBody]:
    """Return a hull in space, an arm on it and two fingers on its flange; the hull has the index `first`."""
    hull = hf.Link(80.0, (0, 0, -0.3), np.diag([6.0, 6.0, 5.0]), "hull")
    bodies = [ForestBody(hull, BodyJoint("free"))]
    for k, (joint, link) in enumerate(zip(ARM.joints, ARM.links, strict=True)):
        bodies += [ForestBody(link, BodyJoint("revolute", joint.placement, joint.axis, armature=0.4), first + k)]
    for side in (1.0, -1.0):
        slide = BodyJoint("prismatic", ARM.tip @ hf.Pose.translation(0, 0, 0.1), (0, side, 0), armature=1.0)
        bodies += [ForestBody(hf.Link(0.2, (0, 0, 0), 1e-4 * np.eye(3), "finger"), slide, first + COUNT - 3)]
    return bodies


def flyers() -> tuple[Forest, np.ndarray]:
    """Return the robots, each with two fingers at its end of the beam, and the positions; half a turn maps both."""
    own, near, q = Forest(robot(0)), hf.Pose.identity(), np.array([*HOME, WIDTH / 2, WIDTH / 2])
    fingers = own.poses(np.concatenate([near.wxyz_xyz, q]))[-2:]
    beam = hf.Pose(fingers[0].R, (fingers[0].p + fingers[1].p) / 2) @ hf.Pose.translation(HALF, 0, 0)
    far = beam @ hf.Pose.from_rpy(0, 0, np.pi) @ beam.inverse()
    held, closures = hf.Link(12.0, (0, 0, 0), np.diag([0.02, 4.0, 4.0]), "beam"), list[hf.Closure]()
    bodies = [*robot(0), *robot(COUNT), ForestBody(held, BodyJoint("free"))]
    for first, hull in ((0, near), (COUNT, far)):
        for k in (0, 1):
            held_at = hf.Grasp("ball" if k else "rigid", beam.inverse() @ hull @ fingers[k])
            closures += [hf.Closure(first + COUNT - 2 + k, 2 * COUNT, held_at, name=f"finger {len(closures) + 1}")]
    mimic = [JointCoupling([(last - 1, 0, 1.0), (last, 0, -1.0)], 0.0) for last in (COUNT - 1, 2 * COUNT - 1)]
    places = [*near.wxyz_xyz, *q, *far.wxyz_xyz, *q, *beam.wxyz_xyz]
    return Forest(bodies, closures, mimic, np.zeros(3)), np.array(places)


def bend(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """Return torques that turn both shoulders by 0.6 rad, and close the grippers; nothing acts from outside."""
    tau, n = np.zeros(len(qd)), ARM.joint_count
    goal = HOME + np.array([0.3 * (1 - np.cos(np.pi * t / DURATION)), 0, 0, 0, 0, 0])
    for k in (0, 1):
        at, rate = 7 + k * (COUNT + 6), 6 + k * (COUNT + 5)
        tau[rate : rate + n] = 100.0 * (goal - q[at : at + n]) - 20.0 * qd[rate : rate + n]
        tau[rate + n] = -GRIP
    return tau


def draw(axes: Axes, forest: Forest, q: np.ndarray, width: float) -> None:
    """Draw hulls, arms and beam as seen from above."""
    poses, square = forest.poses(q), 0.25 * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1], [0] * 5])
    for k in (0, 1):
        own = poses[k * COUNT : (k + 1) * COUNT]
        for x in (own[0].p[:, None] + own[0].R @ square, np.array([pose.p for pose in own]).T):
            axes.plot(*x[:2], color=arm_style(k)[0], linewidth=width)
    x = poses[-1].p[:, None] + poses[-1].R @ [[-HALF, HALF], [0, 0], [0, 0]]
    axes.plot(*x[:2], color="0.4", linewidth=2 * width)


def main(out: Path = OUT) -> dict[str, float]:
    """Return by how much momentum changes, the work of the drives, and the kinetic energy gained."""
    out.mkdir(parents=True, exist_ok=True)
    forest, q = flyers()
    print(forest_diagnose(forest, q).report())
    rates = np.concatenate([np.zeros(2 * (COUNT + 5)), [0.1, 0.05, 0.2, 0.05, 0, -0.02]])  # the beam tumbles
    start = forest_close(forest, q, rates)
    run = forest_simulate(forest, start.q, start.qd, bend, duration=DURATION, step=STEP)
    states = [forest_balance(forest, q, qd, bend(t, q, qd)) for t, q, qd in zip(run.t, run.q, run.qd, strict=True)]
    momentum, powers = np.array([state.momentum for state in states]), [state.power.total for state in states]
    for name, p in (("start", momentum[0]), ("end", momentum[-1])):
        print(f"momentum at the {name}:", np.round(p[3:], 4) + 0.0, "N s, angular:", np.round(p[:3], 4) + 0.0, "N m s")
    work, gained = float(simpson(powers, x=run.t)), states[-1].kinetic_energy - states[0].kinetic_energy
    print(f"work of the drives {work:.5f} J, kinetic energy gained {gained:.5f} J")
    with rc_context(STYLE):
        figure = Figure(figsize=(4, 4), layout="constrained")
        axes = figure.subplots()
        for sample, width in ((0, 0.6), (-1, 1.6)):
            draw(axes, forest, run.q[sample], width)
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        figure.savefig(out / "22_two_free_flyers.png", dpi=DPI)
    return {"momentum_error": float(np.abs(momentum - momentum[0]).max()), "work": work, "gained": gained}


if __name__ == "__main__":
    main()
