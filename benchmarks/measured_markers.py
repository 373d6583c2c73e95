"""TIAGo seen by motion capture: `python -m benchmarks.measured_markers [URDF]`; the postures are in tests/data.

URDF is TIAGo's file, by default `tiago.urdf` under $HOLDFAST_ROBOTS (`make robots`). One point of the hand is seen in a
frame that is fixed to the base, in 37 postures to fit and 62 of another day, held out.
"""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path

import numpy as np

import holdfast as hf
from holdfast.calibration import ClosureNoise, FrameMeasurement, Postures

DATA = Path(__file__).parents[1] / "tests" / "data" / "tiago_mocap"
FOLDER = Path(os.environ.get("HOLDFAST_ROBOTS", "results/robots"))
POINT, FRAME = (0.1, 0.0, 0.05), (0.0, -0.2, 0.35)  # guesses: on the flange, and of the frame in the base [m]
NOISE = ClosureNoise(turn=1e-3, shift=3e-3)
FRAMES = ["markers", "sensors"]
LARGEST = 0.05  # deviation [rad or m] of a direction beyond which it keeps the model's value
SOUGHT = {"frames": FRAMES, "offsets": [*FRAMES, "offsets"], "geometry": [*FRAMES, "offsets", "geometry"]}
PUBLISHED = {"frames": (3.37, 4.87), "offsets": (2.88, 4.23), "geometry": (1.64, 3.07)}  # fitted, held out [mm]


def seen(name: str) -> Postures:
    """Return the postures of a file, with the positions of the point."""
    table = np.genfromtxt(DATA / f"{name}.csv", delimiter=",", skip_header=1)
    measured = FrameMeasurement("arm", table[:, :3], hf.Pose.translation(*POINT), hf.Pose.translation(*FRAME))
    return Postures(table[:, 3:], measured={"point": measured})


def main(urdf: Path | None = None) -> bool:
    """Print fitted and held-out errors; return whether they are at most 1.1 times the published ones."""
    path = urdf or next(iter(FOLDER.rglob("tiago.urdf")), None)
    if path is None:
        raise SystemExit("expected TIAGo's URDF file; try `make robots`, or give its path")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", hf.errors.ModelWarning)
        arm = hf.load_urdf(path, base="base_footprint", tip="arm_tool_link", lock_others=True, physical=False)
    chain = hf.ClosedChain({"arm": arm}, hf.HeldObject.box(1.0, 0.1, 0.1, 0.1), {})
    train, held, met = seen("train"), seen("validation"), []
    for title, seek in SOUGHT.items():
        found = hf.calibrate(chain, train, seek, noise=NOISE, held_out=held, largest_deviation=LARGEST)
        assert found.held_out is not None
        fitted, later = (1e3 * one["point"][1] for one in (found.errors, found.held_out))
        print(
            f"{title:<9} {len(found.names):>3} unknowns, {len(found.undetermined):>2} directions kept: fitted"
            f" {fitted:.2f} mm, held out {later:.2f} mm; published {PUBLISHED[title][0]} and {PUBLISHED[title][1]} mm"
        )
        met += [fitted <= 1.1 * PUBLISHED[title][0], later <= 1.1 * PUBLISHED[title][1]]
    return all(met)


if __name__ == "__main__":
    sys.exit(not main(*map(Path, sys.argv[1:2])))
