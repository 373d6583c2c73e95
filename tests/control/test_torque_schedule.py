"""Torque schedules: the polynomials, piece by piece, and where a step must end."""

from itertools import pairwise

import numpy as np
import pytest

from holdfast import ModelError, State
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.simulation.simulate import simulate
from tests.simulation.gantries import LINK, squeezed

NOWHERE = State([0.0], [0.0], [1, 0, 0, 0, 0, 0, 0])


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
