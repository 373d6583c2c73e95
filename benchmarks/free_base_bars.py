"""Payloads of robots on a free base, from noisy positions: bias, scatter and coverage of what is said of the errors.

    python -m benchmarks.free_base_bars [--seeds 24] [--by simulated prescribed]

Two recordings of an arm with a box on a light body that nothing holds: 2 s at 50 Hz, simulated, with a controller
that is switched on at the start and a joint that turns back within some 80 ms; and 4 s at 40 Hz of joints that move by
sines, by Newton and Euler alone (`tests/identification/free_robot.py`). Torques have noise of 0.02 N m. Printed are the
mean errors and their scatter in units of the stated deviations, whose mean has the error 1 / sqrt(seeds), and the
share of truths in 90 % regions and intervals. Returns 1 if a region is missed too often: below 85 % beyond chance.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np
from scipy.stats import binom, chi2
from tests.identification.free_robot import recorded
from tests.identification.test_position_noise import TORQUES, carried_by_a_floating_robot

import holdfast as hf

LEVEL, LOWEST = 0.9, 0.85
POSITIONS = (1e-4, 1e-3)  # rad
SIMULATED = np.arange(10)  # of the values of a body, those that the motion tells
IN_A_PLANE = np.array([0, 1, 3, 7])


def values(body: hf.HeldObject) -> np.ndarray:
    """Return mass, mass centre and inertia, (10,)."""
    return np.array([body.mass, *body.com, *body.inertia[np.triu_indices(3)]])


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--by", nargs="+", choices=("simulated", "prescribed"), default=("simulated", "prescribed"))
    asked, met = parser.parse_args(), True
    for by in asked.by:
        chain, exact = carried_by_a_floating_robot(100) if by == "simulated" else recorded(3.0, 4.0, 160)
        of = SIMULATED if by == "simulated" else IN_A_PLANE
        guess = hf.HeldObject(
            0.5 * chain.held_object.mass, 0.7 * chain.held_object.inertia, 0.8 * chain.held_object.com
        )
        assert exact.tau is not None
        model, right = replace(chain, held_object=guess), values(chain.held_object)[of]
        for size in POSITIONS:
            errors, inside, left_out = [], 0, 0
            for seed in range(asked.seeds):
                random = np.random.default_rng(seed)
                tau = exact.tau + TORQUES * random.normal(size=exact.q.shape)
                q = exact.q + size * random.normal(size=exact.q.shape)
                found = hf.identify(model, replace(exact, tau=tau, q=q, qd=None, qdd=None), by="tau")
                e, C = found.values[of] - right, found.covariance[np.ix_(of, of)]
                errors.append(e / np.sqrt(np.diag(C)))
                inside += bool(e @ np.linalg.solve(C, e) < chi2.ppf(LEVEL, len(of)))
                left_out += any("left out" in note for note in found.notes)
            z = np.array(errors)
            print(f"{by}, positions {1e3 * size:g} mrad, {asked.seeds} seeds, {left_out} with samples left out")
            print("  mean error / deviation ", *(f"{x:6.2f}" for x in z.mean(axis=0)))
            print("  scatter / deviation    ", *(f"{x:6.2f}" for x in z.std(axis=0, ddof=1)))
            each = 100 * (np.abs(z) < 1.645).mean()
            print(f"  90 % regions hold {inside} of {asked.seeds}, 90 % intervals {each:.0f} %", flush=True)
            met &= bool(binom.cdf(inside, asked.seeds, LOWEST) > 0.01)
    return int(not met)


if __name__ == "__main__":
    sys.exit(main())
