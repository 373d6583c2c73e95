"""A UR5e with a Robotiq 2F-85, two four-bars with one motor, pinches a plank that a second UR5e has by its end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.view.figure_style import DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"
# In the plane (y, z) of one finger, after ros-industrial's description [m]: the pins of driver and knuckle on the palm,
# the rods from there to the finger, the middle of the pad on the finger.
DRIVER, KNUCKLE, ROD, PAD = (0.0306, 0.0549), (0.0127, 0.0614), (0.0376, 0.0430), (-0.0252, 0.0324)
LENGTH, WIDTH = float(np.hypot(*ROD)), 0.06  # of the rods, of the plank [m]
LEAN = float(np.arccos((WIDTH / 2 - DRIVER[0] - PAD[0]) / LENGTH))  # of the rods, on the plank
PLANE = hf.Pose.identity().R  # a frame whose x axis is that of the pins
MOTOR, PUSH, DURATION, STEP = 5.0, 40.0, 0.15, 1e-2  # [N m], [N], [s]


def with_gripper(arm: hf.Arm) -> hf.Arm:
    """Return an arm with the gripper on its flange; positive angles of the drivers close it."""
    hand, joints, links, loops, frames = arm.joint_count - 1, [*arm.joints], [*arm.links], {}, {}
    parents: list[int | str | None] = [None, *range(hand)]
    for side, s in (("left", 1.0), ("right", -1.0)):
        for part, mass, (y, z) in (("driver", 0.023, DRIVER), ("knuckle", 0.022, KNUCKLE), ("finger", 0.043, ROD)):
            pin, name, first = hf.Pose.translation(0, s * y, z), f"{side}_{part}", part == "driver"
            at, motor = (pin if part == "finger" else arm.tip @ pin), name == "left_driver"
            joints += [hf.Joint("revolute", (s, 0, 0), at, name, armature=0.005 * first, actuated=motor)]
            inertia = mass * LENGTH**2 / 12 * np.diag([1.0, 0.5, 0.5])
            links += [hf.Link(mass, (0, s * ROD[0] / 2, ROD[1] / 2), inertia, name)]
        parents += [hand, hand, f"{side}_driver"]
        upper = hf.Grasp("hinge", hf.Pose(PLANE, (0, s * (KNUCKLE[0] - DRIVER[0]), KNUCKLE[1] - DRIVER[1])))
        loops[side] = hf.Closure(f"{side}_knuckle", f"{side}_finger", upper, hf.Pose(PLANE, (0, s * ROD[0], ROD[1])))
        out = hf.Pose.from_rpy(s * np.pi / 2, 0, 0, xyz=(0, s * PAD[0], PAD[1]))  # z out of the pad
        frames[f"{side}_pad"] = (f"{side}_finger", out)
    mimic = [hf.Coupling({"left_driver": 1.0, "right_driver": -1.0}, 0.0)]
    return hf.Arm(joints, links, base=arm.base, parents=parents, frames=frames, couplings=mimic, loops=loops)


def cell() -> tuple[hf.ClosedChain, hf.State]:
    """Return the two arms and the plank: pads pinch its sides, the other hand has the top of its end."""
    bare, home, angle = hf.robots.ur5e(), np.array(hf.robots.HOME["ur5e"]), LEAN - np.arctan2(ROD[1], ROD[0])
    arm, hand = with_gripper(bare), hf.dynamics.tip_pose(bare, home)
    q = np.array([*home, *[angle, angle, -angle] * 2])
    poses = hf.dynamics.link_poses(arm, q)
    left, right = (poses[link] @ at for link, at in (arm.frames["left_pad"], arm.frames["right_pad"]))
    plank = hf.Pose(hand.R, (left.p + right.p) / 2)
    end = plank @ hf.Pose.translation(0.35, 0, -0.05)
    grasps: dict[str | tuple[str, str], hf.Grasp] = {"other": hf.Grasp("rigid", plank.inverse() @ end)}
    for side, pad in (("left_pad", left), ("right_pad", right)):
        grasps["ur5e", side] = hf.Grasp("softfinger", plank.inverse() @ pad)
    arms = {"ur5e": arm, "other": hf.robots.ur5e(end @ hand.inverse())}
    chain = hf.ClosedChain(arms, hf.HeldObject.box(3.0, 0.8, WIDTH, 0.05), grasps)
    return chain, hf.State(np.append(q, home), np.zeros(18), plank)


def main(out: Path = OUT) -> dict[str, float]:
    """Return the grip's deviation from virtual work, what moves at rest, and the energies of a push."""
    out.mkdir(parents=True, exist_ok=True)
    chain, state = cell()
    found: Any = hf.diagnose(chain, state)
    print(f"rank {found.rank} of {found.rows}, mobility {found.mobility}: {found.parts[0].words}")
    held = hf.holding_torques(chain, state)
    torque = held + MOTOR * np.array([name == "ur5e/left_driver" for name in chain.joint_names()])
    before, still = (hf.forward_dynamics(chain, state, tau) for tau in (held, torque))
    added = (still.grasp_wrench - before.grasp_wrench)[:2, 3:]  # what the motor adds on each pad
    grip = added @ state.object_frame.R[:, 1]
    expected = MOTOR / (2 * LENGTH * np.sin(LEAN))  # both pads close at L sin(lean) per angle
    print(f"the motor adds {grip[1]:.3f} N of grip; by virtual work {expected:.3f} N")
    driven = np.array([joint.actuated for joint in chain.all_joints])

    def keep(t: float, now: hf.State, memory: Any) -> tuple[np.ndarray, Any]:
        return torque - 2.0 * driven * now.qd, memory

    def push(t: float) -> hf.Inputs:
        return hf.Inputs(object_wrench=np.array([0, 0, 0, 0, 0, PUSH * np.sin(np.pi * t / DURATION) ** 2]))

    run = hf.simulate(chain, state, keep, DURATION, STEP, inputs=push)
    energy = run.kinetic + run.potential
    print(f"pushed: energy gained {energy[-1] - energy[0]:.4f} J, work {run.work[-1].sum():.4f} J")
    with rc_context(STYLE):
        figure = Figure(figsize=(3.5, 2.5), layout="constrained")
        axes = figure.subplots()
        axes.plot(run.t, run.work.sum(axis=1), "k--", label="work")
        for k, (name, x) in enumerate((("kinetic", run.kinetic), ("potential", run.potential - run.potential[0]))):
            axes.plot(run.t, x, color=arm_style(k)[0], label=f"{name} energy")
        axes.set(xlabel="time [s]", ylabel="[J]")
        axes.legend()
        figure.savefig(out / "19_robotiq.png", dpi=DPI)
    return {"deviation": float(np.abs(grip - [-expected, expected]).max()), "moved": float(np.abs(still.qdd).max()),
            "energy_error": float(np.abs(run.imbalance).max()), "kinetic": float(run.kinetic.max())}  # fmt: skip


if __name__ == "__main__":
    main()
