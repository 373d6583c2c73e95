"""Step-size control: what error is allowed, how steps grow and shrink; steps that drift too far are taken in parts."""

from dataclasses import dataclass, field
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from holdfast import HoldfastError, State, simulate
from holdfast.errors import ClosureError, ModelError, SingularChainError, StateError
from holdfast.simulation.adaptive import (
    Proposal,
    Tolerance,
    allowed_error,
    controlled,
    first_proposal,
    next_step,
    smallest_step,
)
from holdfast.simulation.runge_kutta import MIDPOINT, RK4, Tableau, dop853
from holdfast.simulation.stepper import MOST_SUBSTEPS, NO_GAPS, Advance, SubdividingStepper
from tests.simulation.problems import PROBLEMS
from tests.simulation.runs import adaptive, differences, limp, numbers, stepper_of
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain

ORDER = 8
BEFORE = State(np.array([0.0, 2.0]), np.array([0.0, -40.0]), np.array([1.0, 0, 0, 0, 0, 3.0, 0]), np.arange(6.0))
AFTER = State(np.array([0.0, -4.0]), np.array([0.5, 30.0]), np.array([1.0, 0, 0, 0, 5.0, 0, 0]), np.zeros(6))
LIMIT = 1e-10


def at(t) -> Any:
    """Return what the control looks at of an instant: its time."""
    return SimpleNamespace(t=t)


@dataclass
class Model:
    """A stepper whose error is (h / fitting)^8, or whose steps fail when they are longer than `sound`."""

    fitting: float = np.inf
    sound: float = np.inf
    failure: HoldfastError = field(default_factory=lambda: ClosureError("the grasps are open"))
    scheme: Tableau = field(default_factory=dop853)
    tried: list[tuple[float, float]] = field(default_factory=list)

    def start(self, t, state, memory):
        """Return nothing: the control does not ask for it."""
        raise NotImplementedError

    def evaluate(self, t, state, memory):
        """Return nothing: the control does not ask for it."""
        raise NotImplementedError

    def advance(self, now, ends):
        """Return what the model says of each step."""
        self.tried += [(now.t, end) for end in ends]
        return [self._to(end, end - now.t) for end in ends]

    def _to(self, end, step):
        if step > self.sound:
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=self.failure)
        return Advance(end, at(end), NO_GAPS, np.zeros(4), (step / self.fitting) ** ORDER)


def run(stepper, knots, proposal, now=0.0):
    """Return the times of the accepted steps through all knots."""
    times = [now]
    for knot in knots:
        while times[-1] < knot:
            reached, proposal = next_step(stepper, at(times[-1]), proposal, knot)
            times.append(reached.t)
    return times


@pytest.mark.parametrize("error", [0.0, 1e-300, 1e-9, 0.3, 1.0, 1.0000001, 7.0, 1e30, np.inf, np.nan])
@pytest.mark.parametrize("last", [1e-4, 1.0])
def test_controlled(error, last):
    """Accepted up to the tolerance; from a fifth to five times as long; shorter after a rejection."""
    accepted, longer = controlled(0.01, error, ORDER, last)
    assert accepted == (error <= 1.0)
    assert 0.002 <= longer <= 0.05
    if not accepted:
        assert longer <= 0.009


def test_larger_errors_never_lengthen():
    """The next step falls with the error, and with what the error has just risen from."""
    for last in (1e-4, 1.0):
        steps = [controlled(1.0, e, ORDER, last)[1] for e in np.geomspace(1e-12, 1.0, 50)]
        assert (np.diff(steps) <= 0).all()
    assert controlled(1.0, 0.5, ORDER, 1e-3)[1] < controlled(1.0, 0.5, ORDER, 0.5)[1]


@pytest.mark.parametrize("first", [1e-6, 1.0])
def test_settles(first):
    """From steps far too short or too long the control finds those that fit, and then rejects none."""
    stepper = Model(fitting=0.01)
    times = np.array(run(stepper, [1.0], Proposal(first)))
    assert times[-1] == 1.0
    late = np.diff(times)[25:-3]
    assert ((late > 0.65 * 0.01) & (late < 0.75 * 0.01)).all()
    assert len(stepper.tried) - len(times) + 1 <= 5


def test_knots_are_hit_and_cost_little():
    """Every knot is an end, exactly; a knot cuts the steps before it, not those after."""
    knots = [0.1, 0.1 + 1e-9, 1 / 3, 0.7, 1.0]
    times = run(Model(fitting=0.02), knots, Proposal(0.01))
    assert set(knots) <= set(times)
    assert (np.diff(times) > 0).all()
    free = run(Model(fitting=0.02), [1.0], Proposal(0.01))
    assert len(times) <= len(free) + 2 * len(knots)


