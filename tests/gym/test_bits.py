"""A vector environment is that many single ones, to the bit, in every autoreset mode."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import holdfast as hf
from tests.capabilities.chains import CHAINS, chain_with
from tests.gym.problems import careless_hand_over, short_carry

CARRY = hf.gym.Carry, hf.gym.CarryVector
HAND_OVER = hf.gym.HandOver, hf.gym.HandOverVector


def require_same(one: Any, other: Any, place: str = "") -> None:
    """Require the same structure, types and bits."""
    assert type(one) is type(other), place
    if isinstance(one, dict):
        assert one.keys() == other.keys(), place
        for name, x in one.items():
            require_same(x, other[name], f"{place}/{name}")
    elif isinstance(one, tuple):
        for k, (x, y) in enumerate(zip(one, other, strict=True)):
            require_same(x, y, f"{place}/{k}")
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape) == (other.dtype, other.shape), place
        if one.dtype == object:
            for x, y in zip(one, other, strict=True):
                require_same(x, y, place)
        else:
            assert one.tobytes() == other.tobytes(), place
    else:
        assert one == other, place


def walk_together(kinds: Any, task: Any, mode: AutoresetMode, count: int, steps: int, threads: int = 1) -> Any:
    """Take random steps with both; return how many episodes ended, and the last infos of those that did."""
    single, vector = kinds
    apart = SyncVectorEnv([lambda: single(task)] * count, autoreset_mode=mode)
    together = vector(count, task, autoreset_mode=mode, threads=threads)
    require_same(apart.reset(seed=5), together.reset(seed=5))
    generator, ended, statuses = np.random.default_rng(2), 0, set()
    for step in range(steps):
        actions = generator.uniform(-1.0, 1.0, together.action_space.shape)
        found = together.step(actions)
        require_same(apart.step(actions), found, f"step {step}")
        over = found[2] | found[3]
        ended += int(over.sum())
        infos = found[4].get("final_info", found[4])
        statuses |= {(infos["status"][k], bool(found[3][k])) for k in np.flatnonzero(over)}
        if mode is AutoresetMode.DISABLED and over.any():
            require_same(apart.reset(options={"reset_mask": over}), together.reset(options={"reset_mask": over}))
    return ended, statuses


@pytest.mark.slow
@pytest.mark.parametrize("mode", AutoresetMode)
def test_carry(mode):
    """Over a hundred steps in which episodes slip, and last their time."""
    ended, statuses = walk_together(CARRY, short_carry(), mode, 5, 100)
    assert ended > 20
    assert {("SLIPPED", False), ("RUNNING", True)} <= statuses


@pytest.mark.slow
@pytest.mark.parametrize("mode", AutoresetMode)
def test_hand_over(mode):
    """Over a hundred steps through all phases: episodes of one batch are in several of them."""
    ended, statuses = walk_together(HAND_OVER, careless_hand_over(), mode, 5, 100)
    assert ended > 5
    assert {truncated for _, truncated in statuses} == {True, False}


@pytest.mark.slow
def test_threads():
    """No bit depends on how many threads share the environments."""
    ended, _ = walk_together(CARRY, short_carry(), AutoresetMode.SAME_STEP, 17, 20, threads=3)
    assert ended > 0


SAMPLING = {"sample_time": 4e-3, "delay": 2e-3, "noise": {"q": 1e-4, "tau": 0.3}, "seed": 4}


@pytest.mark.slow
@pytest.mark.parametrize("kind", [CARRY, HAND_OVER], ids=["carry", "hand-over"])
def test_sampled(kind):
    """With a control law that is sampled, late and noisy: the noise belongs to the episode."""
    short = {"sampling": SAMPLING, "steps_per_action": 4, "duration": 0.2}
    task = replace(short_carry() if kind is CARRY else careless_hand_over(), **short)
    ended, _ = walk_together(kind, task, AutoresetMode.SAME_STEP, 4, 60)
    assert ended > 2


@pytest.mark.long
@pytest.mark.parametrize("kind", [CARRY, HAND_OVER], ids=["carry", "hand-over"])
@pytest.mark.parametrize("mode", AutoresetMode)
def test_many(kind, mode):
    """Over 600 steps of 20 environments."""
    task = short_carry() if kind is CARRY else careless_hand_over()
    ended, _ = walk_together(kind, task, mode, 20, 600)
    assert ended > 500 if kind is CARRY else ended > 100


@pytest.mark.long
@pytest.mark.parametrize("commands", ["object", "joint"])
@pytest.mark.parametrize("capability", CHAINS)
def test_every_kind_of_chain(capability, commands):
    """Any chain is an environment, with the same bits alone and among others; where forces are not unique too."""
    c = chain_with(capability)
    forces = {"largest_internal": 1e4, "crushing_internal": 1e5}
    task = hf.gym.CarryTask(c.chain, c.state, commands=commands, duration=0.1, settle=0.04, **forces)
    ended, _ = walk_together(CARRY, task, AutoresetMode.SAME_STEP, 3, 12)
    assert ended >= 3
