"""The order of the arms is a matter of layout only."""

import numpy as np
import pytest

from holdfast import METHODS
from tests.dynamics.problems import random_problem, relative_gap
from tests.laws.systems import mixed, reordered, sample, solved

TOLERANCE = 1e-10


def assert_same_arm_by_arm(a, b) -> None:
    """Assert that two results agree under the arms' names."""
    for name in a.chain.names:
        for key, expected in vars(a[name]).items():
            assert relative_gap(getattr(b[name], key), expected) < TOLERANCE, (name, key)
    assert relative_gap(b.object_acceleration, a.object_acceleration) < TOLERANCE
    assert (a.rank, a.mobility) == (b.rank, b.mobility)


@pytest.mark.parametrize("make", [sample, mixed])
@pytest.mark.parametrize("seed", range(12))
def test_order_of_arms(make, seed):
    """Arms in another order: the answer is permuted, every arm keeps its own."""
    p, result = make(seed)
    names = list(np.random.default_rng(seed).permutation(p.chain.names))
    assert_same_arm_by_arm(result, solved(reordered(p, names)))


@pytest.mark.parametrize("method", METHODS)
def test_order_of_arms_by_every_method(method):
    """The same for every algorithm, three rigid grasps."""
    p = random_problem(3, grasps="rigid", joints=(7, 6, 8), moving_base=True)
    result = solved(p, method=method)
    assert_same_arm_by_arm(result, solved(reordered(p, ["arm3", "arm1", "arm2"]), method=method))
