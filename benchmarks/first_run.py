"""What a first run costs besides its steps: two Pandas with a box, everything recorded, each in a new process.

Prints processor time [ms] of the imports, and of what a first run takes more than a second one: with an empty cache
(cold), and with the machine code of an earlier process (cached). The rest of a row is where the time of the cold run
goes: tracing the functions and writing them in LLVM's language, and LLVM. Run it with HOLDFAST_COMPILE unset:
`python -m benchmarks.first_run`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROUNDS = 5
COLUMNS = ("imports", "cold", "tracing", "LLVM", "cached")
CASES = {"rigid": {}, "soft fingers": {}, "soft fingers, sampled": {"sample_time": 2e-3, "delay": 1e-3}}
PROGRAM = """
import json, sys, time
now = time.process_time
import numpy as np
import holdfast as hf
from benchmarks.bench.systems import facing_pandas
from holdfast.compiler.targets.llvm import cpu

def spent(name):
    found, whole = getattr(cpu, name), []
    def timed(*given):
        begin = now()
        try:
            return found(*given)
        finally:
            whole.append(now() - begin)
    setattr(cpu, name, timed)
    return whole

name, options = sys.argv[1], json.loads(sys.argv[2])
soft = ("softfinger", hf.Friction(mu=0.8, torsion_radius=0.02)) if "soft" in name else ()
chain, state = facing_pandas(*soft)
law = hf.control.GravityCompensation(chain)
before = now()
import holdfast.simulation.simulate, holdfast.control.compiled_law, holdfast.simulation.rollout.compiled_steppers
imported = now()
traced, compiled = spent("_made"), spent("_compiled")
times = []
for _ in range(2):
    begin = now()
    hf.simulate(chain, state, law, 0.05, 1e-3, on_slip="record", **options)
    times.append(now() - begin)
print(json.dumps([imported - before, *times, sum(traced), sum(compiled)]))
"""


def measured(name: str, cache: str) -> list[float]:
    """Return times of a new process [s]: imports, the first run, a second one, tracing and LLVM in the first."""
    environment = os.environ | {"HOLDFAST_CACHE": cache, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # the sources are to be compiled once
    run = [sys.executable, "-c", PROGRAM, name, json.dumps(CASES[name])]
    root = Path(__file__).parents[1]
    return json.loads(subprocess.run(run, env=environment, cwd=root, stdout=subprocess.PIPE, check=True).stdout)


def main() -> None:
    """Print a row for every kind of grasp; each number is the least of several processes."""
    print(f"{'ms':24}" + "".join(f"{column:>10}" for column in COLUMNS))
    for name in CASES:
        with tempfile.TemporaryDirectory(prefix="holdfast-bench-") as folder:
            cold = [measured(name, str(Path(folder, str(k)))) for k in range(ROUNDS)]
            cached = [measured(name, str(Path(folder, "0"))) for _ in range(ROUNDS)]
        imports, first, second, traced, compiled = (1e3 * min(times) for times in zip(*cold, strict=True))
        _, first_cached, second_cached, _, _ = (1e3 * min(times) for times in zip(*cached, strict=True))
        row = (imports, first - second, traced, compiled, first_cached - second_cached)
        print(f"{name:24}" + "".join(f"{value:10.0f}" for value in row), flush=True)


if __name__ == "__main__":
    main()
