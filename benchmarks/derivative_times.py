"""Gradients and rates of change over forward dynamics from 2 to 64 arms, their growth, and compilation without a cache.

python benchmarks/derivative_times.py [arms x joints ...]

Times are processor time of bound calls on one thread, all of a size in the same rounds. Compilation is the median of
three processes, each with an empty cache; Python's own byte code is kept, as an installation does.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import holdfast as hf
from benchmarks.bench import entries
from benchmarks.bench.clock import Effort, timed
from benchmarks.bench.derivative_entries import JVP, VJP, bound
from benchmarks.bench.systems import make_system

SIZES = {"2 x 7": 1.8, "4 x 7": 1.8, "16 x 7": 2.0, "64 x 7": 2.0, "2 x 24": 2.7, "2 x 96": 2.7}  # and goals of VJP
ROOT = Path(__file__).parents[1]  # from which a new process imports `benchmarks`
COMPILED = {"2 x 7": 1.5, "64 x 7": 2.0, "2 x 96": 12.0}  # goals [s]
EFFORT = Effort(turn=0.03, rounds=15)
FIRST_GRADIENT = """
import sys, time
import holdfast as hf
from benchmarks.bench.systems import make_system
system = make_system(*map(int, sys.argv[1:]))
start = time.process_time()
fast = hf.compile(system.chain)
q, qd, tau, pose, twist = (x[0] for x in system.arrays)
fast.forward_dynamics_vjp(q, qd, tau, pose, twist, qdd=q, by=("q", "qd", "tau", "object_pose", "object_twist"))
print(time.process_time() - start)
"""


def sizes(name: str) -> list[int]:
    """Return the numbers of arms and of joints of an arm."""
    return [int(part) for part in name.split("x")]


def compiled_in(name: str) -> float:
    """Return the processor time until the first gradient in a new process without a cache of machine code [s]."""
    with tempfile.TemporaryDirectory() as cache:
        command = [sys.executable, "-c", FIRST_GRADIENT, *map(str, sizes(name))]
        environment = os.environ | {"HOLDFAST_CACHE": cache}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        run = subprocess.run(command, capture_output=True, text=True, check=True, env=environment, cwd=ROOT)
        return float(run.stdout)


def main() -> None:
    """Print the table."""
    seconds = {}
    for name in sys.argv[1:] or SIZES:
        system = make_system(*sizes(name))
        fast = hf.compile(system.chain)
        ways = [entries.bind(system, fast), *(bound(system, fast, what).entry for what in (VJP, JVP))]
        spent = timed(ways, EFFORT, now=time.process_time)
        forward, vjp, jvp = spent.T
        seconds[name] = float(np.median(vjp))
        print(f"{name:7} VJP {np.median(vjp / forward):.2f} (goal {SIZES.get(name, 2.0)}), "
              f"JVP {np.median(jvp / forward):.2f} (goal 1.9) times forward dynamics")  # fmt: skip
    if {"16 x 7", "64 x 7"} <= seconds.keys():
        print(f"64 arms take {seconds['64 x 7'] / seconds['16 x 7']:.2f} times the VJP of 16 (goal 4.6)")
    for name, goal in COMPILED.items():
        if name in seconds:
            spent = statistics.median(compiled_in(name) for _ in range(3))
            print(f"{name:7} compiled, the first gradient included: {spent:.2f} s (goal {goal:g})")


if __name__ == "__main__":
    main()
