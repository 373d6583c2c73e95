"""What threads gain: batches with the number of threads that they choose, beside the same batches on one thread.

Two Pandas with a box. Both take turns call by call, so that a busy machine slows both, and the ratio is the median of
those of the pairs. Run it with HOLDFAST_COMPILE unset, on a quiet machine: `python -m benchmarks.batch_threads`.
"""

from __future__ import annotations

import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import holdfast as hf
from benchmarks.bench.clock import least_time
from benchmarks.bench.systems import make_system
from holdfast.compiler import threads
from holdfast.compiler.threads import free_processors

PAIRS, SECONDS = 31, 2.0  # of a row, at most
STEP = 1e-3  # s

Call = Callable[[int | None], object]


def batches() -> Iterator[tuple[str, Call]]:
    """Yield what is asked, and the call with a number of threads."""
    system = make_system(2, 7)
    fast = hf.compile(system.chain)
    for size in (8, 64, 1024, 4096, 16384, 65536):
        arrays = system.repeated(size).arrays
        out = fast.forward_dynamics(*arrays)
        yield f"forward dynamics of {size:,}", lambda n, a=arrays, o=out: fast.forward_dynamics(*a, out=o, threads=n)
    arrays = system.repeated(4096).arrays
    given: Any = {"qdd": arrays[1], "by": ("q", "tau")}
    out = fast.forward_dynamics.vjp(*arrays, **given)
    yield "their gradients, 4,096", lambda n: fast.forward_dynamics.vjp(*arrays, **given, out=out, threads=n)
    rollout = hf.compile_rollout(system.chain)
    for size, steps in ((8, 1), (64, 1), (64, 20), (1024, 20)):
        q, qd, tau, pose, twist = system.repeated(size).arrays
        systems = rollout.start(q, qd, pose, twist, tau=tau)

        def step(n: int | None, systems: Any = systems, steps: int = steps) -> object:
            return rollout.step(systems.copy(), STEP, steps=steps, threads=n)

        yield f"{steps} rk4 step{'s' * (steps > 1)} of {size:,}", step


def compared(call: Call) -> tuple[int, float, float, float]:
    """Return how many threads a call chooses, its time on one thread and by default [s], and their ratio."""
    started, start = [], threads.start_new_thread
    threads.start_new_thread = lambda *given: started.append(0) or start(*given)
    try:
        call(None)
    finally:
        threads.start_new_thread = start
    call(1)
    found: list[list[float]] = []
    end = time.perf_counter() + SECONDS
    while len(found) < PAIRS and time.perf_counter() < end:
        pair = [0.0, 0.0]
        for k in (0, 1) if len(found) % 2 else (1, 0):
            begin = time.perf_counter()
            call(None if k else 1)
            pair[k] = time.perf_counter() - begin
        found.append(pair)
    one, chosen = np.median(found, axis=0).tolist()
    return 1 + len(started), one, chosen, float(np.median([a / b for a, b in found]))


def start_time() -> float:
    """Return how long it takes to start a thread that does nothing, and to wait for it [s]."""
    found = []
    for _ in range(1001):
        begin = time.perf_counter()
        threads.divide(lambda begin, end: None, 2, 1, 2)
        found.append(time.perf_counter() - begin)
    return float(np.median(found))


def main() -> None:
    """Print what a thread costs and the work for which one is started, and a row for every batch."""
    print(f"{free_processors()} processors are free; starting a thread takes {1e3 * start_time():.3f} ms, ", end="")
    system = make_system(2, 7)
    fast = hf.compile(system.chain)
    arrays = system.repeated(4096).arrays
    kernel, out = fast.forward_dynamics.calls.kernel, fast.forward_dynamics(*arrays)
    seconds = least_time(lambda: fast.forward_dynamics(*arrays, out=out, threads=1), 1, PAIRS)
    work = kernel.operation_count * 4096 / kernel.lanes
    print(f"{threads.LEAST_WORK:,} operations {1e3 * seconds * threads.LEAST_WORK / work:.3f} ms")
    print(f"{'ms':34}{'one thread':>11}{'chosen':>10}{'threads':>9}{'ratio':>7}")
    for what, call in batches():
        count, one, chosen, ratio = compared(call)
        print(f"{what:34}{1e3 * one:11.3f}{1e3 * chosen:10.3f}{count:9}{ratio:7.2f}", flush=True)


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
