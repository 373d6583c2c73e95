"""Everything that is compiled is the reference's on 200 random chains: moving bases, link wrenches, all grasp kinds."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from holdfast import forward_dynamics
from tests.acceptance.comparison import disagreement
from tests.compiled.problems import answer
from tests.compiled.test_functions import BOUND, EVERY
from tests.compiled.test_functions import disagreement as of_function
from tests.systems import well_conditioned_system
from tests.systems.as_chain import Problem, as_chain

pytestmark = pytest.mark.long

KINDS = ("rigid", "hinge", "softfinger", "ball")
CHUNKS, EACH = 10, 20


def problem(seed: int) -> Problem:
    """Return one to four arms of three to seven joints, every kind of grasp, one arm in six without one."""
    random = np.random.default_rng((seed, 12))
    count = int(random.integers(1, 5))
    grasps = [None if k == 5 else KINDS[k % 4] for k in random.integers(0, 6, count)]
    grasps[0] = KINDS[seed % 4]
    joints = random.integers(3, 8, count).tolist()
    return as_chain(well_conditioned_system(seed, joints=joints, grasps=grasps, moving_base=True))


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_two_hundred_chains(chunk):
    """All functions, each to 1e-11 of max(1, size)."""
    worst, met = dict.fromkeys(["forward_dynamics", *EVERY], 0.0), Counter()
    for seed in range(chunk * EACH, (chunk + 1) * EACH):
        p = problem(seed)
        met.update(grasp.kind for grasp in p.chain.grasps.values())
        assert p.inputs.link_wrenches is not None and p.inputs.base_twists is not None
        expected = forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs)
        worst["forward_dynamics"] = max(worst["forward_dynamics"], disagreement(answer(p), expected))
        for function in EVERY:
            worst[function] = max(worst[function], of_function(p, function, seed))
    print(f"\n{EACH} chains with {dict(met)}: " + ", ".join(f"{name} {x:.1e}" for name, x in worst.items()))
    assert max(worst.values()) <= BOUND
    assert set(met) == set(KINDS)
