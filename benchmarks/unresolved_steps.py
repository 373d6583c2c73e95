"""Runs whose controllers damp joints with random gains: is every step that is too long for its gain named, no other?

The gain is a multiple of the largest that the scheme follows (`simulation.stability`): from 0.5 to 20 times, and, as
runs of which nothing should be said, from 0.003 to 0.25 times. Each run is compared with one of shorter steps. Missed:
a run that completes without a word, with a velocity off by more than 1 % of the largest. False: one of which something
is said although no velocity is off by more than 0.5 %.

python benchmarks/unresolved_steps.py [--runs 100] [--first 0]
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import holdfast as hf
from benchmarks.bench.systems import make_system
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.simulation.stability import fastest_decay

STEPS = 120
RANGES = {"too high": (0.5, 20.0), "low": (0.003, 0.25)}
LONGEST, ALLOWED, NO_ERROR = 24, 0.01, 0.005


def case(seed: int, lowest: float, highest: float) -> tuple[hf.ClosedChain, hf.State, Any, float, str, float]:
    """Return a random chain, its state, a controller, a step, a scheme, and the multiple of what the scheme follows."""
    random = np.random.default_rng(seed)
    system = make_system(int(random.integers(1, 3)), int(random.integers(6, 8)), 1, seed)
    chain, n = system.chain, system.chain.joint_count
    moving = float(random.random() < 0.5)
    state = hf.State(system.q[0], moving * system.qd[0], system.object_pose[0], moving * system.object_twist[0])
    gains = random.uniform(0.3, 1.0, n) * (random.random(n) < random.uniform(0.1, 1.0))
    gains[random.integers(n)] = 1.0
    step, scheme = 10 ** random.uniform(-3.3, -2.5), "rk4" if random.random() < 0.7 else "midpoint"
    multiple = float(np.exp(random.uniform(*np.log([lowest, highest]))))
    resistance = np.hstack([np.diag(gains), np.zeros((n, 6))])
    damping = (
        gains * multiple * scheme_of(scheme).stability_interval / (step * fastest_decay(chain, state, resistance).rate)
    )
    stiffness, drive = damping * random.uniform(0.0, 5.0), random.uniform(0.1, 5.0) * random.normal(size=n)
    hold, frequency = hf.holding_torques(chain, state.at_rest()), random.uniform(1.0, 10.0)

    def controller(t: float, now: hf.State, memory: Any) -> tuple[Any, Any]:
        return hold - stiffness * (now.q - state.q) - damping * now.qd + drive * np.sin(frequency * t), memory

    return chain, state, controller, step, scheme, multiple


def verdict(seed: int, lowest: float, highest: float) -> str:
    """Return what became of one run: ended, named, silent, missed or false."""
    chain, state, controller, step, scheme, multiple = case(seed, lowest, highest)
    run = hf.simulate(chain, state, controller, STEPS * step, step, scheme=scheme)
    if run.stopped is not None:
        return "ended"
    parts = int(np.clip(np.ceil(3 * multiple + 1), 2, LONGEST))
    fine = hf.simulate(chain, state, controller, STEPS * step, step / parts).qd[::parts]
    count = min(len(fine), len(run.qd))
    off = np.abs(run.qd[:count] - fine[:count]).max() / max(np.abs(fine).max(), 1e-3)
    if any(one.kind == "unresolved" for one in run.occurrences):
        return "false" if off <= NO_ERROR else "named"
    return "missed" if off > ALLOWED else "silent"


def main() -> None:
    """Print how many runs of each range ended, were named, or completed in silence, and how many of these wrongly."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=100, help="number of runs of each range")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    chosen = parser.parse_args()
    print(f"{'gains':12}{'ended':>8}{'named':>8}{'silent':>8}{'missed':>8}{'false':>8}")
    for what, (lowest, highest) in RANGES.items():
        found = Counter(verdict(seed, lowest, highest) for seed in range(chosen.first, chosen.first + chosen.runs))
        print(f"{what:12}" + "".join(f"{found[kind]:8}" for kind in ("ended", "named", "silent", "missed", "false")))


if __name__ == "__main__":
    main()
