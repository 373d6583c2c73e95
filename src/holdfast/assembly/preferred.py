"""The posture every arm would like to be in, and others to begin a search from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.robots.recognise import home_of
from holdfast.spatial.scalar import Array

WIDEST = np.pi  # rad, or m: how far from 0 an unlimited joint is searched


def preferred_postures(chain: ClosedChain, given: Mapping[str, Any] | None) -> dict[str, Array]:
    """Return the preferred joint positions of every arm, by name.

    Given ones first; else a built-in robot's home posture; else the middle of the joint
    limits (0 where there are none).

    Raises:
        ModelError: a posture of an arm that is not there.
        StateError: a posture of the wrong length.
    """
    given = {} if given is None else given
    if not isinstance(given, Mapping):
        raise ModelError(f"q: expected joint positions by arm name, e.g. {{'left': [...]}}, got {type(given).__name__}")
    for name in given:
        if name not in chain.arms:
            raise ModelError(f"q: no arm '{name}'.{checks.did_you_mean(str(name), chain.arms)}")
    return {
        name: checks.numbers(given[name], (arm.joint_count,), f"q of '{name}'", StateError)
        if name in given
        else preferred_posture(arm)
        for name, arm in chain.arms.items()
    }


def starting_postures(arm: Arm, preferred: Array, count: int) -> Iterator[Array]:
    """Yield joint positions to search from: the preferred ones, then seeded ones farther and farther away."""
    low, high = _range(arm)
    yield np.clip(preferred, *arm.position_limits.T)
    random = np.random.default_rng(arm.joint_count)
    for spread in np.linspace(0.2, 1.0, count - 1):
        yield np.clip(preferred + spread * random.uniform(low - high, high - low) / 2, low, high)


def preferred_posture(arm: Arm) -> Array:
    """Return a built-in robot's home posture, or the middle of the joint limits (0 where there are none), (N,)."""
    home = home_of(arm)
    return np.mean(_range(arm), axis=0) if home is None else home


def _range(arm: Arm) -> tuple[Array, Array]:
    """Return lowest and highest positions; an unlimited end lies `WIDEST` beyond the other end, or beyond 0."""
    low, high = arm.position_limits.T
    bounded_low = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - 2 * WIDEST, -WIDEST))
    return bounded_low, np.where(np.isfinite(high), high, bounded_low + 2 * WIDEST)
