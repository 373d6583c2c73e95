"""TALOS touching a table: `python -m benchmarks.measured_touches [URDF]`; the postures are in tests/data.

URDF is TALOS's file, by default `talos_full_v2.urdf` or `talos_reduced.urdf` under $HOLDFAST_ROBOTS (`make robots`).
"""

from __future__ import annotations

import csv
import os
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import holdfast as hf
from holdfast.calibration import ClosureNoise

DATA = Path(__file__).parents[1] / "tests" / "data" / "talos_table_contact"
FOLDER = Path(os.environ.get("HOLDFAST_ROBOTS", "results/robots"))
TABLE, FINGERS = (0.30, 0.28, 1.0), (0.0, 0.0, -0.12)  # guesses, from the left sole and on the gripper [m]
NOISE = ClosureNoise(turn=3e-3, shift=1e-3)
FRAMES = ["bases:table", "tips:touch"]
GEOMETRY = [*FRAMES, "geometry:arm", "offsets:arm"]
PRIORS = (1e-3, 2e-3, 4e-3, 8e-3)  # [rad] of turns of axes; half of it of their shifts [m], twice of offsets


def standing(urdf: Path, side: str) -> hf.ClosedChain:
    """Return the chain from the sole of a side to its gripper, which touches a table."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", hf.errors.ModelWarning)
        arm = hf.load_urdf(
            urdf, base=f"{side}_sole_link", tip=f"gripper_{side}_base_link", lock_others=True, physical=False
        )
    arm = replace(arm, frames={"fingers": (arm.joint_count - 1, arm.tip @ hf.Pose.translation(*FINGERS))})
    at = np.array(TABLE) * (1.0, 1.0 if side == "left" else -1.0, 1.0)
    top = hf.Arm([hf.Joint("prismatic")], [hf.Link(1.0, name="top")], base=hf.Pose.translation(*at))
    touch = hf.Closure("arm/fingers", "table/top", hf.Grasp("planar"))
    unheld = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)
    return hf.ClosedChain({"arm": arm, "table": top}, unheld, {}, loops={"touch": touch})


def postures(chain: hf.ClosedChain, name: str) -> Any:
    """Return the joint positions of a file, with 0 for the table."""
    with (DATA / f"{name}.csv").open() as file:
        head, *rows = csv.reader(file)
    table = dict(zip(head, np.array(rows, float).T, strict=True))
    return np.column_stack([*(table[joint.name] for joint in chain.arms["arm"].joints), np.zeros(len(rows))])


def main(urdf: Path | None = None) -> None:
    """Print fitted and held-out errors."""
    path = urdf or next(
        (one for name in ("talos_full_v2", "talos_reduced") for one in FOLDER.rglob(f"{name}.urdf")), None
    )
    if path is None:
        raise SystemExit("expected TALOS's URDF file; try `make robots`, or give its path")
    for side in ("left", "right"):
        touching(standing(path, side), side)


def touching(chain: hf.ClosedChain, side: str) -> None:
    """Print fitted and held-out errors of one side."""
    train, held = postures(chain, f"{side}_train"), postures(chain, f"{side}_validation")
    for title, seek, prior, largest in (
        ("table and fingers", FRAMES, None, 1.0),
        ("and joints, known to 10 mrad, 10 mm", GEOMETRY, None, 0.01),
        *(
            (
                f"and joints, with a prior of {1e3 * x:g} mrad, {500 * x:g} mm",
                GEOMETRY,
                {"geometry": (x, 0.5 * x), "offsets": 2 * x},
                1.0,
            )
            for x in PRIORS
        ),
    ):
        found = hf.calibrate(chain, train, seek, prior=prior, noise=NOISE, held_out=held, largest_deviation=largest)
        assert found.held_out is not None
        (turn, shift), (later_turn, later_shift) = found.errors["touch"], found.held_out["touch"]
        print(
            f"{side:<6} {title:<42} {len(found.names):>3} unknowns, fitted {1e3 * shift:.2f} mm"
            f" {np.degrees(turn):.2f} deg, held out {1e3 * later_shift:.2f} mm {np.degrees(later_turn):.2f} deg"
        )


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
