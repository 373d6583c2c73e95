"""Energies, momentum and power of chains with branches: balances, and numbers of serial chains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast import dynamics
from holdfast.dynamics.tree.mechanism_terms import chain_state, flat_rates, flat_state
from holdfast.dynamics.tree.varied_forest import displaced
from holdfast.errors import StateError
from tests.dynamics.tree.as_branched import AWAY, STRAY, gap, serial_problems, with_stray
from tests.systems.branched import branched_problems


def rate(chain, state, result, f, h=1e-5):
    """Return the rate of a function of the state along the motion of a result, by a central difference."""
    (q, qd), of_base = flat_state(chain, state), result.base_acceleration
    qdd = flat_rates(result.qdd, result.object_acceleration, of_base)

    def there(t):
        return f(chain_state(chain, displaced(chain.as_forest.forest, q, t * qd), qd + t * qdd))

    return (there(h) - there(-h)) / (2 * h)


@pytest.mark.parametrize("name", branched_problems())
def test_balances(name):
    """Rates of energy and momentum are the power, and what the accelerations of all bodies are."""
    chain, state, tau = branched_problems()[name]
    random = np.random.default_rng(0)
    count, links = len(chain.free_objects), sum(len(arm.links) for arm in chain.arms.values())
    wrench = random.normal(size=(6,) if count == 1 else (count, 6))
    inputs = hf.Inputs(wrench if count else None, link_wrenches=random.normal(size=(links, 6)))
    result = hf.forward_dynamics(chain, state, tau, inputs=inputs)
    power = dynamics.power(chain, state, tau, result, inputs)
    found = rate(
        chain, state, result, lambda s: dynamics.kinetic_energy(chain, s) + dynamics.potential_energy(chain, s)
    )
    assert gap(found, power.total) < 1e-7
    assert power.damping < 0.0 and power.base == 0.0
    about = [0.3, -0.2, 0.5]
    changed = rate(chain, state, result, lambda s: dynamics.momentum(chain, s, about))
    assert gap(dynamics.momentum_rate(chain, state, result, about, inputs), changed) < 1e-7
    moved = rate(chain, state, result, lambda s: dynamics.centre_of_mass(chain, s))
    mass = sum(body.link.mass for body in chain.forest.bodies)
    assert gap(mass * moved, dynamics.momentum(chain, state)[3:]) < 1e-7


def test_momentum_in_flight():
    """A flying trunk's momentum is changed by its weight and by wrenches on it alone."""
    chain, state, tau = branched_problems()["on a shoulder"]
    push = np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0])
    inputs = hf.Inputs(push)
    result = hf.forward_dynamics(chain, state, tau, inputs=inputs)
    found = dynamics.momentum_rate(chain, state, result, inputs=inputs)
    mass = sum(body.link.mass for body in chain.forest.bodies)
    weight, r = mass * chain.gravity, dynamics.centre_of_mass(chain, state)
    p = state.object_frame.p
    wanted = np.concatenate([np.cross(r, weight) + push[:3] + np.cross(p, push[3:]), weight + push[3:]])
    assert gap(found, wanted) < 1e-12


