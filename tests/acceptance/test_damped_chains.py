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
    explicit, implicit = (f"{len(side)}, right to {x:.1e} rad or m, {v:.1e} of velocities" for side, (x, v) in
                          zip(sides, worst, strict=True))  # fmt: skip
    ratios = [one.ratio for one in found]
    print(
        f"\n{len(found)} damped chains, h lambda {min(ratios):.2g} to {max(ratios):.2g}: by explicit steps {explicit};"
        f" by implicit ones {implicit}; {len(stopped)} stopped; {time.perf_counter() - begin:.0f} s",
        end="",
    )
    assert not stopped, stopped[:3]
    assert worst.max() <= 1e-3
    assert max(one.ratio for one in sides[0]) <= 0.9 * 2.7853
    assert min(one.ratio for one in sides[1]) > 1.8
