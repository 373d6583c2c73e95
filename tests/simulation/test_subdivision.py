"""Steps that are too long for the motion are taken in parts; the others are left alone."""

import numpy as np
import pytest

from holdfast import ClosureError, ModelError, simulate
from holdfast.simulation.runge_kutta import MIDPOINT, RK4
from holdfast.simulation.stepper import MOST_SUBSTEPS, SubdividingStepper
from tests.simulation.problems import PROBLEMS
from tests.simulation.runs import differences, limp, numbers, stepper_of

LIMIT = 1e-10


def counting(t, state, memory):
    """No torques, and how often the memory has moved on."""
    return np.zeros(len(state.q)), 1 if memory is None else memory + 1


def moving(scheme=RK4, controller=limp):
    """Return a stepper of three arms with balls in brisk motion, and where it is."""
    return stepper_of(*PROBLEMS["balls"](), scheme, controller=controller)


def test_calm_steps_are_left_alone():
    """A step within the limit is the whole stepper's, to the bit."""
    whole, now = moving()
    (alone,), (found,) = whole.advance(now, [1e-4]), SubdividingStepper(whole, LIMIT).advance(now, [1e-4])
    assert alone.gaps.position[0] < LIMIT
    assert found.gaps.position[0] == alone.gaps.position[0]
    np.testing.assert_array_equal(numbers(found.instant.state), numbers(alone.instant.state))


@pytest.mark.parametrize(
    ("scheme", "step"),
    [pytest.param(RK4, 0.02, id="rk4"), pytest.param(MIDPOINT, 0.005, id="midpoint", marks=pytest.mark.long)],
)
def test_long_steps_are_parted(scheme, step):
    """Its end is that of as many steps as its drift asks for; work and the worst gaps are those of all of them."""
    whole, now = moving(scheme)
    (alone,) = whole.advance(now, [step])
    parts = int(np.ceil((alone.gaps.position[0] / LIMIT) ** (1 / (scheme.order + 1))))
    assert 1 < parts < MOST_SUBSTEPS
    at, work, drift = now, np.zeros(4), 0.0
    for k in range(1, parts + 1):
        (part,) = whole.advance(at, [k / parts * step])
        at, work, drift = part.instant, work + part.work, max(drift, part.gaps.position[0])
    (found,) = SubdividingStepper(whole, LIMIT).advance(now, [step])
    assert found.t == step
    np.testing.assert_allclose(numbers(found.instant.state), numbers(at.state), rtol=0, atol=1e-14)
    assert found.work == pytest.approx(work, abs=1e-15)
    assert found.gaps.position[0] == pytest.approx(drift, abs=1e-15)
    assert drift < 3 * LIMIT
    exact = stepper_of(*PROBLEMS["balls"]())[0]
    for k in range(20):
        now = exact.advance(now, [(k + 1) / 20 * step])[0].instant
    before, after = (differences(one.instant.state, now.state).max() for one in (alone, found))
    assert after < 0.1 * before


def test_memory_moves_on_once():
    """Parts are not steps to the controller."""
    whole, now = moving(controller=counting)
    assert now.memory == 1
    (found,) = SubdividingStepper(whole, LIMIT).advance(now, [0.02])
    assert found.instant.memory == 2


def test_what_cannot_be_closed_whole():
    """A step that leaves the grasps too far open is refused whole, and taken in parts."""
    whole, now = moving()
    (alone,) = whole.advance(now, [0.5])
    assert isinstance(alone.failure, ClosureError)
    (found,) = SubdividingStepper(whole, LIMIT).advance(now, [0.5])
    assert found.failure is None
    assert found.gaps.position[1] < 1e-13
    (hopeless,) = SubdividingStepper(whole, LIMIT).advance(now, [50.0])
    assert hopeless.instant is None and hopeless.failure is not None


def test_in_a_run():
    """`simulate` takes steps in parts where `largest_drift` asks for it."""
    chain, state = PROBLEMS["balls"]()
    ways = ({}, {"largest_drift": LIMIT}, {"largest_drift": 1e-12})
    drifts = [simulate(chain, state, limp, 0.02, 0.02, **way).position_gap[-1, 0] for way in ways]
    assert drifts[2] < 1e-11 < drifts[1] < 3 * LIMIT < drifts[0]
    with pytest.raises(ModelError, match="simulation: largest_drift: expected > 0, got 0"):
        simulate(chain, state, limp, 0.02, 0.02, largest_drift=0.0)