def test_last_steps_share_what_is_left():
    """No sliver of a step is left before a knot."""
    times = run(Model(), [1.0], Proposal(0.99))
    assert times == [0.0, 0.5, 1.0]
    assert run(Model(), [1.0], Proposal(1.0 - 1e-12)) == [0.0, 1.0]


def test_failing_steps_are_shortened():
    """A step that cannot be closed is tried again, a fifth as long; then steps do not jump back at once."""
    stepper = Model(sound=0.01)
    reached, proposal = next_step(stepper, at(2.0), Proposal(0.3), 9.0)
    assert [end - t for t, end in stepper.tried] == pytest.approx([0.3, 0.06, 0.012, 0.0024])
    assert reached.t == pytest.approx(2.0024)
    assert proposal.step == pytest.approx(0.0024)


@pytest.mark.parametrize("failure", [SingularChainError("rank 8 of 12"), ClosureError("open"), StateError("nan")])
def test_no_way_on(failure):
    """Where every step fails, the failure is raised as what it is, with the time."""
    stepper = Model(sound=0.0, failure=failure)
    with pytest.raises(type(failure), match=f"no step leads on from t = 1.25 s, however short: {failure}"):
        next_step(stepper, at(1.25), Proposal(0.1), 2.0)
    assert len(stepper.tried) < 40
    assert min(end - t for t, end in stepper.tried) >= 0.9 * smallest_step(1.25)


@pytest.mark.parametrize(("fitting", "error"), [(1e-15, r"\S+ times the tolerance"), (np.nan, "beyond all numbers")])
def test_underflow(fitting, error):
    """An error that no step brings down is refused, naming the time and what it comes to."""
    stepper = Model(fitting=fitting)
    with pytest.raises(StateError, match=rf"from t = 0\.5 s: at \S+e-1[12] s the error is still {error};"):
        next_step(stepper, at(0.5), Proposal(0.1), 2.0)


@pytest.mark.parametrize(
    ("stepper", "latest", "message"),
    [
        (Model(scheme=RK4), 1.0, "scheme 'rk4' estimates no error; try 'dop853'"),
        (Model(), 0.0, "latest: expected a time after t = 0 s, got 0 s"),
        (Model(), np.nan, "latest: expected a time after"),
        (Model(), np.inf, "latest: expected a time after"),
    ],
)
def test_refused(stepper, latest, message):
    """A scheme without estimates and a time that is not ahead are refused."""
    with pytest.raises(ModelError, match=message.replace("(", r"\(")):
        next_step(stepper, at(0.0), Proposal(0.1), latest)


def swing(rtol, controller, knots=(0.08,)):
    """Return the instants of one arm that carries the object, through the knots."""
    p = as_chain(well_conditioned_system(3, arms=1, joints=3, grasps="rigid", moving_base=False, extras=False))
    stepper, now = stepper_of(p.chain, p.state, dop853(), rtol, controller=controller)
    found = [now]
    for knot in knots:
        found += list(adaptive(stepper, found[-1], knot))[1:]
    return found


@pytest.mark.slow
def test_tolerance_is_met():
    """A thousandth of the tolerance: a thousandth of the error, about, for few more steps."""
    runs = [swing(rtol, lambda t, s, m: (np.cos(9 * t) * np.ones(3), m), (0.12,)) for rtol in (1e-6, 1e-9, 1e-12)]
    exact = runs[-1][-1].state
    errors = [np.abs(r[-1].state.q - exact.q).max() for r in runs[:-1]]
    assert errors[0] < 1e-5 and errors[1] < 1e-8
    assert errors[1] < 0.02 * errors[0]
    assert len(runs[1]) < 4 * len(runs[0])


@pytest.mark.slow
def test_jumps():
    """A torque that jumps inside a step is found by the error; where the jump is a knot, nothing is tried twice."""

    def jumping(t, state, memory):
        return np.full(3, 8.0 if t > 0.0534 else -8.0), memory

    blind, warned = swing(1e-8, jumping), swing(1e-8, jumping, (0.0534, np.nextafter(0.0534, 1), 0.08))
    np.testing.assert_allclose(blind[-1].state.q, warned[-1].state.q, atol=1e-7)
    assert len(warned) < 0.6 * len(blind)
    assert min(b.t - a.t for a, b in pairwise(blind)) < 1e-3


