"""The rate of momentum from the wrenches that act from outside, against exact derivatives of momentum."""

import numpy as np
import pytest

from holdfast import StateError, forward_dynamics, momentum
from holdfast.dynamics.momentum_balance import momentum_rate
from holdfast.spatial.spatial_vector import shift_wrench
from tests.dynamics.problems import random_problem
from tests.laws.moving import moving
from tests.laws.systems import mixed, sample
from tests.spatial.dual import slopes_of

ABOUT = np.array([0.3, -1.0, 2.0])


@pytest.mark.parametrize("make", [sample, mixed])
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("about", [None, ABOUT])
def test_rate(make, seed, about):
    """d/dt of `momentum` along the motion, bases moving, everything on, about any point."""
    p, result = make(seed)
    chain, state, inputs = moving(p, result)
    expected = slopes_of(momentum(chain, state, about, inputs))
    found = momentum_rate(p.chain, p.state, result, about, p.inputs)
    by_bases = [shift_wrench(arm.base.p, f) for arm, f in zip(p.chain.arms.values(), result.base_wrench, strict=True)]
    size = np.abs(by_bases).sum(axis=0).max() + np.abs(expected).max()
    assert np.abs(found - expected).max() <= 1e-11 * size
    assert np.abs(expected).max() > 1e-2


def test_free_fall():
    """Nothing but weights: the linear rate is the weight, the angular one its moment about the mass centre: none."""
    p = random_problem(1, grasps=(None,), joints=(6,), moving_base=False, extras=False, gravity=(0.0, 0.0, -9.81))
    result = forward_dynamics(p.chain, p.state, p.tau)
    held, links = p.chain.held_object.mass, sum(link.mass for link in p.chain.arms["arm1"].links)
    found = momentum_rate(p.chain, p.state, result)
    np.testing.assert_allclose(found[3:] - result.base_wrench[0, 3:], [0, 0, -9.81 * (held + links)], rtol=1e-13)
    with pytest.raises(StateError, match=r"about: expected shape \(3,\)"):
        momentum_rate(p.chain, p.state, result, np.zeros(2))
