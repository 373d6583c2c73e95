"""All algorithms that apply give the same answer on many random systems."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from holdfast.dynamics import METHODS
from holdfast.errors import MethodNotApplicable
from tests.acceptance.comparison import disagreement
from tests.longer import mostly_slow
from tests.systems import random_system, scaled_condition
from tests.systems.as_chain import as_chain
from tests.systems.random_parts import KINDS

# how many systems with so many arms, so that every kind of grasp meets every arm count 50 times
FULL = {1: 240, 2: 220, 3: 160, 4: 130, 5: 120, 6: 100, 7: 100, 8: 100}
CONDITION = 1e4
TOLERANCE = 1e-10


def grasps_for(index: int, arm_count: int) -> list[str]:
    """Return grasp kinds: every third system all rigid (most methods ask for it), the rest mixed."""
    if arm_count == 1:
        return [KINDS[index % 4]]
    if index % 3 == 0:
        return ["rigid"] * arm_count
    return np.random.default_rng((index, arm_count)).choice(KINDS, arm_count).tolist()


def agreement(arm_count: int, systems: int) -> tuple[float, Counter[str], int, Counter[str]]:
    """Return the worst disagreement, how often each kind was met, draws made, answers per method."""
    worst, met, answers, draws = 0.0, Counter(), Counter(), 0
    for index in range(systems):
        grasps = grasps_for(index, arm_count)
        while True:
            case = random_system(1_000_000 * arm_count + draws, arms=arm_count, grasps=grasps)
            draws += 1
            if scaled_condition(case) < CONDITION:
                break
        problem = as_chain(case)
        met.update(set(grasps))
        reference = problem.solved()
        answers["sequential"] += 1
        for route in ("recursive", "mass_matrix"):
            worst = max(worst, disagreement(problem.solved(route=route), reference))
        for method in METHODS:
            try:
                other = problem.solved(method=method)
            except MethodNotApplicable:
                continue
            answers[method] += 1
            worst = max(worst, disagreement(other, reference))
    return worst, met, draws, answers


@pytest.mark.parametrize("arm_count", mostly_slow([1, 2, 4], [1, 2]))
def test_methods_agree_on_a_few_systems(arm_count):
    """Every applicable method agrees to 1e-10, on a sample small enough for every run."""
    worst, _, _, answers = agreement(arm_count, 9)
    assert worst <= TOLERANCE
    assert answers["rccfd2"] >= 2
    assert answers["kkt"] >= 6


@pytest.mark.long
@pytest.mark.parametrize("arm_count", list(FULL))
def test_methods_agree_on_a_thousand_systems(arm_count):
    """Every applicable method agrees to 1e-10 on 1,170 random systems of scaled condition < 1e4."""
    systems = FULL[arm_count]
    worst, met, draws, answers = agreement(arm_count, systems)
    print(
        f"\n{arm_count} arms: {systems} systems, accepted {systems / draws:.0%} of {draws} draws, worst disagreement"
        f" {worst:.1e}; systems with each grasp {dict(met)}; answers per method {dict(answers)}"
    )
    assert worst <= TOLERANCE
    assert min(met[kind] for kind in KINDS) >= 50
