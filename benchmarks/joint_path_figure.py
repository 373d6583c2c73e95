"""Write what `follow` does with redundancy: docs/images/joint_path.png, and its numbers.

python benchmarks/joint_path_figure.py

Left: two iiwas turn and shift a tray. The configuration nearest to the sample before is compared with the planned one.
Right: two Pandas on a platform carry a tray 0.3 m forward.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.planning.examples import mobile, nearest_states, two_arms

import holdfast as hf
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style
from holdfast.view.figure_style import BLUE, COLUMN, ORANGE, STYLE, TRUNK_COLOUR, VERMILLION

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "joint_path.png"


def least_room(chain: hf.ClosedChain, q: Array) -> Array:
    """Return the least distance of any joint from a limit, (m,), in per cent of its range."""
    low, high = chain.position_limits.T
    return 100 * (np.minimum(q - low, high - q) / (high - low)).min(axis=1)


def main() -> None:
    """Write the figure and print the numbers of the page."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    chain, state = two_arms("iiwa14")
    path = hf.control.RestToRest(
        state.object_frame, [0.175, -0.068, 0.076], turn=[-0.907, -0.753, -0.007], duration=2.0
    )
    plan = hf.follow(chain, state, path, 2.0, 0.05)
    plainly = np.array([one.q for one in nearest_states(chain, state, path, plan.t)])
    nearest, planned = least_room(chain, plainly), least_room(chain, plan.q)
    print(f"nearest configurations: {nearest.min():.1f} % of the range; planned: {planned.min():.1f} %")

    deck, start = mobile()
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
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
