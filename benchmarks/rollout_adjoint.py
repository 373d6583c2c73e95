"""What gradients through rollouts cost: the tape and its way back, over the steps alone, in one process.

python benchmarks/rollout_adjoint.py [arms] [systems] [steps]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import holdfast as hf
from benchmarks.bench.systems import make_system

STEP, ROUNDS = 1e-3, 7


def measure(arms: int, count: int, steps: int, scheme: str) -> dict[str, float]:
    """Return the medians of ratios to the rollout: with all states kept, and with every sqrt(steps)-th."""
    system = make_system(arms, 7)
    q, qd, tau, pose, twist = system.repeated(count).arrays
    rollout = hf.compile_rollout(system.chain, scheme=scheme)
    systems = rollout.start(q, qd, pose, twist, tau=tau)
    cotangent = {"q": np.random.default_rng(0).normal(size=np.shape(systems.q))}

    def back(every: int) -> Any:
        return rollout.tape(systems, STEP, steps=steps, every=every, tau=tau, threads=1).vjp(cotangent, threads=1)

    ways: dict[str, Callable[[], Any]] = {
        "steps": lambda: rollout.step(systems.copy(), STEP, steps=steps, tau=tau, threads=1),
        "all states kept": lambda: back(1),
        "checkpoints": lambda: back(round(steps**0.5)),
    }
    found: dict[str, list[float]] = {name: [] for name in ways}
    for k in range(ROUNDS + 1):
        for name, way in ways.items():
            began = time.process_time()
            way()
            if k:  # the first round compiles
                found[name].append(time.process_time() - began)
    once = np.array(found.pop("steps"))
    return {name: float(np.median(np.array(times) / once)) for name, times in found.items()}


def main() -> None:
    """Print the table."""
    arms, count, steps = [int(x) for x in [*sys.argv[1:], *["2", "1024", "100"][len(sys.argv) - 1 :]]]
    print(f"{arms} x 7, {count} systems, {steps} steps, one thread; times those of the rollout alone")
    for scheme in ("rk4", "midpoint"):
        ratios = measure(arms, count, steps, scheme)
        print(f"{scheme:10}" + "".join(f"  {name} {ratio:.2f}" for name, ratio in ratios.items()))


if __name__ == "__main__":
    main()
