"""What a vector environment costs beside the rollout it runs on: two Pandas carry a box, in control steps a second.

Both take the same control steps: same states, payloads, pushes and actions, new ones every time. The environment also
looks, rewards, ends and begins episodes, which are spread over their length, so that some end in every step. They take
turns step by step, so that a busy machine slows both, and process times are compared. One policy tracks the path, and
its episodes last their time; the other acts at random, and its episodes soon fail.

Run it with HOLDFAST_COMPILE unset, on a quiet machine: `python benchmarks/gym_steps.py`.
"""

from __future__ import annotations

import statistics
import sys
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from typing import Any

import numpy as np

import holdfast as hf

TURN, ROUNDS = 100, 9  # control steps of a round
Policy = Callable[[hf.gym.CarryTask, np.ndarray, np.random.Generator], np.ndarray]


def tracking(task: hf.gym.CarryTask, seen: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Return actions that follow the path: its acceleration, a spring and a damper."""
    alpha = seen[:, 12:18] + 100.0 * seen[:, :6] + 20.0 * seen[:, 6:12]
    return np.hstack([alpha / task.acceleration, np.zeros((len(seen), 1))])


def random(task: hf.gym.CarryTask, seen: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Return actions without sense."""
    return generator.uniform(-0.3, 0.3, (len(seen), task.action_size))


def compared(name: str, policy: Policy, count: int) -> None:
    """Print steps a second of a vector environment and of its rollout, and their ratio."""
    envs, generator = hf.gym.CarryVector(count, autoreset_mode="SameStep", threads=1), np.random.default_rng(0)
    task, (seen, _) = envs.task, envs.reset(seed=0)
    rollout, ends = task.phases[0].rollout, 0
    options: Any = {
        "steps": task.steps_per_action,
        "least_margin": 0.0,
        "stop_at_limits": task.stop_at_limits,
        "threads": 1,
    }
    ratios, rates = [], []
    envs.episodes.steps[...] = generator.integers(0, task.episode_steps, count)
    for turn in range(ROUNDS + 1):
        times = [0.0, 0.0]
        for _ in range(TURN):
            actions = np.ascontiguousarray(np.clip(policy(task, seen, generator), -1.0, 1.0))
            systems = envs.episodes.systems[0].copy()
            begin = time.process_time()
            rollout.step(systems, task.step, action=actions, **options)
            middle = time.process_time()
            seen, _, terminated, truncated, _ = envs.step(actions)
            times = [times[0] + middle - begin, times[1] + time.process_time() - middle]
            ends += int((terminated | truncated).sum())
        if turn:  # the first compiles
            ratios.append(times[0] / times[1])
            rates.append([TURN * count / t for t in times])
    by_rollout, by_environment = (statistics.median(rate) for rate in zip(*rates, strict=True))
    print(
        f"{name}, {count} environments: rollout {by_rollout:,.0f}/s, environment {by_environment:,.0f}/s control steps,"
        f" ratio {statistics.median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f}); {ends} episodes ended"
    )


def main() -> None:
    """Print a line for each policy and number of environments."""
    for count in (64, 256, 1024):
        compared("tracking", tracking, count)
        compared("random", random, count)


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    sys.exit(main())
