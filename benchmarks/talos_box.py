"""Talos on two soles with a box between its palms: torques within all limits, by `hf.forces.distribute`.

    make robots
    python -m benchmarks.talos_box [--mass 2] [--rounds 5]

The soles of the feet and the palms are rectangles that may only press and must neither slip nor tip. Without Talos's
file it is a humanoid built in code. Printed are, at rest and for an upward acceleration of the box: by how much the
wrenches of the feet differ from the weight, the residual of the programme, the margins, by how much forward dynamics
with these torques differs, and the time of a call; and then what is said when too much is asked.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tests.systems.standing import HANDS, Standing, humanoid_with_box, standing

import holdfast as hf
from holdfast.dynamics.tree.mechanism_terms import flat_state

FOLDER = Path(os.environ.get("HOLDFAST_ROBOTS", "results/robots"))
TIPS = {
    "left": "gripper_left_base_link",
    "right": "gripper_right_base_link",
    "left_leg": "left_sole_link",
    "right_leg": "right_sole_link",
}
LEG = (0.0, 0.0, -0.411354, 0.859395, -0.448041, -0.001708)
ARM, MIRRORED = np.array([0.25, 0.17, 0.0, -1.2, 0.0, 0.0, 0.0]), np.array([-1.0, -1.0, -1.0, 1.0, -1.0, -1.0, 1.0])
LIMITS = hf.forces.ForceLimits(least_margin=1.0)
LIFT, TOO_MUCH = 1.0, 80.0  # m/s^2


class Checked(NamedTuple):
    """One distribution.

    Attributes:
        found: the distribution.
        unbalanced: |wrenches of the feet + weight| about the world's origin, relative to the weight, at rest [N m, N].
        margins: of every grasp and sole [N].
        given_back: largest difference to forward dynamics with the torques, of accelerations and of wrenches relative
            to the largest one.
        seconds: time of a call.
    """

    found: hf.forces.Distribution
    unbalanced: float
    margins: np.ndarray
    given_back: float
    seconds: float


def urdf() -> Path | None:
    """Return Talos's file; None if it has not been fetched."""
    return next(iter(sorted(FOLDER.rglob("talos_reduced.urdf"))), None)


def talos(path: Path, mass: float = 2.0) -> Standing:
    """Return Talos with a box of some mass [kg], of its URDF file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", hf.errors.ModelWarning)
        found = hf.load_urdf_trunk(path, TIPS, floating=True, lock_others=True, physical=False)
    q = {"trunk": (0.0, 0.0), "left": ARM, "right": MIRRORED * ARM, "left_leg": LEG, "right_leg": LEG}
    return standing(found.arms, found.trunk, found.mounts, q, mass)


def asked(p: Standing, up: float) -> dict[str, np.ndarray]:
    """Return what is asked: a trunk at rest, and an upward acceleration of the box [m/s^2], or forearms at rest."""
    forearms = [f"{name}/{p.chain.arms[name].links[3].name}" for name in HANDS]
    still = ["trunk/base", f"trunk/{p.chain.mounts['left']}", *(forearms if up == 0.0 else [])]
    return dict.fromkeys(still, np.zeros(6)) | {"object": np.array([0.0, 0.0, 0.0, 0.0, 0.0, up])}


def unbalanced(p: Standing, found: hf.forces.Distribution) -> float:
    """Return |wrenches of the feet + weight|, largest entry, about the world's origin, at rest."""
    forest, total = p.chain.forest, np.zeros(6)
    for body, pose in zip(forest.bodies, forest.poses(flat_state(p.chain, p.state)[0]), strict=True):
        weight = body.link.mass * forest.gravity
        total += np.append(np.cross(pose.p + pose.R @ body.link.com, weight), weight)
    for name, sole in p.chain.loops.items():
        f = found.wrenches[name]
        total += np.append(f[:3] + np.cross(sole.tip.p, f[3:]), f[3:])
    return float(np.abs(total).max())


def checked(p: Standing, up: float, rounds: int = 1) -> Checked:
    """Return a distribution for an upward acceleration of the box, with what is known about it."""
    found, times = hf.forces.distribute(p.chain, p.state, asked(p, up), limits=LIMITS), []
    for _ in range(rounds):
        start = time.perf_counter()
        hf.forces.distribute(p.chain, p.state, asked(p, up), limits=LIMITS)
        times.append(time.perf_counter() - start)
    back = hf.forward_dynamics(p.chain, p.state, found.tau)
    pairs: list[tuple[Any, Any]] = [
        (back.qdd, found.qdd),
        (back.base_acceleration, found.base_acceleration),
        (back.object_acceleration, found.object_acceleration),
        (back.grasp_wrench, found.grasp_wrench),
    ]
    differs = max(float(np.abs(x - y).max()) / max(1.0, float(np.abs(y).max())) for x, y in pairs)
    margins = hf.forces.grasp_margins(p.chain, p.state, found.grasp_wrench)
    return Checked(found, unbalanced(p, found), margins, differs, min(times))


def main() -> None:
    """Print the checks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mass", type=float, default=2.0, help="of the box [kg]")
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    path = urdf()
    p = humanoid_with_box(given.mass) if path is None else talos(path, given.mass)
    print(f"{'a humanoid built in code' if path is None else path.stem}: {p.chain.joint_count} joints")
    for what, up in (("at rest", 0.0), (f"box up by {LIFT:g} m/s^2", LIFT)):
        done = checked(p, up, given.rounds)
        names = [*HANDS, *p.chain.loops]
        margins = ", ".join(f"{name} {x:.4g}" for name, x in zip(names, done.margins, strict=True))
        print(f"{what}: {done.found.status}, {1e3 * done.seconds:.1f} ms, residual {done.found.residual:.1e}")
        if up == 0.0:
            print(f"  feet and weight differ by {done.unbalanced:.1e} N m, N")
        print(f"  forward dynamics differs by {done.given_back:.1e}; margins [N]: {margins}")
    print(f"box up by {TOO_MUCH:g} m/s^2: {checked(p, TOO_MUCH).found.why}")
    most = hf.forces.lift_margin(p.chain, p.state, asked(p, LIFT), limits=LIMITS)
    least = hf.forces.least_peak(p.chain, p.state, asked(p, LIFT), limits=LIMITS)
    print(f"largest upward acceleration {LIFT * most.value:.4g} m/s^2; least peak {least.value:.4g}")


if __name__ == "__main__":
    main()
