"""Torque schedules, piece by piece, and where a step must end; torques clipped to effort limits."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import holdfast as hf
from holdfast import State
from holdfast.control import GravityCompensation, clipped
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.errors import ModelError
from holdfast.simulation.simulate import simulate
from holdfast.simulation.stepper import ReferenceStepper
from tests.simulation.gantries import LINK, squeezed

NOWHERE = State([0.0], [0.0], [1, 0, 0, 0, 0, 0, 0])
ASKED = np.array([0.0, 0.0, 60.0, 0.0, 0.0, 20.0])


def torque(schedule, t):
    return schedule(t, NOWHERE, None)[0]


def test_values():
    """Zero before the first knot, the piece's polynomial after it; the last piece goes on."""
    schedule = TorqueSchedule([0.5, 1.0], [[[1.0, 2.0, 3.0]], [[-1.0]]])
    assert torque(schedule, np.nextafter(0.5, 0)) == [0.0]
    assert torque(schedule, 0.5) == [1.0]
    assert torque(schedule, 0.7) == pytest.approx([1 + 2 * 0.2 + 3 * 0.04])
    assert torque(schedule, 1.0) == [-1.0]
    assert torque(schedule, 9.0) == [-1.0]


def test_linear():
    """Straight lines through the torques given."""
    schedule = TorqueSchedule.linear([0.0, 1.0, 3.0], [[0.0, 1.0], [2.0, 1.0], [0.0, 0.0]])
    assert torque(schedule, 0.25) == pytest.approx([0.5, 1.0])
    assert torque(schedule, 2.0) == pytest.approx([1.0, 0.5])
    assert torque(schedule, 5.0).tolist() == [0.0, 0.0]
    assert schedule.breakpoints.tolist() == [0.0, 1.0, 3.0]


def test_breakpoints_hold_knots_and_turning_points():
    """Between two breakpoints every torque rises or falls all the way."""
    rng = np.random.default_rng(4)
    knots = np.array([0.0, 0.4, 1.1])
    schedule = TorqueSchedule(knots, rng.normal(size=(3, 2, 6)) * 10.0 ** np.arange(6))
    points = np.r_[schedule.breakpoints[schedule.breakpoints < 2.0], 2.0]
    assert set(knots) <= set(points)
    assert len(points) > 6
    for begin, end in pairwise(points):
        inside = np.linspace(begin, end, 50)[1:-1]
        slopes = np.diff([torque(schedule, t) for t in inside], axis=0)
        assert (np.sign(slopes) == np.sign(slopes[0])).all()


def test_beside_another_controller():
    """Its torques and its breakpoints are added, its memory goes through, and it hears of other grasps."""

    class Other:
        breakpoints = (0.25,)

        def __init__(self, constant=1.0):
            self.constant = constant

        def __call__(self, t, state, memory):
            return np.array([self.constant]), (memory or 0) + 1

        def for_chain(self, chain):
            return Other(7.0)

    schedule = TorqueSchedule([0.0], [[[2.0]]], Other())
    assert schedule(0.1, NOWHERE, 4) == (np.array([3.0]), 5)
    assert schedule.breakpoints.tolist() == [0.0, 0.25]
    chain, _ = squeezed((None, None))
    assert torque(schedule.for_chain(chain), 0.1) == [9.0]


def test_steps_end_at_knots():
    """A force that jumps at knots off the grid gives the velocity that it should, exactly, by one big step each."""
    chain, state = squeezed((None, None))
    knots, forces = [0.0, 0.037, 0.061], [3.0, -8.0, 1.0]
    schedule = TorqueSchedule(knots, [[[f]] + 5 * [[0.0]] for f in forces])
    run = simulate(chain, state, schedule, 0.1, 0.1)
    expected = np.dot(forces, np.diff([*knots, 0.1])) / LINK
    assert run.qd[-1, 0] == pytest.approx(expected, rel=1e-14)
    assert len(run) == 2 + 2 * 2
    assert run.tau[:, 0].tolist() == [3.0, 3.0, -8.0, -8.0, 1.0, 1.0]
    assert np.abs(run.imbalance).max() < 1e-15


