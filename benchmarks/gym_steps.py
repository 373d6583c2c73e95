"""What a vector environment costs beside the rollout it runs on: carrying a box with two Pandas, in control steps a second.

Both take the same steps of the same law with the same payloads, pushes and actions, new ones every control step; the
environment besides looks, rewards, ends and begins episodes. Their turns alternate, so that a busy machine slows both.

Run it with HOLDFAST_COMPILE unset, on a quiet machine: `python benchmarks/gym_steps.py`.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import holdfast as hf

TURN, ROUNDS = 100, 9  # control steps of a turn: an episode


def seconds(call: Callable[[Any], Any], actions: Any) -> float:
    """Return the process time of a turn [s]."""
    begin = time.process_time()
    for action in actions:
        call(action)
    return time.process_time() - begin


def compared(name: str, envs: hf.gym.CarryVector | hf.gym.HandOverVector, scale: float) -> None:
    """Print steps a second of a vector environment and of its rollout, and their ratio."""
    count, task, generator = envs.num_envs, envs.task, np.random.default_rng(0)
    envs.reset(seed=0)
    rollout, systems = task.phases[0].rollout, envs.episodes.systems[0].copy()
    resets = 0

    def bare(action: Any) -> None:
        rollout.step(systems, task.step, steps=task.steps_per_action, action=task.commanded(action), least_margin=0.0)

    def environment(action: Any) -> None:
        nonlocal resets
        *_, terminated, truncated, _ = envs.step(action)
        resets += int((terminated | truncated).sum())

    ratios, rates = [], []
    for turn in range(ROUNDS + 1):
        actions = scale * generator.uniform(-1.0, 1.0, (TURN, count, task.action_size))
        of_rollout, of_environment = seconds(bare, actions), seconds(environment, actions)
        if turn:  # the first compiles
            ratios.append(of_rollout / of_environment)
            rates.append((TURN * count / of_rollout, TURN * count / of_environment))
    by_rollout, by_environment = (statistics.median(rate) for rate in zip(*rates, strict=True))
    print(
        f"{name}, {count} environments: rollout {by_rollout:,.0f}/s, environment {by_environment:,.0f}/s control steps,"
        f" ratio {statistics.median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f}), {resets} resets"
    )


def main() -> None:
    """Print a line for each task and number of environments."""
    for count in (64, 256, 1024):
        compared("carry", hf.gym.CarryVector(count, autoreset_mode="SameStep"), 0.3)
    compared("hand-over", hf.gym.HandOverVector(256, autoreset_mode="SameStep"), 0.3)


if __name__ == "__main__":
    sys.exit(main())
