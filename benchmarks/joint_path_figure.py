"""Write what `follow` does with redundancy: docs/images/joint_path.png, and its numbers.

python benchmarks/joint_path_figure.py

Left: two iiwas turn and shift a tray. The configuration nearest to the sample before is compared with the planned one.
Right: two Pandas on a platform carry a tray 0.3 m forward.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import holdfast as hf
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style
from holdfast.view.figure_style import BLUE, COLUMN, ORANGE, STYLE, TRUNK_COLOUR, VERMILLION

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "joint_path.png"
TRAY = hf.HeldObject.box(4.0, 0.3, 0.5, 0.1)
GRASPS = {
    name: hf.Grasp("rigid", hf.contact_frame([0, y, 0.05], into=[0, 0, -1]))
    for name, y in (("left", 0.2), ("right", -0.2))
}


def two_iiwas() -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms in the world that hold the tray."""
    arms = {name: hf.robots.iiwa14(hf.Pose.translation(0, y, 0)) for name, y in (("left", 0.3), ("right", -0.3))}
    chain, state = hf.assemble(arms, TRAY, GRASPS, object_pose=hf.Pose.translation(0.5, 0, 0.35))
    return chain, state


def mobile_manipulator() -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms on a platform that drives and turns, in their cheapest posture."""
    axes = [
        hf.Joint("prismatic", axis=[1, 0, 0], name="x"),
        hf.Joint("prismatic", axis=[0, 1, 0], name="y"),
        hf.Joint("revolute", name="yaw"),
    ]
    frame, body = hf.Link(1.0, inertia=0.01 * np.eye(3)), hf.Link(60.0, inertia=np.diag([2.0, 2.0, 3.0]), name="deck")
    arms = {name: hf.robots.panda(hf.Pose.translation(0, y, 0.4)) for name, y in (("left", 0.3), ("right", -0.3))}
    chain, state = hf.assemble(
        arms,
        TRAY,
        GRASPS,
        object_pose=hf.Pose.translation(0.5, 0, 0.8),
        trunk=hf.Trunk(axes, [frame, frame, body]),
        mounts={"left": "deck", "right": "deck"},
        posture=hf.dynamics.Posture(),
    )
    return chain, state


def nearest_configurations(chain: hf.ClosedChain, state: hf.State, path: hf.control.RestToRest, t: Array) -> Array:
    """Return the joint positions (m, n) nearest to the sample before, whatever the limits."""
    found = [state.q]
    for time in t[1:]:
        guess = hf.State(found[-1], 0 * state.q, path.at(float(time)).pose)
        found.append(hf.close(chain, guess, hold_object=True, limits=False).q)
    return np.array(found)


def least_room(chain: hf.ClosedChain, q: Array) -> Array:
    """Return the least distance of any joint from a limit, (m,), in per cent of its range."""
    low, high = chain.position_limits.T
    return 100 * (np.minimum(q - low, high - q) / (high - low)).min(axis=1)


def main() -> None:
    """Write the figure and print the numbers of the page."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    chain, state = two_iiwas()
    path = hf.control.RestToRest(
        state.object_frame, [0.175, -0.068, 0.076], turn=[-0.907, -0.753, -0.007], duration=2.0
    )
    plan = hf.follow(chain, state, path, 2.0, 0.05)
    nearest, planned = least_room(chain, nearest_configurations(chain, state, path, plan.t)), least_room(chain, plan.q)
    print(f"nearest configurations: {nearest.min():.1f} % of the range; planned: {planned.min():.1f} %")

    deck, start = mobile_manipulator()
    forward = hf.control.RestToRest(start.object_frame, [0.3, 0.0, 0.0], duration=3.0)
    drive = hf.follow(deck, start, forward, 3.0, 0.05)
    base = 1e3 * (drive.q[:, 0] - drive.q[0, 0])
    tray = np.array([1e3 * (forward.at(float(t)).pose.p[0] - start.object_pose[4]) for t in drive.t])
    elbows = -np.degrees(drive.q[:, [deck.joint_names().index(f"{name}/joint4") for name in deck.arms]].max(axis=1))
    print(f"platform {base[-1]:.0f} of {tray[-1]:.0f} mm, elbows bent by at least {elbows.min():.0f} degrees")
    print(drive)

    with plt.rc_context(STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(2 * COLUMN, 2.3), layout="constrained")
        left.axhspan(min(nearest.min(), 0) - 1, 0, color=VERMILLION, alpha=0.12, linewidth=0)
        left.plot(plan.t, nearest, color=ORANGE, linestyle="--", label="nearest to the sample before")
        left.plot(plan.t, planned, color=BLUE, label="hf.follow")
        left.set(xlabel="time [s]", ylabel="least room [% of range]", ylim=(nearest.min() - 1, None))
        left.set_title("Two arms turn a tray: distance from the joint limits")
        left.legend(loc="lower left")
        right.plot(drive.t, tray, color=BLUE, label="tray")
        right.plot(drive.t, base, color=TRUNK_COLOUR, linestyle="--", label="platform")
        right.set(xlabel="time [s]", ylabel="way [mm]")
        right.set_title("Two arms on a platform carry it forward")
        right.legend(loc="upper left")
        figure.savefig(PICTURE, dpi=figure_style.DPI)


if __name__ == "__main__":
    main()
