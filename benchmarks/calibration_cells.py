"""Calibration of random two-arm cells: `python -m benchmarks.calibration_cells [CELLS [PLANTED [FIRST]]]`.

Cells have the numbers FIRST (0) to CELLS - 1. 30 noisy postures each, 0.1 mrad and 0.05 mm. Prints how often the 90 %
region of the estimate holds the truth, and whether directions that postures cannot determine, known by geometry, are
found.
"""

from __future__ import annotations

import sys

import numpy as np
from scipy.stats import beta, chi2
from scipy.stats import f as fisher
from tests.calibration.cells import JOINTS, SHIFT, TURN, Cell, cell, distance, share_found, sought
from tests.calibration.planted import CASES

import holdfast as hf
from holdfast.calibration import ClosureNoise

NOISE = ClosureNoise(TURN, SHIFT, JOINTS)
LEVEL = 0.9


def inside(one: Cell, found: hf.calibration.Calibration) -> bool:
    """Return whether the truth is in the 90 % region."""
    squared, dimensions = distance(one, found)
    nu = found.freedoms
    return bool(
        squared < (chi2.ppf(LEVEL, dimensions) if np.isinf(nu) else dimensions * fisher.ppf(LEVEL, dimensions, nu))
    )


def share(hits: list[bool]) -> str:
    """Return a share with its 95 % interval."""
    k, n = sum(hits), len(hits)
    low, high = beta.ppf(0.025, k, n - k + 1) if k else 0.0, beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return f"{100 * k / n:.1f} % ({100 * low:.1f} .. {100 * high:.1f})"


def main(cells: int = 1000, planted: int = 50, first: int = 0) -> None:
    """Print the tables."""
    given, estimated, claimed = [], [], 0
    for seed in range(first, cells):
        one = cell(seed)
        found = hf.calibrate(one.model, one.q, sought(one), noise=NOISE)
        given.append(inside(one, found))
        claimed += bool(found.undetermined)
        estimated.append(inside(one, hf.calibrate(one.model, one.q, sought(one))))
        if (seed + 1) % 100 == 0 or seed + 1 == cells:
            print(f"{len(given)} random cells up to number {seed}: the 90 % region holds")
            print(f"  {share(given)} of truths with given noise,")
            print(f"  {share(estimated)} with estimated noise; {claimed} cells with something undetermined", flush=True)
    print(
        f"{'planted':<22} {'cells':>5} {'found':>6}  {'worst cosine':>12}  {'more than planted':>17}  90 % region holds"
    )
    for name, case in CASES.items():
        cosines, more, held = [], 0, []
        for seed in range(planted):
            one, seek, directions = case(seed)
            found = hf.calibrate(one.model, one.q, seek, noise=NOISE)
            cosines.append(share_found(found, directions))
            more += found.fitted.null.shape[1] > len(directions)
            held.append(inside(one, found))
        hits = int((np.array(cosines) > 0.99).sum())
        print(
            f"{name:<22} {planted:>5} {hits:>6}  {min(cosines, default=1.0):>12.5f}  {more:>17}  {share(held)}",
            flush=True,
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
