"""How long compiling takes, in a process of its own: cold, and from the cache of an earlier one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile

from holdfast.errors import HoldfastError

# llvmlite is imported first: its loading is not compiling. The first answer counts, should anything wait for it.
PROGRAM = """
import json, sys, time
import llvmlite.binding
import holdfast
from holdfast.bench.entries import each_state
from holdfast.bench.systems import make_system
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
    """Return seconds of {"cold", "cached"}: {"compile", "first_answer" (compiling included)}, best of the runs.

    The best, because a process either had the processor to itself or it had not.

    Args:
        arm_count: of the chain.
        joint_count: per arm.
        runs: fresh processes for each.

    Raises:
        HoldfastError: the process failed.
    """
    sizes = (str(arm_count), str(joint_count))
    cold = [_fresh(sizes, "off") for _ in range(runs)]
    with tempfile.TemporaryDirectory(prefix="holdfast-bench-") as folder:
        _fresh(sizes, folder)  # fills the cache
        cached = [_fresh(sizes, folder) for _ in range(runs)]
    return {"cold": _best(cold), "cached": _best(cached)}


def _best(runs: list[dict[str, float]]) -> dict[str, float]:
    return {key: min(run[key] for run in runs) for key in runs[0]}


def _fresh(sizes: tuple[str, str], cache: str) -> dict[str, float]:
    """Return what a new process measures."""
    environment = os.environ | {"HOLDFAST_CACHE": cache, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, *sizes], env=environment, capture_output=True, text=True, check=False
    )
    if run.returncode:
        raise HoldfastError(f"compiling {' x '.join(sizes)} in a process of its own failed: {run.stderr[-500:]}")
    return json.loads(run.stdout)
