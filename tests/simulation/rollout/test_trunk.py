"""Machine code of steps with a trunk: rollouts and runs take the reference's steps."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from holdfast import Attach, ControlLaw, Inputs, StateError, compile_rollout, simulate
from holdfast.dynamics import momentum, project_velocity
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.compiled_steppers import FusedStepper, StagewiseStepper, stepper_for
from holdfast.simulation.runge_kutta import MIDPOINT
from holdfast.simulation.stepper import ReferenceStepper
from tests.compiler.programs import same_bits
from tests.simulation.rollout.problems import arrays, difference, elsewhere, generic_rank, numbers
from tests.systems.as_chain import Problem
from tests.systems.trunk_runs import still_base

STEP = 1e-3


def problem(floating: bool, **options: Any) -> Problem:
    """Return two arms on a trunk of two joints."""
    arms = {"arms": 2, "joints": 7, "grasps": ("rigid", "ball")} | options
    return still_base(3, 2, floating=floating, arms=arms, in_world=0.0)


def leaning(joint_count: int) -> ControlLaw:
    """Return torques that depend on where a floating base is, and on its velocity."""
    size = np.random.default_rng(2).normal(size=joint_count)
    return ControlLaw(lambda t, s, m, given: (size * (s.base_pose[4] - s.base_twist[1]) - s.qd, m), key="lean")


@pytest.mark.slow
@pytest.mark.parametrize("fused", [True, False])
def test_steppers(fused):
    """Whole steps of machine code, and steps whose controller is asked from Python, are the reference's."""
    p = problem(True)
    chain, law, rank = p.chain, leaning(p.chain.joint_count), generic_rank(p.chain, p.state)

    def asked(t, state, memory):
        return law.torque(t, state, None, {})[0], memory

    environment = Environment(chain, inputs=Inputs(object_wrench=np.arange(6.0)))
    controller = law if fused else asked
    stepper = stepper_for(environment, controller, rank, MIDPOINT, Tolerance(), 1000)
    assert isinstance(stepper, FusedStepper if fused else StagewiseStepper)
    found, expected = (
        one.advance(one.start(0.0, p.state, None)[0], [0.004, 0.01])
        for one in (stepper, ReferenceStepper(environment, asked, rank, MIDPOINT))
    )
    for one, other in zip(found, expected, strict=True):
        mine, theirs = numbers(one.instant), numbers(other.instant)
        mine["memory"] = theirs["memory"] = np.zeros(0)
        assert difference(mine, theirs) <= 1e-12


@pytest.mark.slow
def test_bits_and_travel():
    """Threads, the number of systems, and a way through a pickle change no bit."""
    p = problem(True)
    law = ControlLaw(leaning(p.chain.joint_count).torque)
    rollout = compile_rollout(p.chain, law, scheme="midpoint")
    many = rollout.start(**elsewhere(p.chain, p.state, 5))
    one = rollout.start(**arrays(many.state(3)))
    again = rollout.start(**elsewhere(p.chain, p.state, 5))
    other, there = pickle.loads(pickle.dumps((rollout, many)))
    rollout.step(many, STEP, steps=3)
    rollout.step(again, STEP, steps=3, threads=2)
    other.step(there, STEP, steps=3)
    rollout.step(one, STEP, steps=3)
    for key, x in many.arrays.items():
        assert same_bits(x, again.arrays[key]) and same_bits(x, there.arrays[key]), key
    assert many.floating_pose[3] == pytest.approx(one.floating_pose[0], abs=1e-15)


@pytest.mark.slow
def test_a_grip_in_flight():
    """Systems taken over by a rollout with one more grasp: as `Attach`, without loss of momentum."""
    p = problem(True, gravity=(0.0, 0.0, 0.0), grasps="rigid")
    name = p.chain.names[1]
    open_chain = p.chain.without_grasp(name)
    law = leaning(p.chain.joint_count)
    before, after = (compile_rollout(chain, law, scheme="midpoint") for chain in (open_chain, p.chain))
    moving = replace(p.state, qd=p.state.qd + 1e-6 * np.arange(p.chain.joint_count))
    systems = before.start(**arrays(project_velocity(open_chain, moving)))
    gripped = after.take_over(systems)
    assert gripped.running.all()
    run = simulate(
        open_chain, systems.state(0), law, 2e-3, 1e-3, events=[Attach(1e-3, name, p.chain.grasps[name], here=True)],
        make_stepper=ReferenceStepper,
    )  # fmt: skip
    assert run.holding[-1].all()
    size = np.abs(momentum(open_chain, systems.state(0))).max()
    assert np.abs(momentum(p.chain, gripped.state(0)) - momentum(open_chain, systems.state(0))).max() < 1e-13 * size


def test_states_of_the_base():
    """A floating base's pose and velocity are asked for, and refused where there is none."""
    free, fixed = problem(True), problem(False)
    rollout, given = compile_rollout(free.chain, scheme="midpoint"), arrays(free.state)
    with pytest.raises(StateError, match="floating_pose: expected that of the trunk's floating base, got none"):
        rollout.start(**{name: x for name, x in given.items() if not name.startswith("floating")})
    rollout = compile_rollout(fixed.chain, scheme="midpoint")
    with pytest.raises(StateError, match="floating_twist: expected none, as the chain has no floating base"):
        rollout.start(**arrays(fixed.state), floating_twist=np.zeros(6))