def test_first_proposal():
    """The first step is short beside what moves, and bounded where nothing does."""
    p = as_chain(well_conditioned_system(3, arms=1, joints=3, grasps="rigid", moving_base=False, extras=False))
    now = stepper_of(p.chain, p.state)[1]
    fastest = max(np.abs(now.state.qd).max(), np.sqrt(np.abs(now.result.qdd).max()))
    assert 0.1 * 0.01 / fastest < first_proposal(now).step <= 0.01 / fastest
    still: Any = SimpleNamespace(velocities=np.zeros(8), accelerations=np.zeros(8))
    assert first_proposal(still).step == 1.0


def estimates(seed=0):
    """Return two estimates of the size of 1e-9."""
    return list(1e-9 * np.random.default_rng(seed).normal(size=(2, 20)))


def test_sizes_are_those_of_groups():
    """A joint at rest is allowed what the fastest is; an attitude counts as 1 rad; the larger end counts."""
    allowed = allowed_error(1e-6, 1e-8, BEFORE, AFTER)
    sizes = [4, 4, 40, 40, 1, 1, 1, 5, 5, 5, 2, 2, 2, 5, 5, 5]
    np.testing.assert_allclose(allowed, 1e-8 + 1e-6 * np.array(sizes), rtol=1e-15)
    np.testing.assert_allclose(allowed_error(1e-6, 1e-6, BEFORE, AFTER), 1e-6 * (1 + np.array(sizes)), rtol=1e-15)


def test_ratio_scales():
    """Twice the error or half the tolerance is twice the ratio; a ratio of one is an error as allowed."""
    given = estimates()
    ratio = Tolerance(1e-8).ratio(given, BEFORE, AFTER)
    assert ratio > 0
    assert Tolerance(1e-8).ratio([2 * e for e in given], BEFORE, AFTER) == pytest.approx(2 * ratio)
    assert Tolerance(0.5e-8).ratio(given, BEFORE, AFTER) == pytest.approx(2 * ratio)
    allowed = np.concatenate([allowed_error(1e-8, 1e-8, BEFORE, AFTER), np.zeros(4)])
    assert Tolerance(1e-8).ratio([allowed, 0 * allowed], BEFORE, AFTER) == pytest.approx(1.0)
    # the fifth-order estimate is squared and divided by the third's tenth part: order 7
    assert Tolerance(1e-8).ratio([1e-3 * allowed, allowed], BEFORE, AFTER) == pytest.approx(1e-5, rel=1e-3)


def test_work_is_not_controlled():
    """The last four, the work done, do not count; and a scheme without estimates has no error."""
    given = estimates()
    other = [np.concatenate([e[:16], np.full(4, 1e9)]) for e in given]
    tolerance = Tolerance()
    assert tolerance.ratio(given, BEFORE, AFTER) == tolerance.ratio(other, BEFORE, AFTER)
    assert tolerance.ratio([], BEFORE, AFTER) == 0.0
    assert tolerance.ratio([np.zeros(20), np.ones(20)], BEFORE, AFTER) == 0.0


@pytest.mark.parametrize(
    ("what", "given"), [("rtol", (0.0,)), ("rtol", (1e-16,)), ("rtol", (np.nan,)), ("atol", (1e-8, -1.0))]
)
def test_tolerance_refused(what, given):
    """A tolerance that is not positive, or finer than floats, is refused by name."""
    with pytest.raises(ModelError, match=f"tolerance: {what}: expected"):
        Tolerance(*given)


def counting(t, state, memory):
    """No torques, and how often the memory has moved on."""
    return np.zeros(len(state.q)), 1 if memory is None else memory + 1


def balls_moving(scheme=RK4, controller=limp):
    """Return a stepper of three arms with balls in brisk motion, and where it is."""
    return stepper_of(*PROBLEMS["balls"](), scheme, controller=controller)


def test_calm_steps_are_left_alone():
    """A step within the limit is the whole stepper's, to the bit."""
    whole, now = balls_moving()
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
    whole, now = balls_moving(scheme)
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
    whole, now = balls_moving(controller=counting)
    assert now.memory == 1
    (found,) = SubdividingStepper(whole, LIMIT).advance(now, [0.02])
    assert found.instant.memory == 2


@pytest.mark.slow
def test_what_cannot_be_closed_whole():
    """A step that leaves the grasps too far open is refused whole, and taken in parts."""
    whole, now = balls_moving()
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
