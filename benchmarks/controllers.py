"""What a step of `simulate` costs besides its controller: two Pandas with all their limits that hold a box, at 1 kHz.

Run it with HOLDFAST_COMPILE unset, on a quiet machine: `python benchmarks/controllers.py`.
"""

from __future__ import annotations

import functools
import sys
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import holdfast as hf
from benchmarks.bench.clock import least_time
from benchmarks.bench.systems import facing_pandas
from holdfast.control import ObjectTracking, RestToRest, compile_law, holding_law

STEP, STEPS, FEW, ROUNDS = 1e-3, 500, 100, 3


class Timed:
    """A law, and the process time that was spent in it."""

    def __init__(self, law: Callable[..., Any]) -> None:
        self.law, self.spent, self.calls = law, 0.0, 0

    def __call__(self, t: float, state: hf.State, memory: Any) -> Any:
        """Return what the law returns."""
        begin = time.process_time()
        found = self.law(t, state, memory)
        self.spent += time.process_time() - begin
        self.calls += 1
        return found


def main() -> None:
    """Print milliseconds a step, of which the law's, and microseconds of compiled laws."""
    chain, state = facing_pandas()
    hold, limits = (
        hf.holding_torques(chain, state, internal_force=20.0),
        [joint.effort_limit for joint in chain.all_joints],
    )
    gains = np.minimum(200.0, 2.0 * np.array(limits))
    path = RestToRest(state.object_frame, displacement=[0, 0, 0.2], turn=[0, 0, 0.3], begin=0.0, duration=1.5)
    track = ObjectTracking(chain, path.at, internal_force=20.0)

    def saturated(t: float, now: hf.State, memory: Any) -> Any:
        return np.clip(hold - gains * (now.q - state.q) - 0.02 * gains * now.qd, limits_low, limits), memory

    def wrapped(t: float, now: hf.State, memory: Any) -> Any:
        return track(t, now, memory)

    limits_low = [-x for x in limits]
    print(f"{'controller':46} {'ms a step':>10} {'in the law':>11} {'our own':>8} {'calls a step':>13}")
    for name, law, steps, sample_time in (
        ("Python function, sampled at 1 kHz", saturated, STEPS, STEP),
        ("ObjectTracking in a function, sampled at 1 kHz", wrapped, STEPS, STEP),
        ("Python function, asked all along", saturated, FEW, None),
        ("ObjectTracking in a function, asked all along", wrapped, FEW, None),
        ("ObjectTracking itself, asked all along", track, STEPS, None),
    ):
        best = np.array([np.inf, 0.0, 0.0])
        for _ in range(ROUNDS):
            timed = law if law is track else Timed(law)
            begin = time.process_time()
            run = hf.simulate(chain, state, timed, steps * STEP, STEP, sample_time=sample_time)
            spent, calls = getattr(timed, "spent", 0.0), getattr(timed, "calls", 0)
            assert run.stopped is None
            best = min(best, np.array([time.process_time() - begin, spent, calls]) / steps, key=lambda one: one[0])
        whole, inside, calls = best * [1e3, 1e3, 1.0]
        print(f"{name:46} {whole:10.2f} {inside:11.3f} {whole - inside:8.2f} {calls:13.1f}")

    laws_of_arrays(chain, state, track)


def microseconds(call: Callable[[], Any], calls: int) -> float:
    """Return the least processor time of a call [us]."""
    return 1e6 * least_time(call, calls, ROUNDS)


def laws_of_arrays(chain: hf.ClosedChain, state: hf.State, track: ObjectTracking) -> None:
    """Print microseconds a system of compiled laws: a single call, bound, in a batch, and by the reference."""
    many, upward = 4096, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    q = np.repeat(np.array(state.q)[None], many, axis=0)
    rest = state.qd, state.object_pose, state.object_twist
    print(f"\n{'as machine code':16} {'us single':>10} {'bound':>6} {'in a batch':>11} {'reference':>10}")
    for name, law, given, reference in (
        ("ObjectTracking", track, {}, lambda: track(0.3, state, None)),
        (
            "holding_torques",
            holding_law(chain),
            {"acceleration": upward, "internal_force": 20.0},
            lambda: hf.holding_torques(chain, state, upward, 20.0),
        ),
    ):
        fast = compile_law(law, chain)
        bound = fast.bind(object_pose=state.object_pose, q=state.q, **given)
        single = microseconds(functools.partial(fast.torques, 0.3, state.q, *rest, **given), 2000)
        batch = microseconds(functools.partial(fast.torques, 0.3, q, *rest, **given, threads=1), 5) / many
        plain, slow = microseconds(bound, 2000), microseconds(reference, 20)
        print(f"{name:16} {single:10.2f} {plain:6.2f} {batch:11.2f} {slow:10.0f}")


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
