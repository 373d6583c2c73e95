"""`condition`: one number wherever it is asked for, without units, the inverse square of the way to a singularity."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import holdfast
from holdfast import METHODS, ClosedChain, MethodNotApplicable, State, Status, diagnose, forward_dynamics
from holdfast.dynamics.arm.posture import posture
from holdfast.dynamics.rank import constraint_rank
from tests.dynamics.problems import CASES, stored
from tests.dynamics.rescaled import rescaled
from tests.systems import planar_parallelogram, two_collinear_stretched_6r
from tests.systems.as_chain import Problem, as_chain

ORDINARY = 100.0
STATE = ("q", "qd", "object_pose", "object_twist")


def bent(p: Problem, bend: float) -> tuple[ClosedChain, State]:
    """Return the chain with its joints bent at random and its bases moved so that the grasps still hold."""
    q = p.state.q + bend * np.random.default_rng(0).normal(size=len(p.state.q))
    bases = {}
    for name, arm in p.chain.arms.items():
        contact = p.state.object_frame @ p.chain.grasps[name].frame
        bases[name] = contact @ posture(arm, q[p.chain.joints[name]]).tip.inverse() @ arm.base
    return p.chain.with_bases(bases), State(q, 0.0 * q, p.state.object_pose)


def condition_at(chain: ClosedChain, state: State) -> float:
    """Return the condition as forward dynamics has it, of the configuration at rest."""
    still, tau = State(state.q, 0.0 * state.qd, state.object_pose), np.zeros(chain.joint_count)
    return forward_dynamics(chain, still, tau, generic_rank=constraint_rank(chain, still)).condition


@pytest.mark.parametrize("name", ["rigid_2arm_fast", "mixed_2arm_fast"])
def test_the_same_wherever_it_is_asked_for(name):
    """Diagnosis, every method of forward dynamics and machine code, alone and in a batch."""
    p = stored(name)
    expected = diagnose(p.chain, p.state).condition
    for method in METHODS:
        try:
            found = forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs, method=method)
        except MethodNotApplicable:
            continue
        assert found.condition == pytest.approx(expected, rel=1e-9), method
    fast = holdfast.compile(p.chain)
    given: dict[str, Any] = {name: getattr(p.state, name) for name in STATE} | {"tau": p.tau}
    assert fast.forward_dynamics(**given).condition == pytest.approx(expected, rel=1e-9)
    three: dict[str, Any] = {name: np.tile(x, (3, 1)) for name, x in given.items()}
    batch = fast.forward_dynamics(**three)
    np.testing.assert_allclose(batch.condition, expected, rtol=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_ordinary_postures_are_moderate(name):
    """Of 42 systems with up to 16 arms, of every kind, none comes near the thresholds of the singularity meter."""
    p = stored(name)
    assert 1.0 <= condition_at(p.chain, p.state) < ORDINARY


@pytest.mark.parametrize("lightness", [1e-6, 1e-3])
@pytest.mark.parametrize("name", ["rigid_2arm_7R_gravity", "rigid_5arm_9link", "softfinger_3arm"])
def test_a_light_object_is_no_singularity(name, lightness):
    """An object of a gram between arms of kilograms: as regular as one of a kilogram."""
    p = stored(name)
    body = p.chain.held_object
    light = replace(body, mass=lightness * body.mass, inertia=lightness * body.inertia)
    assert condition_at(replace(p.chain, held_object=light), p.state) < ORDINARY


@pytest.mark.parametrize(("length", "mass"), [(1e3, 1.0), (1.0, 1e3), (1e-3, 1e3)])
@pytest.mark.parametrize("make", [lambda: stored("mixed_4arm_all_types"), lambda: as_chain(planar_parallelogram(0.03))])
def test_no_units(make, length, mass):
    """Millimetres for metres, grams for kilograms."""
    p = make()
    other, _ = rescaled(p, length, mass)
    assert condition_at(other.chain, other.state) == pytest.approx(condition_at(p.chain, p.state), rel=1e-8)


def test_flattening_parallelogram():
    """It grows at every step, as 1 / angle^2, and is infinite when the cranks lie flat."""
    angles = np.geomspace(0.5, 1e-4, 25).tolist()
    chains = [as_chain(planar_parallelogram(angle)) for angle in angles]
    found = np.array([condition_at(p.chain, p.state) for p in chains])
    assert (np.diff(found) > 0.0).all()
    assert np.log(found[-1] / found[-9]) / np.log(angles[-9] / angles[-1]) == pytest.approx(2.0, abs=0.02)
    flat = as_chain(planar_parallelogram(0.0))
    assert diagnose(flat.chain, flat.state).condition == np.inf
    states: dict[str, Any] = {name: np.tile(getattr(flat.state, name), (2, 1)) for name in STATE}
    result = holdfast.compile(flat.chain).forward_dynamics(**states, tau=np.zeros((2, 4)))
    assert result.status.tolist() == [Status.SINGULAR] * 2
    assert result.condition.tolist() == [np.inf] * 2


@pytest.mark.parametrize("opposed", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_two_arms_that_stretch_along_one_line(seed, opposed):
    """As 1 / bend^2, over five orders of magnitude of it."""
    p = as_chain(two_collinear_stretched_6r(seed, opposed))
    bends = np.geomspace(0.1, 1e-4, 13)
    found = np.array([condition_at(*bent(p, bend)) for bend in bends])
    assert (np.diff(found) > 0.0).all()
    assert np.diff(np.log(found)) / -np.diff(np.log(bends)) == pytest.approx(2.0, abs=0.5)
    assert np.log(found[-1] / found[-5]) / np.log(bends[-5] / bends[-1]) == pytest.approx(2.0, abs=0.02)
