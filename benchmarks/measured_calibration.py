"""Calibration of measured robots: `python -m benchmarks.measured_calibration FOLDER`.

FOLDER has `dual_ur5e_*kg.csv` and `.json`, two UR5e that carry a box, in the columns that docs/measured_robots.md
describes. No file of that set is part of this repository.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import holdfast as hf
from holdfast.calibration import FrameMeasurement, Postures
from holdfast.robots import ur5e

TOOL, SHIFTED = [0.0, 0.0, 0.16], [0.0, -0.057, -0.10]  # guesses: tool on the flange, marker offset in base axes [m]
HELD = 20.0  # [N] normal force of both arms from which the box counts as held
LIFTED = 0.01  # [m] above the lowest
OFF_THE_TABLE = 0.05  # m above the lowest tool position; lower, the box was seen to stand on the table
STEP = 5  # every fifth sample, 10 Hz
G = 9.81


def table(path: Path) -> dict[str, Any]:
    """Return the columns of a CSV file."""
    with path.open() as file:
        head, *rows = csv.reader(file)
    return dict(zip(head, np.array(rows, float).T, strict=True))


def columns(run: dict[str, Any], *names: str) -> Any:
    """Return some columns side by side."""
    return np.column_stack([run[name] for name in names])


def joints(run: dict[str, Any], side: str) -> Any:
    """Return the joint positions of one arm."""
    return columns(run, *(f"q_{side}{k}" for k in range(1, 7)))


def tool_poses(run: dict[str, Any], side: str) -> Any:
    """Return the tool poses that the robot reported, (samples, 7) wxyz_xyz."""
    turns = Rotation.from_rotvec(columns(run, *(f"rvec_{side}_{axis}" for axis in "xyz")))
    return np.column_stack([turns.as_quat()[:, [3, 0, 1, 2]], columns(run, *(f"tcp_{side}_{axis}" for axis in "xyz"))])


def tools(name: str, run: dict[str, Any]) -> dict[str, hf.Pose]:
    """Print how well the model meets the reported tool positions, and return the fitted tools by arm."""
    found = {}
    for side in "LR":
        chain = hf.ClosedChain({"arm": ur5e(hf.Pose.from_rpy(0, 0, np.pi))}, hf.HeldObject.box(1, 1, 1, 1), {})
        poses = tool_poses(run, side)
        seen = FrameMeasurement("arm", poses[:, 4:], hf.Pose.translation(*TOOL), hf.Pose.translation(*SHIFTED))
        first, second = (
            hf.calibrate(chain, Postures(joints(run, side), measured={"tool": seen}).part(part), ["markers", "sensors"])
            for part in (slice(None), slice(None, len(poses) // 2))
        )
        later = second.errors_of(
            Postures(joints(run, side), measured={"tool": seen}).part(slice(len(poses) // 2, None))
        )
        found[side] = first.markers["tool"]
        print(
            f"{name} {side}: tool positions {1e3 * first.errors['tool'][1]:.3f} mm rms;"
            f" fitted on the first half, second half {1e3 * later['tool'][1]:.3f} mm rms"
        )
    return found


def held(run: dict[str, Any]) -> Any:
    """Return which samples to use: those in which both arms press on the lifted box."""
    pressed = np.minimum(run["normal_force_L"], run["normal_force_R"]) > HELD
    chosen = np.flatnonzero(pressed & (run["tcp_L_z"] > run["tcp_L_z"].min() + LIFTED))
    return chosen[::STEP]


def cell(run: dict[str, Any], settings: dict[str, Any], tool: dict[str, hf.Pose], k: int) -> hf.ClosedChain:
    """Return a model of the two arms: bases as the authors' grasp points say, grasps that are closed in sample k."""
    half = hf.Pose.from_rpy(0, 0, np.pi)
    left, right = (np.array(settings[f"grasping_point_{side}_world"]) for side in "LR")
    base_left = left - settings["grasping_point_L_base"]
    base_right = right - half.R @ np.array(settings["grasping_point_R_base"])
    bases = {"L": hf.Pose.translation(*base_left), "R": hf.Pose(half.R, base_right)}
    arms = {side: ur5e(base @ half, tool[side]) for side, base in bases.items()}
    tips = {side: hf.dynamics.tip_pose(arms[side], joints(run, side)[k]) for side in "LR"}
    middle = hf.Pose(np.eye(3), 0.5 * (tips["L"].p + tips["R"].p))
    grasps = {side: hf.Grasp("rigid", middle.inverse() @ tip) for side, tip in tips.items()}
    return hf.ClosedChain(arms, hf.HeldObject.box(2.4, 0.2, 0.2, 0.2), grasps)


