"""Chains with springs between world, links and object: every pair of bodies, damped and not, one of no length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast import ClosedChain, Spring


def with_springs(chain: ClosedChain, seed: int = 0, *, damped: bool = True) -> ClosedChain:
    """Return the chain with springs between all kinds of bodies, of random ends and sizes.

    Args:
        chain: a chain of two arms or more, each of two links or more.
        seed: of the numbers.
        damped: with dampers.
    """
    rng, (first, second) = np.random.default_rng(seed), list(chain.arms)[:2]
    last = chain.arms[first].joint_count - 1
    pairs = [
        (("world",), ("object",)),
        (("world",), (first, last)),
        (("object",), (second, 0)),
        ((first, 1), (second, 1)),
        ((first, 0), (first, last)),
        (("object",), ("world",)),
    ]
    springs = [
        Spring((*a, rng.normal(size=3)), (*b, 0.3 * rng.normal(size=3)), k, length, c if damped else 0.0)
        for (a, b), k, length, c in zip(
            pairs, rng.uniform(20, 80, 6), [*rng.uniform(0.1, 0.9, 5), 0.0], rng.uniform(0.2, 2.0, 6), strict=True
        )
    ]
    return replace(chain, springs=springs)
