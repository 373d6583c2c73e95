"""One measure of the grasps' gaps, one projection: reference steps, machine code, rollouts, `closure`, `project`."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import closure
from holdfast.dynamics.projection import largest_gaps as largest_in_step
from holdfast.dynamics.projection import moved
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.compiled_steppers import FusedStepper, StagewiseStepper
from holdfast.simulation.runge_kutta import scheme
from holdfast.simulation.stepper import ReferenceStepper
from tests.dynamics.problems import random_problem
from tests.simulation.rollout.problems import arrays, difference, generic_rank, problem, swinging, swinging_law
from tests.systems.lower_pairs import JOINTS, grasp_of
from tests.systems.problems import largest_gaps

ROUNDING = 1e-12
KINDS = ("rigid", "hinge", "softfinger", "ball", *JOINTS)


def opened(chain: hf.ClosedChain, state: hf.State, size: float) -> hf.State:
    """Return a state whose grasps are open by about so much [m, rad; m/s, rad/s]."""
    random = np.random.default_rng(3)
    beside = moved(state, size * random.uniform(-1.0, 1.0, size=chain.joint_count + 6))
    twist = beside.object_twist + size * random.uniform(-1.0, 1.0, size=6)
    return hf.State(beside.q, beside.qd, beside.object_pose, twist)


@pytest.mark.parametrize("kind", KINDS)
def test_closure_and_steps_measure_the_same(kind):
    """Steps take sines of angles, t - t^3 / 6, where `closure` has angles; lengths and velocities are the same."""
    p = random_problem(4, grasps=("rigid", "rigid"), joints=(6, 6), moving_base=False, extras=False)
    name = p.chain.names[1]
    frame = p.chain.grasps[name].frame
    chain = p.chain.without_grasp(name).with_grasp(name, grasp_of(kind, frame))
    for size in (1e-6, 1e-4, 1e-2):
        state = opened(chain, p.state, size)
        expected, found = largest_gaps(closure(chain, state)), largest_in_step(chain, state, hf.Inputs().shaped(chain))
        assert expected.min() > 0.1 * size
        assert abs(found.position - expected[0]) <= expected[0] ** 3 + 1e-15
        assert found.velocity == pytest.approx(expected[1], rel=1e-12)


@pytest.mark.slow
def test_every_backend_reports_and_closes_the_same_gaps():
    """A state a tenth of a millimetre off its grasps: the gaps before, none after, and the same closed state."""
    chain, state = problem("five")
    loose, law, rank = opened(chain, state, 1e-4), swinging_law(chain.joint_count), generic_rank(chain, state)
    environment, rk4, tolerance = Environment(chain), scheme("rk4"), Tolerance(1e-6, 1e-9)
    expected, memory = largest_gaps(closure(chain, loose)), law.memory
    steppers = (
        ReferenceStepper(environment, law, rank, rk4),
        FusedStepper.of(environment, law, rk4, rank),
        StagewiseStepper(environment, law, rank, rk4, tolerance),
    )
    starts = [stepper.start(0.0, loose, memory) for stepper in steppers]
    systems = swinging("five").start(**{name: x[None] for name, x in arrays(loose).items()})
    before = [np.array([gaps.position[0], gaps.velocity[0]]) for _, gaps in starts] + [systems.drift[0]]
    after = [np.array([gaps.position[1], gaps.velocity[1]]) for _, gaps in starts] + [systems.gap[0]]
    for found in before:
        assert np.abs(found - before[0]).max() <= ROUNDING
        assert np.abs(found - expected).max() <= expected[0] ** 3 + ROUNDING
    assert np.max(after) <= ROUNDING

    closed = arrays(hf.project(chain, loose)[0])
    assert largest_gaps(closure(chain, hf.State(**closed))).max() <= ROUNDING
    compiled = hf.compile(chain).project(**arrays(loose))
    others = [arrays(instant.state) for instant, _ in starts] + [arrays(systems.state(0)), compiled]
    assert [difference(found, closed) <= ROUNDING for found in others] == [True] * len(others)
