"""Compile times in a new process, without a cache and with the cache of an earlier process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from holdfast.errors import HoldfastError

ROOT = Path(__file__).parents[2]  # from which a new process imports `benchmarks`
# llvmlite is imported first, since its loading is not compilation. The first result is included in case of lazy work.
PROGRAM = """
import json, sys, time
import llvmlite.binding
import holdfast
from benchmarks.bench.entries import each_state
from benchmarks.bench.systems import make_system
system = make_system(int(sys.argv[1]), int(sys.argv[2]), 1)
state = each_state(system)[0]
compile = holdfast.compile
start = time.perf_counter()
fast = compile(system.chain)
made = time.perf_counter()
fast.forward_dynamics(*state)
print(json.dumps({"compile": made - start, "first_answer": time.perf_counter() - start}))
"""


def compile_times(arm_count: int, joint_count: int, runs: int) -> dict[str, dict[str, float]]:
    """Return the shortest times {"cold", "cached"}: {"compile", "first_answer" (with compilation)} of the runs [s].

    The shortest time is that of a run with the least disturbance by other processes.

    Args:
        arm_count: number of arms.
        joint_count: number of joints per arm.
        runs: number of new processes for each time.

    Raises:
        HoldfastError: the process failed.
    """
    sizes = (str(arm_count), str(joint_count))
    cold = [_fresh(sizes, "off") for _ in range(runs)]
    with tempfile.TemporaryDirectory(prefix="holdfast-bench-") as folder:
        _fresh(sizes, folder)  # this fills the cache
        cached = [_fresh(sizes, folder) for _ in range(runs)]
    return {"cold": _best(cold), "cached": _best(cached)}


def _best(runs: list[dict[str, float]]) -> dict[str, float]:
    return {key: min(run[key] for run in runs) for key in runs[0]}


def _fresh(sizes: tuple[str, str], cache: str) -> dict[str, float]:
    """Return the measurement of a new process."""
    environment = os.environ | {"HOLDFAST_CACHE": cache, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, *sizes], env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )
    if run.returncode:
        raise HoldfastError(f"compiling {' x '.join(sizes)} in a process of its own failed: {run.stderr[-500:]}")
    return json.loads(run.stdout)
