"""Momentum changes by external wrenches, base wrenches and weights only."""

import numpy as np
import pytest

from holdfast import forward_dynamics
from holdfast.dynamics import momentum
from holdfast.dynamics.energy import bodies
from holdfast.dynamics.momentum_balance import momentum_rate
from holdfast.errors import StateError
from holdfast.spatial.spatial_vector import shift_wrench
from tests.laws.moving import moving
from tests.laws.systems import mixed, sample
from tests.spatial.dual import slopes_of
from tests.systems.problems import random_problem

TOLERANCE = 1e-11  # of the sum of absolute terms


@pytest.mark.parametrize("make", [sample, mixed])
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("about", [None, np.array([0.3, -1.0, 2.0])], ids=["origin", "point"])
def test_momentum_balance(make, seed, about):
    """d/dt [angular; linear] momentum about any point = sum of base wrenches, external wrenches and weights."""
    p, result = make(seed)
    chain, state, inputs = moving(p, result)
    expected = slopes_of(momentum(chain, state, about, inputs))
    found = momentum_rate(p.chain, p.state, result, about, p.inputs)
    by_bases = [shift_wrench(arm.base.p, f) for arm, f in zip(p.chain.arms.values(), result.base_wrench, strict=True)]
    size = np.abs(by_bases).sum(axis=0).max() + np.abs(expected).max()
    assert np.abs(found - expected).max() <= TOLERANCE * size
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


@pytest.mark.parametrize("seed", range(6))
def test_object_by_itself(seed):
    """The object's momentum about C changes by the grasp wrenches, its load and its weight."""
    p, result = mixed(seed)
    *_, held = bodies(*moving(p, result))
    *_, now = bodies(p.chain, p.state, p.inputs)
    rate = slopes_of(np.concatenate([held.R @ part for part in np.split(held.inertia.apply(held.twist), 2)]))
    weight = now.inertia.m * p.chain.gravity
    wrenches = [p.inputs.object_wrench, np.r_[np.cross(now.R @ now.inertia.h / now.inertia.m, weight), weight]]
    for name, grasp in p.chain.grasps.items():
        wrenches.append(shift_wrench(now.R @ grasp.frame.p, result[name].grasp_wrench))
    # C moves: dL_C/dt = moment about C - v_C x m v_com
    drift = np.cross(p.state.object_twist[3:], now.R @ now.inertia.apply(now.twist)[3:])
    size = np.abs(wrenches).sum(axis=0).max() + np.abs(drift).max()
    assert np.abs(rate + np.r_[drift, np.zeros(3)] - np.sum(wrenches, axis=0)).max() <= TOLERANCE * size
