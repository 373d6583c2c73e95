"""Accelerations and forces are affine in what drives and loads the chain, and the response is reciprocal."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Inputs, State, forward_dynamics
from tests.laws.systems import mixed, sample
from tests.systems.problems import ANSWERS, random_problem, relative_gap

TOLERANCE = 1e-10


def answers(result) -> dict[str, np.ndarray]:
    """Return the quantities of a result by name."""
    return {name: getattr(result, name) for name in ANSWERS}


def driven(p, tau=None, **inputs):
    """Return the problem with other torques or inputs."""
    return replace(p, tau=p.tau if tau is None else tau, inputs=replace(p.inputs, **inputs))


@pytest.mark.parametrize("make", [sample, mixed])
@pytest.mark.parametrize("seed", range(6))
def test_superposition(make, seed):
    """x(tau1 + tau2) - x(tau2) = x(tau1) - x(0), for every quantity x."""
    p, _ = make(seed)
    one, two = 20 * np.random.default_rng(seed).normal(size=(2, len(p.tau)))
    x = [answers(driven(p, tau).solved()) for tau in (one + two, two, one, 0 * one)]
    for name in x[0]:
        size = max(np.abs(part[name]).max(initial=0.0) for part in x)
        assert np.abs(x[0][name] - x[1][name] - x[2][name] + x[3][name]).max(initial=0.0) <= TOLERANCE * size


@pytest.mark.parametrize("seed", range(4))
def test_loads_add_up(seed):
    """Torques, object and link wrenches and base accelerations each add their own part."""
    p, result = mixed(seed)
    rng = np.random.default_rng(seed)
    inputs = p.inputs.shaped(p.chain)
    linear = [key for key, x in vars(inputs).items() if x is not None and key != "base_twists"]
    changes = {key: rng.normal(size=getattr(inputs, key).shape) for key in linear}
    parts = [driven(p, p.tau + 1.0), *(driven(p, **{k: getattr(inputs, k) + d}) for k, d in changes.items())]
    together = driven(p, p.tau + 1.0, **{k: getattr(inputs, k) + d for k, d in changes.items()})
    whole, base = answers(together.solved()), answers(result)
    for name, start in base.items():
        total = start + sum(answers(part.solved())[name] - start for part in parts)
        assert np.abs(whole[name] - total).max() < TOLERANCE * np.abs(total).max() * 10


@pytest.mark.parametrize("seed", range(4))
def test_reciprocity(seed):
    """d qdd_i / d tau_j = d qdd_j / d tau_i, and driving a joint never moves it backwards."""
    p = random_problem(seed, grasps=("hinge", "ball", "rigid"), joints=(5, 6, 7))
    rest = State(p.state.q, 0 * p.state.qd, p.state.object_pose)
    bare = replace(p.chain, gravity=np.zeros(3))
    columns = [forward_dynamics(bare, rest, unit).qdd for unit in np.eye(len(p.tau))]
    response = np.array(columns).T
    assert relative_gap(response, response.T) < 1e-10
    assert np.linalg.eigvalsh(response)[0] > -1e-10 * np.abs(response).max()


@pytest.mark.parametrize("make", [sample, mixed])
@pytest.mark.parametrize("seed", range(6))
def test_reversed_time(make, seed):
    """Velocities enter squared: all reversed, without damping, the accelerations are the same."""
    p, _ = make(seed)
    smooth = {
        name: replace(arm, joints=[replace(joint, damping=0.0) for joint in arm.joints])
        for name, arm in p.chain.arms.items()
    }
    given, state = p.inputs.shaped(p.chain), p.state
    ahead = replace(p, chain=replace(p.chain, arms=smooth))
    back = replace(
        ahead,
        state=State(state.q, -state.qd, state.object_pose, -state.object_twist),
        inputs=Inputs(given.object_wrench, given.link_wrenches, -given.base_twists, given.base_accelerations),
    )
    forth, returned = answers(ahead.solved()), answers(back.solved())
    for name, expected in forth.items():
        assert relative_gap(returned[name], expected) < TOLERANCE
