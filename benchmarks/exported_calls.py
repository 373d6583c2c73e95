"""What a call of exported code costs beside Python's bound call: forward dynamics and a controller of two Pandas.

Run it with HOLDFAST_COMPILE unset: `python benchmarks/exported_calls.py`. It needs GCC. Every round measures each of
them once, one thread; the figures are medians over the rounds.
"""

from __future__ import annotations

import ctypes
import statistics
import subprocess
import tempfile
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from pathlib import Path

import holdfast as hf
from holdfast.codegen import export_c
from holdfast.codegen.export import EXACT_FLAGS
from holdfast.codegen.functions import generic_rank_of
from holdfast.control import compile_law
from holdfast.scenario.build import Scenario

SCENE = Path(__file__).parents[1] / "examples" / "two_pandas.toml"
CALLS, ROUNDS = 2000, 41
TIMED = """
#include <time.h>
#include "pandas.h"
#define TIMED(name) \\
    static name##_memory name##_m; static name##_arrays name##_a; \\
    void name##_ready(void) { name##_begin(&name##_m, &name##_a); } \\
    double name##_timed(int calls) { \\
        struct timespec a, b; \\
        clock_gettime(CLOCK_MONOTONIC, &a); \\
        for (int k = 0; k < calls; k++) name(&name##_a); \\
        clock_gettime(CLOCK_MONOTONIC, &b); \\
        return ((b.tv_sec - a.tv_sec) * 1e6 + (b.tv_nsec - a.tv_nsec) * 1e-3) / calls; \\
    }
TIMED(pandas_forward_dynamics)
TIMED(pandas_control)
"""


def library(scene: Scenario, folder: Path, source: bool) -> ctypes.CDLL:
    """Return exported code with functions that time it, loaded."""
    state, laws = scene.state, {"control": scene.controller}
    export_c(scene.chain, folder, name="pandas", functions=["forward_dynamics"], laws=laws, source=source, state=state)
    (folder / "timed.c").write_text(TIMED)
    code = "pandas.c" if source else "pandas.o"
    flags = ["-std=gnu11", "-O2", "-march=x86-64-v3", *EXACT_FLAGS.split(), "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, "-o", "timed.so", "timed.c", code, "-lm"], cwd=folder, check=True)
    made = ctypes.CDLL(str(folder / "timed.so"))
    for name in ("forward_dynamics", "control"):
        getattr(made, f"pandas_{name}_timed").restype = ctypes.c_double
        getattr(made, f"pandas_{name}_ready")()
    return made


def bound_calls(scene: Scenario) -> dict[str, Callable[[], object]]:
    """Return Python's bound calls on the same state."""
    s, compiled = scene.state, hf.compile(scene.chain)
    compiled.set_generic_rank(generic_rank_of(compiled, s) or 0)
    forward = compiled.bind()
    law = compile_law(scene.controller, scene.chain).bind()
    for one in (forward, law):
        for name in ("q", "qd", "object_pose", "object_twist"):
            getattr(one, name)[...] = getattr(s, name)
    return {"forward_dynamics": forward.run, "control": law.run}


def python_time(call: Callable[[], object]) -> float:
    """Return microseconds of a call."""
    begin = time.perf_counter()
    for _ in range(CALLS):
        call()
    return (time.perf_counter() - begin) / CALLS * 1e6


def main() -> None:
    """Print medians and their ratios."""
    scene = hf.load_scene(SCENE)
    bound = bound_calls(scene)
    with tempfile.TemporaryDirectory() as place:
        made = {kind: library(scene, Path(place) / kind, kind == "C source, GCC") for kind in KINDS}
        times: dict[tuple[str, str], list[float]] = {}
        for _ in range(ROUNDS):
            for name, call in bound.items():
                times.setdefault((name, "bound, Python"), []).append(python_time(call))
                for kind, code in made.items():
                    one = getattr(code, f"pandas_{name}_timed")(CALLS)
                    times.setdefault((name, kind), []).append(one)
    for name in bound:
        own = statistics.median(times[name, "bound, Python"])
        for kind in ("bound, Python", *KINDS):
            median = statistics.median(times[name, kind])
            print(f"{name:17} {kind:16} {median:6.2f} us  {median / own:5.2f} of the bound call")


KINDS = ("object file", "C source, GCC")

if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
