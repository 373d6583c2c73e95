"""Momentum changes by external wrenches, base wrenches and weights only."""

import numpy as np
import pytest

from holdfast import momentum
from holdfast.dynamics.energy import bodies
from holdfast.spatial.spatial_vector import shift_wrench
from tests.laws.moving import moving
from tests.laws.systems import mixed, sample
from tests.spatial.dual import slopes_of

TOLERANCE = 1e-11  # of the sum of absolute terms


def outside(p, result) -> list[np.ndarray]:
    """Return every wrench that acts from outside, about the world's origin."""
    chain, given = p.chain, p.inputs.shaped(p.chain)
    *links, held = bodies(chain, p.state, given)
    wrenches = [shift_wrench(arm.base.p, f) for arm, f in zip(chain.arms.values(), result.base_wrench, strict=True)]
    wrenches.append(shift_wrench(held.origin, given.object_wrench))
    wrenches += [shift_wrench(body.origin, f) for body, f in zip(links, given.link_wrenches, strict=True)]
    for body in (*links, held):
        weight = body.inertia.m * chain.gravity
        centre = body.R @ body.inertia.h / body.inertia.m + body.origin
        wrenches.append(np.r_[np.cross(centre, weight), weight])
    return wrenches


@pytest.mark.parametrize("make", [sample, mixed])
@pytest.mark.parametrize("seed", range(20))
def test_momentum_balance(make, seed):
    """d/dt [angular; linear] momentum = sum of base wrenches, external wrenches and weights."""
    p, result = make(seed)
    chain, state, inputs = moving(p, result)
    rate = slopes_of(momentum(chain, state, inputs=inputs))
    wrenches = outside(p, result)
    size = np.abs(wrenches).sum(axis=0).max()
    assert np.abs(rate - np.sum(wrenches, axis=0)).max() <= TOLERANCE * size


@pytest.mark.parametrize("seed", range(10))
def test_object_by_itself(seed):
    """The object's momentum about C changes by the grasp wrenches, its load and its weight."""
    p, result = mixed(seed)
    chain, state, inputs = moving(p, result)
    *_, held = bodies(chain, state, inputs)
    *_, now = bodies(p.chain, p.state, p.inputs)
    spin = held.R @ held.inertia.apply(held.twist)[:3]
    push = held.R @ held.inertia.apply(held.twist)[3:]
    weight = now.inertia.m * p.chain.gravity
    wrenches = [p.inputs.object_wrench, np.r_[np.cross(now.R @ now.inertia.h / now.inertia.m, weight), weight]]
    for name, grasp in p.chain.grasps.items():
        wrenches.append(shift_wrench(now.R @ grasp.frame.p, result[name].grasp_wrench))
    # C moves: dL_C/dt = moment about C - v_C x m v_com
    drift = np.cross(p.state.object_twist[3:], now.R @ now.inertia.apply(now.twist)[3:])
    rate = np.r_[slopes_of(spin) + drift, slopes_of(push)]
    size = np.abs(wrenches).sum(axis=0).max() + np.abs(drift).max()
    assert np.abs(rate - np.sum(wrenches, axis=0)).max() <= TOLERANCE * size