@pytest.mark.parametrize(
    ("knots", "coefficients", "message"),
    [
        ([], [], "knots: expected increasing times"),
        ([0.0, 0.0], [[[1.0]], [[1.0]]], "knots: expected increasing times"),
        ([0.0, 1.0], [[[1.0]]], "one table of coefficients per knot, got 1 for 2"),
        ([0.0, 1.0], [[[1.0]], [[1.0], [2.0]]], "expected tables of (n, degree + 1)"),
        ([0.0], [[[np.nan]]], "coefficients: expected finite numbers"),
        ([0.0], [np.zeros((1, 0))], "expected tables"),
    ],
)
def test_bad_schedules(knots, coefficients, message):
    """What is no schedule is refused by name."""
    with pytest.raises(ModelError) as caught:
        TorqueSchedule(knots, coefficients)
    assert message in str(caught.value)


def limited():
    """Return a gantry whose drives push with 33 N at most."""
    return squeezed((None, None), effort_limit=33.0)


def lift(t, state, memory):
    """Push one slide with more than it can, the other with what comes to more later."""
    return ASKED * (1.0 + 20.0 * t), memory


@pytest.mark.slow
def test_as_if_asked_for_less():
    """A run under clipped torques is one under the torques that the drives give; the margin says where."""
    chain, state = limited()
    run = hf.simulate(chain, state, lift, 0.1, 1e-3, on_limit="clip")
    assert run.stopped is None and not run.occurrences
    assert np.abs(run.tau).max() == 33.0
    given = hf.simulate(chain, state, lambda t, s, m: (np.clip(lift(t, s, m)[0], -33.0, 33.0), m), 0.1, 1e-3)
    assert np.array_equal(run.q, given.q) or np.allclose(run.q, given.q, atol=1e-13)
    assert run.lowest_joint_margin[:, 2].min() == 0.0
    asked = hf.simulate(chain, state, lift, 0.1, 1e-3)
    assert any(one.quantity == "effort" for one in asked.occurrences)
    assert np.abs(asked.q[-1] - run.q[-1]).max() > 1e-3


@pytest.mark.slow
def test_laws_and_rollouts():
    """A law is clipped in machine code; a rollout takes it as any other."""
    chain, state = limited()
    law = hf.ControlLaw(lambda t, s, memory, given: (ASKED * (1.0 + 20.0 * t), memory))
    options = {"duration": 0.05, "step": 1e-3, "on_limit": "clip"}
    run = hf.simulate(chain, state, law, **options)
    reference = hf.simulate(chain, state, law, make_stepper=ReferenceStepper, **options)
    assert run.q == pytest.approx(reference.q, abs=1e-13)
    rollout = hf.compile_rollout(chain, clipped(law, chain))
    systems = rollout.start(state.q, state.qd, state.object_pose, state.object_twist)
    rollout.step(systems, 1e-3, steps=50)
    assert systems.q[0] == pytest.approx(run.q[-1], abs=1e-12)
    assert systems.tau[0, 2] == 33.0


def test_controllers_that_follow_the_grasps():
    """What a controller says of itself goes through: traceable, breakpoints, another chain."""
    chain, _ = squeezed(("ball", "ball"), effort_limit=33.0)
    kept = clipped(GravityCompensation(chain, internal_force=5.0), chain)
    other = replace(chain, grasps={"left": chain.grasps["left"]})
    assert kept.traceable and kept.breakpoints == ()
    assert kept.for_chain(other).controller.chain is other
    assert clipped(lift, chain).for_chain(other).controller is lift


def test_shapes_are_still_looked_at():
    """Torques of another length are refused by name."""
    chain, state = limited()
    with pytest.raises(hf.errors.StateError, match="controller: torques"):
        hf.simulate(chain, state, lambda t, s, m: (np.zeros(3), m), 0.1, 1e-3, on_limit="clip")
