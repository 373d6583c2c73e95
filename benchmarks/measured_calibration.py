"""Calibration of measured robots: `python -m benchmarks.measured_calibration FOLDER`.

FOLDER has `dual_ur5e_2.4kg.csv` and `dual_ur5e_4.4kg.csv`, two UR5e that carry a box, in the columns that
docs/measured_robots.md describes, and a `.json` beside the first. Whatever else is there as `dual_ur5e_*kg*.csv`, the
mass in its name, is predicted: tool positions, closure and mass by what the two told. No file of that set is part of
this repository.
"""

from __future__ import annotations

import csv
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

import holdfast as hf
from holdfast.calibration import Calibration, FrameMeasurement, Postures
from holdfast.robots import ur5e

TOOL, SHIFTED = [0.0, 0.0, 0.16], [0.0, -0.057, -0.10]  # guesses: tool on the flange, marker offset in base axes [m]
HELD = 20.0  # [N] normal force of both arms from which the box counts as held
LIFTED = 0.01  # [m] above the lowest
OFF_THE_TABLE = 0.05  # m above the lowest tool position; lower, the box was seen to stand on the table
STEP = 5  # every fifth sample, 10 Hz
FEWEST = 10  # samples of a run that can be used
G = 9.81
LARGEST_GAP, LARGEST_MISS = 0.4, 5.0  # bars: tool positions [mm rms], difference of two masses [%]
FITTED = ("dual_ur5e_2.4kg", "dual_ur5e_4.4kg")
NAME = re.compile(r"dual_ur5e_(\d+(?:[.,]\d+)?) ?kg.*")
NEEDED = tuple(
    [f"q_{side}{k}" for side in "LR" for k in range(1, 7)]
    + [f"{what}_{side}_{axis}" for side in "LR" for what in ("tcp", "rvec", "force") for axis in "xyz"]
    + ["normal_force_L", "normal_force_R"]
)


def table(path: Path) -> dict[str, Any]:
    """Return the columns of a CSV file; rows that are not numbers are left out, with a remark.

    Titles count without units in brackets, spaces and capitals.
    """
    with path.open(encoding="utf-8-sig", newline="") as file:
        head, *rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)] or [[]]
    known = {name.lower(): name for name in NEEDED}
    titles = [re.sub(r"\s*[\[(].*", "", title).strip().replace(" ", "_") for title in head]
    titles = [known.get(title.lower(), title) for title in titles]
    if absent := [name for name in NEEDED if name not in titles]:
        raise ValueError(f"expected columns {', '.join(absent)}; got {', '.join(titles)}")
    at = [titles.index(name) for name in NEEDED]
    numbers = np.array([[number(row[k]) if k < len(row) else np.nan for k in at] for row in rows]).reshape(-1, len(at))
    whole = np.asarray(np.isfinite(numbers).all(axis=1))
    if not whole.any():
        raise ValueError(f"expected rows of numbers, got none in {len(rows)} rows")
    if not whole.all():
        print(f"{path.name}: {int((~whole).sum())} rows of {len(whole)} are not numbers, and are left out")
    return dict(zip(NEEDED, numbers[whole].T, strict=True))


def number(cell: str) -> float:
    """Return the number in a cell, or NaN."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def runs_of(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the runs of a folder by name, those that are fitted first; name what cannot be used, and why."""
    runs: dict[str, dict[str, Any]] = {}
    paths = sorted(folder.glob("dual_ur5e_*.csv"), key=lambda path: (path.stem not in FITTED, path.stem))
    for path in paths:
        try:
            if NAME.fullmatch(path.stem) is None:
                raise ValueError("expected a mass in the name, such as dual_ur5e_3.4kg.csv")
            run = table(path)
            if len(readings(run)) < FEWEST:
                raise ValueError(
                    f"expected {FEWEST} samples of a box that two arms lift by {OFF_THE_TABLE:g} m with {HELD:g} N,"
                    f" 1 of {STEP} counted, got {len(readings(run))}"
                )
            runs[path.stem] = run
        except (ValueError, OSError) as cause:
            print(f"{path.name} is left out: {cause}")
    return runs


def mass_of(name: str) -> float:
    """Return the mass that a run's name states [kg]."""
    stated = NAME.fullmatch(name)
    assert stated is not None
    return float(stated[1].replace(",", "."))


def fitted_of(runs: dict[str, Any]) -> list[str]:
    """Return the names of the runs that are fitted: the two, or all without them."""
    return [name for name in FITTED if name in runs] or [*runs]


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


def tool_postures(run: dict[str, Any], side: str) -> Postures:
    """Return the joint positions of one arm, with the tool positions that the robot reported."""
    seen = FrameMeasurement(
        "arm", tool_poses(run, side)[:, 4:], hf.Pose.translation(*TOOL), hf.Pose.translation(*SHIFTED)
    )
    return Postures(joints(run, side), measured={"tool": seen})


