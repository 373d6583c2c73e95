"""A thousand damped chains, d h / I from 0.1 to 1e4: no slip, each run right or refused with a step that works."""

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
    """One or two arms of three to seven joints, all grasps; against steps of a quarter, one in ten against dop853."""
    begin = time.perf_counter()
    seeds = range(batch * BATCH, (batch + 1) * BATCH)
    found = [
        outcome(problem(seed, FAMILIES), "midpoint" if seed // FAMILIES % 5 == 0 else "rk4", seed % 10 == 0)
        for seed in seeds
    ]
    refused = [one for one in found if one.refused]
    accepted = [one for one in found if not one.refused]
    stopped = [one.stopped for one in found if one.stopped is not None]
    worst = np.array([[max(getattr(one, name) for one in some) for name in ("position", "velocity")]
                      for some in (refused, accepted)])  # fmt: skip
    print(
        f"\n{len(found)} damped chains, h lambda {min(one.ratio for one in found):.2g} to"
        f" {max(one.ratio for one in found):.2g}: {len(accepted)} right at their step (to {worst[1, 0]:.1e} rad or m,"
        f" velocities {worst[1, 1]:.1e}), {len(refused)} refused, right at the suggested one (to {worst[0, 0]:.1e},"
        f" {worst[0, 1]:.1e}); {len(stopped)} stopped; {time.perf_counter() - begin:.0f} s",
        end="",
    )
    assert not stopped, stopped[:3]
    assert worst.max() <= 1e-3
    assert max(one.ratio for one in accepted) <= 0.9 * 2.7853
    assert min(one.ratio for one in refused) > 1.8
