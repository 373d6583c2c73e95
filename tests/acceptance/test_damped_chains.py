"""A thousand damped chains, d h / I from 0.1 to 1e4: no false slip, every run right."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.simulation.damped import outcome, problem

FAMILIES = 20
BATCH = 250

pytestmark = pytest.mark.long


@pytest.mark.parametrize("batch", range(4))
def test_a_thousand_damped_chains(batch):
    """One or two arms of three to seven joints, all grasps, by rk4 and midpoint, against dop853 or finer steps."""
    begin = time.perf_counter()
    seeds = range(batch * BATCH, (batch + 1) * BATCH)
    found = [outcome(problem(seed, FAMILIES), "midpoint" if seed // FAMILIES % 5 == 0 else "rk4") for seed in seeds]
    stopped = [one.stopped for one in found if one.stopped is not None]
    sides = [[one for one in found if one.implicit is implicit] for implicit in (False, True)]
    worst = np.array([[max(getattr(one, name) for one in side) for name in ("position", "velocity")] for side in sides])
    print(
        f"\n{len(found)} damped chains, h lambda {min(one.ratio for one in found):.2g} to"
        f" {max(one.ratio for one in found):.2g}: {len(sides[0])} by explicit steps (right to {worst[0, 0]:.1e} rad or"
        f" m, velocities {worst[0, 1]:.1e}), {len(sides[1])} by implicit ones (to {worst[1, 0]:.1e}, {worst[1, 1]:.1e});"
        f" {len(stopped)} stopped; {time.perf_counter() - begin:.0f} s",
        end="",
    )
    assert not stopped, stopped[:3]
    assert worst.max() <= 1e-3
    assert max(one.ratio for one in sides[0]) <= 0.9 * 2.7853
    assert min(one.ratio for one in sides[1]) > 1.8
