"""The power balance: what drives, weights, bases and loads put in is the rate of the kinetic energy."""

import numpy as np
import pytest

from holdfast import power
from holdfast.dynamics.energy import bodies
from tests.laws.moving import moving
from tests.laws.systems import sample
from tests.spatial.dual import Dual

TOLERANCE = 1e-11  # of the sum of absolute terms


def kinetic_energy_rate(p, result) -> tuple[float, float]:
    """Return dT/dt over links, rotors and object by exact derivatives, and the sum of absolute parts."""
    parts = [0.5 * (b.twist @ b.inertia.apply(b.twist)) for b in bodies(*moving(p, result))]
    armature = np.concatenate([arm.armature for arm in p.chain.arms.values()])
    rates = [part.slope for part in parts if isinstance(part, Dual)]
    rates += list(armature * p.state.qd * result.qdd)
    return sum(rates), sum(map(abs, rates))


@pytest.mark.parametrize("seed", range(60))
def test_power_balance(seed):
    """sum tau.qd + sum m g.v + base and external power - damping loss = dT/dt, everything on."""
    p, result = sample(seed)
    rate, size = kinetic_energy_rate(p, result)
    supplied = power(p.chain, p.state, p.tau, result, p.inputs)
    weights = []
    for body in bodies(p.chain, p.state, p.inputs):
        momentum = body.R @ (body.inertia.m * body.twist[3:] + np.cross(body.twist[:3], body.inertia.h))
        weights.append(p.chain.gravity @ momentum)
    size += sum(map(abs, supplied)) + sum(map(abs, weights))
    assert abs(supplied.total + sum(weights) - rate) <= TOLERANCE * size


def test_everything_is_on():
    """The systems that balance have every kind of power: none of the terms is always zero."""
    terms = np.abs([power(p.chain, p.state, p.tau, r, p.inputs) for p, r in map(sample, range(60))])
    assert (terms.max(axis=0) > 1).all()
    kinds = {grasp.kind for p, _ in map(sample, range(60)) for grasp in p.chain.grasps.values()}
    assert kinds == {"rigid", "hinge", "softfinger", "ball"}


@pytest.mark.parametrize("seed", range(60))
def test_grasps_have_no_power(seed):
    """Contact forces work on the object as much as against the arms: sum f.(V- - V+) = 0 (a.7)."""
    p, result = sample(seed)
    net = 0.0
    size = 0.0
    twists = list(bodies(p.chain, p.state, p.inputs))
    w, v = p.state.object_twist[:3], p.state.object_twist[3:]
    for name, grasp in p.chain.grasps.items():
        f = result[name].grasp_wrench
        last = twists[p.chain.joints[name].stop - 1]
        tip = last.R @ (last.twist[3:] + np.cross(last.twist[:3], p.chain.arms[name].tip.p))
        offset = p.state.object_frame.R @ grasp.frame.p
        on_object = f[:3] @ w + f[3:] @ (v + np.cross(w, offset))
        on_arm = -(f[:3] @ (last.R @ last.twist[:3]) + f[3:] @ tip)
        net += on_object + on_arm
        size += abs(on_object) + abs(on_arm)
    assert abs(net) <= 1e-12 * size
