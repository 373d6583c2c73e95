"""A sweep of a million runs on a local cluster of Dask: its rate beside that of bare rollouts, and its memory.

    python benchmarks/sweep_million.py [COUNT]

Payload, push and grasp frames differ from run to run; a run lasts 0.2 s. Bare rollouts are drawn, started and stepped
by as many processes at once as the sweep has workers, before it and after it, and nothing of them is kept.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import holdfast as hf
from benchmarks.bench.systems import facing_pandas
from holdfast.sweeps import NearPose, Normal, Uniform
from holdfast.sweeps.plan import Plan, find_generic_rank, plan_of
from holdfast.sweeps.sweep import Progress

MOST_MEMORY = 2.0  # of any process [GiB]
LEAST_SHARE = 0.85  # of the rate of bare rollouts
STEP, DURATION = 0.001, 0.2  # [s]
BARE_SECONDS = 15.0
SAMPLE_EVERY = 10  # chunks


def problem() -> tuple[hf.ClosedChain, hf.ControlLaw, hf.State, dict[str, Any]]:
    """Return two arms that hold a box on springs, and what differs from run to run."""
    chain, state = facing_pandas(armature=0.3)  # with the drives' inertia
    hold = hf.holding_torques(chain, state, internal_force=40.0)

    def stay(t: Any, now: hf.State, memory: Any, given: Any) -> tuple[Any, Any]:
        return hold - 200.0 * (now.q - state.q) - 20.0 * now.qd, memory

    frames = np.array([grasp.frame.wxyz_xyz for grasp in chain.grasps.values()])
    parameters = {
        "object_mass": Uniform(2.0, 4.0),
        "object_inertia": "scale",
        "object_wrench": Normal(0.0, [0, 0, 0, 5, 5, 5]),
        "grasp_pose": NearPose(frames, turn=1e-3, shift=1e-3),
    }
    return chain, hf.ControlLaw(stay), state, parameters


def plan(count: int, chunk: int) -> Plan:
    """Return the sweep's plan, its machine code made."""
    chain, law, state, parameters = problem()
    how: dict[str, Any] = {"count": count, "chunk": chunk, "duration": DURATION, "step": STEP}
    made = plan_of(chain, law, state=state, parameters=parameters, **how)
    return made.settled(find_generic_rank(made))


def bare(chunk: int, begin: Any, rates: Any) -> None:
    """Put the rate of bare rollouts of this process, once all have begun: by the clock and by the processor's."""
    made = plan(10**9, chunk)
    advance(made, 0)
    begin.wait()
    done, wall, processor = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - wall < BARE_SECONDS:
        advance(made, done)
        done += chunk
    rates.put((done / (time.perf_counter() - wall), done / (time.process_time() - processor)))


def advance(made: Plan, begin: int) -> None:
    """Take the steps of one chunk."""
    systems = made.rollout.start(**made.rows(begin, begin + made.chunk), threads=1)
    made.rollout.step(systems, STEP, steps=round(DURATION / STEP), threads=1)


def bare_rates(workers: int, chunk: int) -> tuple[float, float]:
    """Return the mean rate of a process, of several at once: per second, and per second of the processor."""
    context = multiprocessing.get_context("spawn")
    begin, rates = context.Barrier(workers), context.Queue()
    processes = [context.Process(target=bare, args=(chunk, begin, rates)) for _ in range(workers)]
    for process in processes:
        process.start()
    found = [rates.get() for _ in processes]
    for process in processes:
        process.join()
    by_clock, by_processor = np.mean(found, axis=0).tolist()
    return by_clock, by_processor


class Watch:
    """When chunks came, and the largest memory of this process and those that it began, as Linux tells it.

    Attributes:
        notes: how many chunks had come, when, and what all processes had taken of processors by then [s].
        most: memory by process [GiB].
    """

    def __init__(self) -> None:
        self.chunks = 0
        self.notes: list[tuple[int, float, float]] = []
        self.most: dict[int, float] = {}

    def sample(self, progress: Progress) -> None:
        """Note time and memory at every so many chunks; a line now and then says how far the sweep is."""
        self.chunks += 1
        if self.chunks % SAMPLE_EVERY:
            return
        self.notes.append((self.chunks, time.perf_counter(), 0.0))
        for pid in (os.getpid(), *descendants()):
            try:
                lines = Path(f"/proc/{pid}/status").read_text().splitlines()
                spent = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
            except OSError:  # it has ended meanwhile
                continue
            peak = [float(line.split()[1]) / 2**20 for line in lines if line.startswith("VmHWM")]
            self.most[pid] = max([self.most.get(pid, 0.0), *peak])
            chunks, clock, processor = self.notes[-1]
            self.notes[-1] = chunks, clock, processor + sum(map(int, spent)) / os.sysconf("SC_CLK_TCK")
        if len(self.notes) % SAMPLE_EVERY == 0:
            print(progress, flush=True)

    def rates(self, chunk: int) -> tuple[float, float]:
        """Return runs a second between the first note and the last: by the clock, and by all processors'."""
        (chunks, clock, processor), (all_chunks, last, spent) = self.notes[0], self.notes[-1]
        runs = (all_chunks - chunks) * chunk
        return runs / (last - clock), runs / (spent - processor)


def descendants() -> list[int]:
    """Return the processes that this one began, and theirs."""
    parents = {}
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(place.parent.name)] = int(place.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    found, left = [], [os.getpid()]
    while left:
        one = left.pop()
        children = [pid for pid, parent in parents.items() if parent == one]
        found, left = found + children, left + children
    return found


def main() -> int:
    """Print the figures; 1 if one misses its target."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=1_000_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--chunk", type=int, default=1000)
    options = parser.parse_args()
    chain, law, state, parameters = problem()
    plan(options.count, options.chunk)  # machine code is on disk from here on
    before = bare_rates(options.workers, options.chunk)
    folder, watch, start = Path(tempfile.mkdtemp()), Watch(), time.perf_counter()
    try:
        found = hf.sweep(
            chain,
            law,
            state=state,
            parameters=parameters,
            count=options.count,
            chunk=options.chunk,
            duration=DURATION,
            step=STEP,
            store=folder / "store",
            cluster="local",
            workers=options.workers,
            progress=watch.sample,
        )
        seconds = time.perf_counter() - start
        counts = found.status_counts
        size = sum(path.stat().st_size for path in (folder / "store").iterdir()) / 2**20
    finally:
        shutil.rmtree(folder)
    after = bare_rates(options.workers, options.chunk)
    rate, largest = options.count / seconds / options.workers, max(watch.most.values())
    share = rate / ((before[0] + after[0]) / 2)
    by_clock, busy = watch.rates(options.chunk)
    steady = by_clock / options.workers
    print(
        f"runs               {options.count} of {DURATION} s in {DURATION / STEP:.0f} steps, {size:.0f} MiB: {counts}"
    )
    print(f"bare rollouts      {before[0]:.0f} and {after[0]:.0f} runs/s a process, before and after")
    print(f"the sweep          {seconds:.1f} s, {rate:.0f} runs/s a worker: {share:.3f} (target: {LEAST_SHARE})")
    print(f"after its start    {steady:.0f} runs/s a worker: {steady * share / rate:.3f}")
    print(f"of processors      {busy:.0f} runs/s of all its processes, bare {before[1]:.0f}: {busy / before[1]:.3f}")
    print(f"largest process    {largest:.2f} GiB (target: {MOST_MEMORY}) of {len(watch.most)}")
    return 0 if share >= LEAST_SHARE and largest < MOST_MEMORY and counts == {"RUNNING": options.count} else 1


if __name__ == "__main__":
    sys.exit(main())
