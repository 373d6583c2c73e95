"""A gripper with two four-bars and one drive pinches a box that another arm holds: how hard, over its opening."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.view.figure_style import DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"
LENGTH, PIVOT, ACROSS, PAD = 0.055, 0.03, 0.018, 0.01  # crank, its place beside the middle, parallelogram, pad [m]
PLANE = hf.Pose.identity().R  # a frame whose x axis is that of the pins
DRIVE = 1.0  # N m
LEFT, RIGHT = ("left", 1.0), ("right", -1.0)


def pin(name: str, y: float, z: float, side: float) -> hf.Joint:
    """Return a hinge across the gripper; a positive angle opens."""
    return hf.Joint("revolute", (-side, 0, 0), hf.Pose.translation(0, y, z), name)


def rod(name: str, mass: float) -> hf.Link:
    """Return a rod along z."""
    return hf.Link(mass, (0, 0, LENGTH / 2), mass * LENGTH**2 / 12 * np.diag([1.0, 1.0, 0.1]), name)


def with_gripper(arm: hf.Arm) -> hf.Arm:
    """Return an arm with two fingers, each on a crank and a parallel rod; one drive moves both cranks."""
    hand = arm.joint_count - 1
    joints, links, loops, frames = [*arm.joints], [*arm.links], {}, {}
    parents: list[int | str | None] = [None, *range(hand)]
    for name, side in (LEFT, RIGHT):
        joints += [pin(f"{name}_crank", side * PIVOT, 0.12, side), pin(f"{name}_finger", 0, LENGTH, side)]
        joints += [pin(f"{name}_rod", side * (PIVOT - ACROSS), 0.12, side)]
        links += [rod(f"{name}_crank", 0.05), rod(f"{name}_finger", 0.04), rod(f"{name}_rod", 0.03)]
        parents += [hand, f"{name}_crank", hand]
        on_finger = hf.Grasp("hinge", hf.Pose(PLANE, (0, -side * ACROSS, 0)))
        loops[name] = hf.Closure(f"{name}_rod", f"{name}_finger", on_finger, hf.Pose(PLANE, (0, 0, LENGTH)))
        frames[f"{name}_pad"] = (f"{name}_finger", hf.Pose.translation(0, -side * PAD, 0.04))
    mimic = [hf.Coupling({"left_crank": 1.0, "right_crank": -1.0})]
    return hf.Arm(joints, links, base=arm.base, parents=parents, frames=frames, couplings=mimic, loops=loops)


def pinched(angle: float) -> tuple[hf.ClosedChain, hf.State]:
    """Return the gripper at an opening with a box of that width between its pads, which a second arm holds, too."""
    arm, other = with_gripper(hf.robots.ur5e()), hf.robots.ur5e(hf.Pose.from_rpy(0, 0, np.pi, xyz=[1.0, 0.3, 0]))
    home = np.array(hf.robots.HOME["ur5e"])
    q = np.array([*home, *[angle, -angle, angle] * 2])
    poses = hf.dynamics.link_poses(arm, q)
    pads = {name: poses[link] @ at for name, (link, at) in arm.frames.items()}
    middle = (pads["left_pad"].p + pads["right_pad"].p) / 2
    box, width = hf.Pose(pads["left_pad"].R, middle), float(np.linalg.norm(pads["left_pad"].p - middle)) * 2
    grasps = {
        ("grip", "left_pad"): hf.Grasp("rigid", box.inverse() @ pads["left_pad"]),
        ("grip", "right_pad"): hf.Grasp("ball", box.inverse() @ pads["right_pad"]),
        "other": hf.Grasp("rigid", box.inverse() @ hf.dynamics.tip_pose(other, home)),
    }
    body = hf.HeldObject.box(1.0, 0.1, width, 0.1)
    chain = hf.ClosedChain({"grip": arm, "other": other}, body, grasps, gravity=np.zeros(3))
    return chain, hf.State(np.append(q, home), np.zeros(len(q) + 6), box)


def grip(angle: float) -> tuple[float, float]:
    """Return the force of a pad on the box, and the largest acceleration: without weight a grip moves nothing."""
    chain, state = pinched(angle)
    tau = np.zeros(chain.joint_count)
    tau[chain.joint_names().index("grip/left_crank")] = -DRIVE
    found = hf.forward_dynamics(chain, state, tau)
    force = state.object_frame.R.T @ found.grasp_wrench[0, 3:]  # of the first grasp, the left pad
    return -float(force[1]), float(np.abs(found.qdd).max())


def main(out: Path = OUT) -> dict[str, float]:
    """Return the largest deviation of the grip from virtual work, and the largest acceleration."""
    out.mkdir(parents=True, exist_ok=True)
    angles = np.radians([0, 10, 20, 30, 40, 50])
    forces, moved = np.array([grip(angle) for angle in angles]).T
    expected = DRIVE / (2 * LENGTH * np.cos(angles))  # both pads close at L cos(angle) per angle
    with rc_context(STYLE):
        figure = Figure(figsize=(5, 3), layout="constrained")
        axes = figure.subplots()
        axes.plot(np.degrees(angles), expected, color=arm_style(0)[0], label="virtual work")
        axes.plot(np.degrees(angles), forces, "o", color=arm_style(1)[0], label="forward dynamics")
        axes.set(xlabel="opening of the cranks [deg]", ylabel="grip per N m of the drive [N]")
        axes.legend()
        figure.savefig(out / "17_gripper.png", dpi=DPI)
    print(
        f"grip at {np.degrees(angles[0]):.0f} and {np.degrees(angles[-1]):.0f} deg: {forces[0]:.3f}, {forces[-1]:.3f} N"
    )
    return {"deviation": float(np.abs(forces - expected).max()), "moved": float(moved.max())}


if __name__ == "__main__":
    main()