def tools(name: str, run: dict[str, Any]) -> dict[str, Calibration]:
    """Print how well the model meets the reported tool positions, and return what was fitted, by arm."""
    found = {}
    for side in "LR":
        chain = hf.ClosedChain({"arm": ur5e(hf.Pose.from_rpy(0, 0, np.pi))}, hf.HeldObject.box(1, 1, 1, 1), {})
        postures = tool_postures(run, side)
        middle = len(run["tcp_L_z"]) // 2
        first, second = (
            hf.calibrate(chain, postures.part(part), ["markers", "sensors"])
            for part in (slice(None), slice(None, middle))
        )
        later = second.errors_of(postures.part(slice(middle, None)))
        found[side] = first
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
    """Print base-to-base and grasp frames from closure alone, by fitted run, and what these leave open in others."""
    fitted = fitted_of(runs)
    chosen = {name: held(run) for name, run in runs.items()}
    chain = cell(runs[fitted[0]], settings, tool, int(chosen[fitted[0]][0]))
    q = {name: np.hstack([joints(runs[name], side)[chosen[name]] for side in "LR"]) for name in runs}
    for name in fitted:
        found = hf.calibrate(chain, q[name])
        print(f"\n{name}: base and grasp of R from closure alone, {len(q[name])} postures")
        print(found)
        for other in [other for other in q if other != name]:
            print(f"open in {other}: {opened(found.errors_of(q[other]))}")
        free = hf.calibrate(chain, q[name], largest_deviation=1.0)
        turned, placed = (", ".join(f"{x:+.3f}" for x in part) for part in (free.values[:3], free.values[3:6]))
        left = opened(free.errors)
        print(f"all twelve, whatever the deviation: base turn {turned} rad, shift {placed} m; open {left}")


def opened(errors: Any) -> str:
    """Return what is open at the grasps."""
    return ", ".join(f"{1e3 * shift:.1f} mm, {1e3 * turn:.0f} mrad" for turn, shift in errors.values())


# Ways to weigh: -m g = rows c, with rows (samples, p) of what the sensors read, vertical forces of left and right and
# the mean of their normal forces. Sensors that are not quite upright read a share of the squeeze as a vertical force.
WAYS: dict[str, Callable[[Any], Any]] = {
    "a scale and an offset of the sum": lambda x: np.column_stack([x[:, 0] + x[:, 1], np.ones(len(x))]),
    "a scale for each sensor, and an offset": lambda x: np.column_stack([x[:, :2], np.ones(len(x))]),
    "a scale for each sensor, a share of the squeeze, and an offset": lambda x: np.column_stack([x, np.ones(len(x))]),
}


def readings(run: dict[str, Any]) -> Any:
    """Return vertical forces of left and right, and the mean of their normal forces, (samples, 3), off the table."""
    k = held(run)
    k = k[lifted(run, k)]
    normal = 0.5 * (run["normal_force_L"] + run["normal_force_R"])
    return np.column_stack([run["force_L_z"], run["force_R_z"], normal])[k]


def lifted(run: dict[str, Any], k: Any) -> Any:
    """Return which of some samples have the box off the table."""
    return run["tcp_L_z"][k] > run["tcp_L_z"].min() + OFF_THE_TABLE


def fit(way: Callable[[Any], Any], given: list[tuple[Any, float]]) -> Any:
    """Return the coefficients c (p,) of a way to weigh.

    The masses of all runs are met in the mean, and the rest is chosen so that masses vary least within the runs: a
    regression of the masses on noisy readings would draw them together.
    """
    rows = [way(x) for x, _ in given]
    means = np.array([one.mean(axis=0) for one in rows])
    within = np.vstack([(one - one.mean(axis=0)) / np.sqrt(len(one)) for one in rows])
    weights = np.array([-G * mass for _, mass in given])
    particular, *_ = np.linalg.lstsq(means, weights, rcond=None)
    free = null_space(means)
    return particular - free @ np.linalg.lstsq(within @ free, within @ particular, rcond=None)[0]


