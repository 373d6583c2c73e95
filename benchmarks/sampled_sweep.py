"""What sampling a law costs in a sweep: two Pandas hold a box, runs per second of CPU time beside the unsampled law.

The laws are joint springs, the cheapest there is, and object tracking, computed torque for the whole chain. Each is
swept as it is, sampled at every step, delayed by a sample, and with all imperfections: noise of all measurements and
torques, resolutions, saturation and a rate limit. The sweeps take turns, so that a busy machine slows all of them.

Run it with HOLDFAST_COMPILE unset, on a quiet machine: `python benchmarks/sampled_sweep.py`.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from typing import Any

import numpy as np

import holdfast as hf
from holdfast.gym.task import two_fingers

RUNS, STEPS, STEP, ROUNDS = 2000, 400, 1e-3, 5
IMPERFECT: dict[str, Any] = {
    "noise": {"q": 1e-5, "qd": 1e-3, "object_pose": 1e-5, "object_twist": 1e-3, "tau": 0.05},
    "seed": 0,
    "resolution": {"q": 2.0 * np.pi / 2**18, "tau": 0.01},
    "saturation": True,
    "rate_limit": 1000.0,
}
WAYS: dict[str, dict[str, Any] | None] = {
    "not sampled": None,
    "sampled at every step": {"sample_time": STEP},
    "delayed by a sample": {"sample_time": STEP, "delay": STEP},
    "with all imperfections": {"sample_time": STEP, "delay": STEP, **IMPERFECT},
}


def compared(name: str, law: Any, chain: hf.ClosedChain, state: hf.State) -> None:
    """Print the rate of each way's sweep, and its share of that of the unsampled law: the median of all rounds."""
    laws = {way: law if how is None else hf.control.sampled(law, chain, **how) for way, how in WAYS.items()}
    times: dict[str, list[float]] = {way: [] for way in laws}
    for _ in range(ROUNDS + 1):
        for way, one in laws.items():
            with tempfile.TemporaryDirectory() as folder:
                plan: Any = {"parameters": {"object_mass": hf.sweeps.Uniform(2.0, 4.0), "object_inertia": "scale"}}
                begin = time.process_time()
                sweep = hf.sweep(
                    chain, one, state=state, count=RUNS, duration=STEPS * STEP, step=STEP, store=folder, **plan
                )
                times[way].append(time.process_time() - begin)
                assert sweep.status_counts == {"RUNNING": RUNS}
    for way, found in times.items():
        shares = [a / b for a, b in zip(times["not sampled"][1:], found[1:], strict=True)]  # the first one compiles
        rate = RUNS * STEPS / statistics.median(found[1:])
        print(f"{name:16} {way:24} {rate:9.0f} system-steps/s  {100 * statistics.median(shares):4.0f} %", flush=True)


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    chain, state = two_fingers()
    hold, home = hf.holding_torques(chain, state, internal_force=40.0), state.q
    springs = hf.ControlLaw(lambda t, now, memory, given: (hold + 100.0 * (home - now.q) - 10.0 * now.qd, memory))
    rest = hf.control.RestToRest(state.object_frame, displacement=[0, 0, 0.05], turn=np.zeros(3), begin=0.0, duration=1)
    tracking = hf.control.ObjectTracking(chain, rest.at, internal_force=40.0)
    compared("joint springs", springs, chain, state)
    compared("object tracking", tracking, chain, state)