def closure(runs: dict[str, dict[str, Any]], settings: dict[str, Any], tool: dict[str, hf.Pose]) -> None:
    """Print base-to-base and grasp frames from closure alone, run by run and together."""
    first = next(iter(runs))
    chosen = {name: held(run) for name, run in runs.items()}
    chain = cell(runs[first], settings, tool, int(chosen[first][0]))
    q = {name: np.hstack([joints(runs[name], side)[chosen[name]] for side in "LR"]) for name in runs}
    for name in runs:
        others = [q[other] for other in q if other != name]
        found = hf.calibrate(chain, q[name], held_out=np.vstack(others) if others else None)
        print(f"\n{name}: base and grasp of R from closure alone, {len(q[name])} postures")
        print(found)
        free = hf.calibrate(chain, q[name], largest_deviation=1.0)
        turned, placed = (", ".join(f"{x:+.3f}" for x in part) for part in (free.values[:3], free.values[3:6]))
        left = ", ".join(f"{1e3 * shift:.1f} mm, {1e3 * turn:.0f} mrad" for turn, shift in free.errors.values())
        print(f"all twelve, whatever the deviation: base turn {turned} rad, shift {placed} m; open {left}")


def forces(runs: dict[str, dict[str, Any]]) -> None:
    """Print the difference of the masses, from an offset and a scale of the summed forces on the first halves.

    What each arm carries is not known, so the two sensors have one scale and the sum of their offsets in common.
    Samples in which the box may stand on the table are left out. Horizontal forces of the arms must cancel, so that
    what is left of them shows how large the errors of the forces are.
    """
    rows, halves = {}, {}
    for name, run in runs.items():
        k = held(run)
        k = k[run["tcp_L_z"][k] > run["tcp_L_z"].min() + OFF_THE_TABLE]
        across = np.hypot(*(columns(run, "force_L_x", "force_L_y") - columns(run, "force_R_x", "force_R_y"))[k].T)
        print(f"\n{name}: {len(k)} samples off the table; horizontal forces that should cancel: {across.mean():.1f} N")
        rows[name] = np.column_stack([run["force_L_z"][k], run["force_R_z"][k]])
        halves[name] = len(k) // 2
    mass = {name: float(name.removeprefix("dual_ur5e_").removesuffix("kg")) for name in runs}
    summed = {name: rows[name][:, :2].sum(axis=1) for name in runs}
    first = np.array([summed[name][: halves[name]].mean() for name in runs])
    weights = np.array([-G * mass[name] for name in runs])
    scale = np.polyfit(weights, first, 1)[0] if len(runs) > 1 else 1.0
    for title, s in (("offset and scale", scale), ("offset alone", 1.0)):
        offset = float(np.mean(first - s * weights))
        later = {name: (summed[name][halves[name] :] - offset) / (-G * s) for name in runs}
        said = ", ".join(f"{mass[name]} kg -> {x.mean():.2f} (in a run +- {x.std():.2f})" for name, x in later.items())
        print(f"second halves by {title} of the first ({offset:+.1f} N, {s:.3f}): {said}")
        if len(runs) == 2:
            a, b = runs
            print(f"  difference {later[b].mean() - later[a].mean():.2f} of {mass[b] - mass[a]:.2f} kg")


def main(folder: Path) -> None:
    """Print all tables."""
    runs = {path.stem: table(path) for path in sorted(folder.glob("dual_ur5e_*kg.csv"))}
    if not runs:
        raise SystemExit(f"{folder}: expected dual_ur5e_*kg.csv; docs/measured_robots.md says where to get them")
    tool = {}
    for name, run in runs.items():
        tool = tools(name, run)
    settings = json.loads((folder / f"{next(iter(runs))}.json").read_text())
    closure(runs, settings, tool)
    forces(runs)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