@pytest.mark.parametrize("name", serial_problems())
def test_as_serial_chains(name):
    """An object that falls beside a serial chain adds its own energy, momentum and power, and nothing else."""
    p = serial_problems()[name]
    push = np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0])
    chain, state, tau, inputs = with_stray(p, push)
    spin = np.array([0.3, 0.1, -0.2, 0.5, 0.4, 0.3])
    state = replace(state, object_twist=[p.state.object_twist, spin])
    own = 0.5 * spin[:3] @ STRAY.inertia @ spin[:3] + 0.5 * STRAY.mass * spin[3:] @ spin[3:]
    wanted = dynamics.kinetic_energy(p.chain, p.state, p.inputs) + own
    assert gap(dynamics.kinetic_energy(chain, state, inputs), wanted) < 1e-12
    wanted = dynamics.potential_energy(p.chain, p.state) - STRAY.mass * chain.gravity @ AWAY.p
    assert gap(dynamics.potential_energy(chain, state), wanted) < 1e-12
    linear = STRAY.mass * spin[3:]
    moment = np.concatenate([STRAY.inertia @ spin[:3] + np.cross(AWAY.p, linear), linear])
    wanted = dynamics.momentum(p.chain, p.state, inputs=p.inputs) + moment
    assert gap(dynamics.momentum(chain, state, inputs=inputs), wanted) < 1e-12
    result = hf.forward_dynamics(p.chain, p.state, tau, inputs=p.inputs, check=False)
    there = hf.forward_dynamics(chain, state, tau, inputs=inputs, check=False)
    weight = STRAY.mass * chain.gravity
    beside = np.concatenate([np.cross(AWAY.p, weight + push[3:]) + push[:3], weight + push[3:]])
    wanted = dynamics.momentum_rate(p.chain, p.state, result, inputs=p.inputs) + beside
    assert gap(dynamics.momentum_rate(chain, state, there, inputs=inputs), wanted) < 1e-8
    wanted = dynamics.power(p.chain, p.state, tau, result, p.inputs)
    found = dynamics.power(chain, state, tau, there, inputs)
    wanted = wanted._replace(external=wanted.external + push @ spin)
    assert gap(found, wanted) < 1e-9
    assert wanted.base != 0.0 or chain.floats


def test_a_loop_on_a_moving_base():
    """The power of a base that moves is what energy gains: through the joints and through a loop fixed to it."""
    p = branched_problems()["palletiser"]
    arm = p.chain.arms["robot"]
    twist, turn = [0.0, 0.0, 0.7, 0.4, -0.2, 0.3], hf.Pose.from_rpy(0.0, -np.pi / 2, 0.0).R
    stop = hf.Closure(None, "pillar", hf.Grasp("hinge", hf.Pose(turn, np.zeros(3))), hf.Pose(turn, [0.0, 0.0, 0.2]))
    chain = hf.ClosedChain({"robot": replace(arm, loops={**arm.loops, "stop": stop})})
    inputs = hf.Inputs(base_twists=[twist], base_accelerations=[[0.1, -0.2, 0.3, 0.4, 0.5, 0.6]])
    result = hf.forward_dynamics(chain, p.state, p.tau, inputs=inputs)
    power = dynamics.power(chain, p.state, p.tau, result, inputs)

    def energy(t):
        at = chain.with_bases({"robot": hf.Pose.from_rpy(0.0, 0.0, 0.7 * t, xyz=t * np.array(twist[3:]))})
        moved = replace(p.state, q=p.state.q + t * p.state.qd, qd=p.state.qd + t * result.qdd)
        there = hf.Inputs(base_twists=[np.array(twist) + t * np.array(inputs.base_accelerations[0])])
        return dynamics.kinetic_energy(at, moved, there) + dynamics.potential_energy(at, moved)

    assert gap((energy(1e-5) - energy(-1e-5)) / 2e-5, power.total) < 1e-7
    assert abs(power.base) > 1.0


def test_refusals():
    """A result of another kind of chain is refused."""
    p, q = serial_problems()["anchors"], branched_problems()["grippers"]
    with pytest.raises(StateError, match="result: expected MechanismResult"):
        dynamics.momentum_rate(q.chain, q.state, p.solved())
    with pytest.raises(StateError, match="result: expected ForwardResult"):
        dynamics.momentum_rate(p.chain, p.state, hf.forward_dynamics(*q))
    for ask in (dynamics.kinetic_energy, dynamics.potential_energy, dynamics.centre_of_mass, hf.diagnose):
        with pytest.raises(StateError, match="state: expected State"):
            ask(q.chain, q.state.q)
    with pytest.raises(StateError, match="state: expected State"):
        hf.control.GravityCompensation(q.chain)(0.0, q.state.q, None)
