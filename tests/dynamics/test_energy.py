"""Energy and momentum against the oracle's sums and differences."""

import numpy as np
import pytest

from holdfast import forward_dynamics
from holdfast.dynamics import centre_of_mass, kinetic_energy, momentum, potential_energy, power
from holdfast.dynamics.energy import bodies
from tests.dynamics.problems import later
from tests.oracles import stepping
from tests.oracles.arithmetic import arithmetic
from tests.oracles.arm_kinematics import MovingFrame, link_frames
from tests.systems.problems import random_case, random_problem, relative_gap

seeds = pytest.mark.parametrize("seed", range(4))
OPTIONS = {"moving_base": True, "gravity": (1.0, -2.0, -9.0)}


def drawn(seed: int):
    """Return case and problem of a random chain."""
    return random_case(seed, **OPTIONS), random_problem(seed, **OPTIONS)


def points(case: dict):
    """Yield mass, rotation, inertia, mass centre, its velocity and omega of every body, by plain kinematics."""
    held = MovingFrame(*(np.array(case["object"][key]) for key in ("R", "p", "omega", "v", "omega", "v")))
    every = [(case["object"], held)]
    for arm in case["arms"]:
        every += zip(arm["links"], link_frames(arm, arithmetic(None)), strict=True)
    for body, frame in every:
        com = np.array(body["com"])
        inertia = frame.R @ np.array(body["inertia"]) @ frame.R.T
        yield body["mass"], inertia, frame.point(com), frame.point_velocity(com), frame.omega


@seeds
def test_kinetic_energy(seed):
    """Links, rotors and object: the oracle's sum."""
    case, p = drawn(seed)
    assert kinetic_energy(p.chain, p.state, p.inputs) == pytest.approx(stepping.kinetic_energy(case), rel=1e-13)


@seeds
def test_potential_energy_and_mass_centre(seed):
    """U = -sum m g.r, and the mass centre is where all weight acts."""
    case, p = drawn(seed)
    mass = sum(m for m, *_ in points(case))
    centre = sum(m * r for m, _, r, *_ in points(case)) / mass
    np.testing.assert_allclose(centre_of_mass(p.chain, p.state), centre, atol=1e-13)
    assert potential_energy(p.chain, p.state) == pytest.approx(-mass * centre @ case["gravity"], rel=1e-12)


@seeds
def test_momentum(seed):
    """Sum of m v and of I w + r x m v about any point."""
    case, p = drawn(seed)
    about = np.array([0.3, -1.0, 2.0])
    expected = sum(np.r_[I @ w + np.cross(r - about, m * v), m * v] for m, I, r, v, w in points(case))
    assert relative_gap(momentum(p.chain, p.state, about, p.inputs), expected) < 1e-12
    at_origin = momentum(p.chain, p.state, inputs=p.inputs)
    np.testing.assert_allclose(at_origin[3:], expected[3:], rtol=1e-12, atol=1e-12)
    assert relative_gap(at_origin[:3], expected[:3] + np.cross(about, expected[3:])) < 1e-12


@seeds
def test_momentum_moves_the_mass_centre(seed):
    """Linear momentum is total mass times the mass centre's velocity; -dU/dt is gravity's power."""
    _, p = drawn(seed)
    h = 1e-6
    ahead, behind = later(p, h), later(p, -h)
    mass = sum(body.inertia.m for body in bodies(p.chain, p.state))
    velocity = (centre_of_mass(*ahead) - centre_of_mass(*behind)) / (2 * h)
    linear = momentum(p.chain, p.state, inputs=p.inputs)[3:]
    np.testing.assert_allclose(mass * velocity, linear, atol=1e-6 * mass)
    falling = (potential_energy(*ahead) - potential_energy(*behind)) / (2 * h)
    assert falling == pytest.approx(-linear @ p.chain.gravity, rel=1e-6, abs=1e-5 * mass)


def test_still_and_free():
    """Without inputs, bases and wrenches have no power; every body is listed once, the object last."""
    p = random_problem(3, extras=False, moving_base=False)
    result = forward_dynamics(p.chain, p.state, p.tau)
    found = power(p.chain, p.state, p.tau, result)
    assert (found.damping, found.base, found.external) == (0.0, 0.0, 0.0)
    listed = list(bodies(p.chain, p.state))
    assert len(listed) == p.chain.joint_count + 1
    np.testing.assert_array_equal(listed[-1].origin, p.state.object_pose[4:])
