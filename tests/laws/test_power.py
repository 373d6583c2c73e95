"""The power balance: what drives, weights, bases and loads put in is the rate of the kinetic energy."""

import numpy as np
import pytest

from holdfast.dynamics import kinetic_energy, momentum, power
from holdfast.dynamics.energy import bodies
from holdfast.spatial.spatial_vector import shift_twist
from tests.dynamics.problems import motion_of
from tests.laws.moving import moving
from tests.laws.systems import sample
from tests.longer import mostly_slow

SEEDS = range(40)


@pytest.mark.parametrize("seed", mostly_slow(SEEDS, SEEDS[::2]))
def test_power_balance(seed):
    """sum tau.qd + sum m g.v + base and external power - damping loss = dT/dt, everything on."""
    p, result = sample(seed)
    rate = sum(getattr(b.kinetic_energy, "tangent", 0.0) for b in bodies(*moving(p, result)))
    rate += np.concatenate([arm.armature for arm in p.chain.arms.values()]) * p.state.qd @ result.qdd
    supplied = power(p.chain, p.state, p.tau, result, p.inputs)
    weights = momentum(p.chain, p.state, inputs=p.inputs)[3:] @ p.chain.gravity
    size = sum(map(abs, supplied)) + abs(weights) + kinetic_energy(p.chain, p.state, p.inputs)
    assert abs(supplied.total + weights - rate) <= 1e-11 * size
    assert supplied.drives == pytest.approx(p.tau @ p.state.qd, rel=1e-13)
    assert supplied.damping <= 0
    assert supplied.total == sum(supplied)


def test_everything_is_on():
    """The systems that balance have every kind of power: none of the terms is always zero."""
    terms = np.abs([power(p.chain, p.state, p.tau, r, p.inputs) for p, r in map(sample, SEEDS)])
    assert (terms.max(axis=0) > 1).all()
    kinds = {grasp.kind for p, _ in map(sample, SEEDS) for grasp in p.chain.grasps.values()}
    assert kinds == {"rigid", "hinge", "softfinger", "ball"}


@pytest.mark.parametrize("seed", SEEDS)
def test_grasps_have_no_power(seed):
    """Contact forces work on the object as much as against the arms: sum f.(V- - V+) = 0 (a.7)."""
    p, result = sample(seed)
    motion, powers = motion_of(p), []
    for name, arm, contact in zip(p.chain.grasps, motion.holding, motion.contacts, strict=True):
        on_object = result[name].grasp_wrench @ shift_twist(contact.offset, p.state.object_twist)
        powers += [on_object, -result[name].grasp_wrench @ arm.tip_twist]
    assert abs(sum(powers)) <= 1e-12 * np.abs(powers).sum()