def masses(runs: dict[str, dict[str, Any]]) -> bool:
    """Print masses from forces: the second halves of the fitted runs by the first, and all other runs by all of these.

    Returned is whether the last way predicts the difference of the second halves by the first ones within 5 %.

    The deviation of a mass is the root mean square of the errors of halves that the other halves predict, which
    includes what sensors drift, and by how much the coefficients of the two halves differ on the run in question, which
    grows away from what was fitted.
    """
    fitted = fitted_of(runs)
    stated = {name: mass_of(name) for name in runs}
    read = {name: readings(run) for name, run in runs.items()}
    for name, run in runs.items():
        across = (columns(run, "force_L_x", "force_L_y") - columns(run, "force_R_x", "force_R_y"))[held(run)]
        halves = np.array_split(across[lifted(run, held(run))], 2)
        first, second = ("{:+.1f} and {:+.1f} N".format(*half.mean(axis=0)) for half in halves)
        print(
            f"\n{name}: {len(read[name])} samples off the table, squeezed by {read[name][:, 2].mean():.0f} N;"
            f" horizontal forces that should cancel: {np.hypot(*across.T).mean():.1f} N, along x and y"
            f" {first} in the first half, {second} in the second"
        )
    lightest, heaviest = min(fitted, key=stated.__getitem__), max(fitted, key=stated.__getitem__)
    if stated[lightest] == stated[heaviest]:
        print("\nmasses: expected two runs with different masses to fit, got one mass")
        return False
    met = False
    for title, way in WAYS.items():
        print(f"\n{title}")
        errors, by_half = list[float](), []
        for said, of in {"second halves by the first": (0, 1), "first halves by the second": (1, 0)}.items():
            known, asked = ({name: np.array_split(read[name], 2)[k] for name in fitted} for k in of)
            c = fit(way, [(known[name], stated[name]) for name in fitted])
            by_half.append(c)
            found = {name: way(asked[name]) @ c / -G for name in fitted}
            errors += [float(found[name].mean()) - stated[name] for name in fitted]
            shown = ", ".join(f"{stated[name]:g} kg -> {found[name].mean():.2f}" for name in fitted)
            between, right = found[heaviest].mean() - found[lightest].mean(), stated[heaviest] - stated[lightest]
            off = 100.0 * (between / right - 1.0)
            met = abs(off) <= LARGEST_MISS if of == (0, 1) else met
            shown += f" ({', '.join(f'{G * (found[name].mean() - stated[name]):+.1f} N' for name in fitted)})"
            shown += f", by {np.array2string(c, precision=3)}"
            print(f"  {said}: {shown}; difference {between:.2f} of {right:.2f} kg ({off:+.1f} %)")
        c = fit(way, [(read[name], stated[name]) for name in fitted])
        deviation = float(np.sqrt(np.mean(np.square(errors))))
        within = [float((way(read[name]) @ c / G).std()) for name in fitted]
        print(
            f"  all samples: coefficients {np.array2string(c, precision=3)}; a mass varies by"
            f" {' and '.join(f'{x:.2f}' for x in within)} kg within a run; deviation {deviation:.2f} kg"
        )
        for name in [name for name in runs if name not in fitted]:
            found_mass, halves = (
                way(read[name]) @ c / -G,
                [float((way(read[name]) @ one).mean()) / -G for one in by_half],
            )
            unsure = float(np.hypot(deviation, 0.5 * (halves[0] - halves[1])))
            print(
                f"  {name}: {found_mass.mean():.2f} +- {unsure:.2f} kg, stated {stated[name]:g} kg;"
                f" varies by {found_mass.std():.2f} kg within the run{beyond(read, fitted, name)}"
            )
    return met


def beyond(read: dict[str, Any], fitted: list[str], name: str) -> str:
    """Return a remark if the squeeze of a run is not within those of the fitted runs."""
    low, high = (f([f(read[one][:, 2]) for one in fitted]) for f in (min, max))
    mean = float(read[name][:, 2].mean())
    return "" if low <= mean <= high else f"; its squeeze, {mean:.0f} N, is beyond the {low:.0f} .. {high:.0f} N fitted"


def main(folder: Path) -> bool:
    """Print all tables; return whether the bars are met."""
    runs = runs_of(folder)
    if not runs:
        raise SystemExit(f"{folder}: expected dual_ur5e_*kg.csv; docs/measured_robots.md says where to get them")
    tool: dict[str, hf.Pose] = {}
    by_arm: dict[str, Calibration] = {}
    gaps = list[float]()
    for name in fitted_of(runs):
        by_arm = tools(name, runs[name])
        gaps += [1e3 * one.errors["tool"][1] for one in by_arm.values()]
        tool = {side: found.markers["tool"] for side, found in by_arm.items()}
    for name in [name for name in runs if name not in fitted_of(runs)]:
        later = {side: found.errors_of(tool_postures(runs[name], side)) for side, found in by_arm.items()}
        shown = ", ".join(f"{side} {1e3 * errors['tool'][1]:.3f} mm rms" for side, errors in later.items())
        print(f"{name}: tool positions by the frames of {fitted_of(runs)[-1]}: {shown}")
    beside = folder / f"{fitted_of(runs)[0]}.json"
    if beside.is_file():
        closure(runs, json.loads(beside.read_text(encoding="utf-8")), tool)
    else:
        print(f"closure is left out: expected grasp points in {beside.name}, got no such file")
    return masses(runs) and max(gaps) <= LARGEST_GAP


if __name__ == "__main__":
    main(Path(sys.argv[1]))
