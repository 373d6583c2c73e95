"""Times that steps end at, searches in a bracket, and what is found inside a step: dips and zeros of margins."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.errors import ModelError, StateError
from holdfast.simulation.bracket import crossing, search_lowest, together
from holdfast.simulation.rollout.compiled_steppers import StagewiseStepper
from holdfast.simulation.simulate import simulate
from holdfast.simulation.stepper import NO_GAPS, Advance, ReferenceStepper
from holdfast.simulation.stops import step_times, stops
from holdfast.simulation.verification import MarginCurves, evaluation_times, verify
from tests.simulation.dips import Dips, found_dips
from tests.simulation.gantries import PUSHED, pressed

H = 0.01


def curves_of(*margins, known=(0.0,), broken=np.inf):
    """Return curves whose margins are functions of time; no step leads beyond `broken`."""

    def reach(times):
        evaluated.extend(times)
        failure = StateError("no further")
        return [
            Advance(t, SimpleNamespace(t=t) if t < broken else None, NO_GAPS, np.zeros(4), failure=failure)
            for t in times
        ]

    def of(instants):
        return np.array([[margin(at.t) for margin in margins] for at in instants])

    evaluated = []
    start = SimpleNamespace(t=0.0)
    here = Advance(0.0, start, NO_GAPS, np.zeros(4))
    return MarginCurves(reach, of, {t: of([SimpleNamespace(t=t)])[0] for t in known}, {0.0: here}), evaluated


def step(curves, acting=(), signals=1, lowest=np.inf, nodes=(0.0, 0.5, 0.5, 1.0)):
    """Return what is found in the step from 0 to H."""
    every = np.arange(signals)
    times, acting = evaluation_times(0.0, H, nodes), np.array(acting, dtype=int)
    return verify(curves, 0.0, times, every, acting, np.full(signals, float(lowest)))


def test_evaluation_times():
    """Nine points at most an eighth apart, the scheme's stage times among them, all asked for at once."""
    times = evaluation_times(0.3, 0.3 + H, (0.0, 0.2, 0.5, 1.0))
    assert len(times) == 9
    assert times[-1] == 0.3 + H
    assert 0.3 + 0.2 * H in times
    assert np.diff([0.3, *times]).max() <= H / 8 * (1 + 1e-9)
    curves, evaluated = curves_of(lambda t: 1.0)
    step(curves)
    assert evaluated == evaluation_times(0.0, H, (0.0, 0.5, 1.0))


def test_minimum_is_refined():
    """The lowest margin is found to rounding, not to the spacing of the evaluations."""
    for place in np.linspace(0.07, 0.93, 23) * H:
        curves, _ = curves_of(lambda t, place=place: 1.0 + ((t - place) / H) ** 2)
        assert step(curves).margins.min() == pytest.approx(1.0, abs=1e-13)


def test_minimum_at_a_step_boundary_is_refined():
    """A minimum between the last look of one step and the first of the next is found by the next."""
    place = -0.3 * H / 8
    curves, evaluated = curves_of(lambda t: 1.0 + ((t - place) / H) ** 2, known=(-H / 8, 0.0))
    found = step(curves)
    assert found.times[0] == -H / 8
    assert found.start > 1
    assert found.margins.min() == pytest.approx(1.0, abs=1e-13)
    assert any(t < 0 for t in evaluated)


def test_what_was_lower_before_is_not_refined():
    """A minimum that is neither negative nor the lowest of the run costs nothing."""
    curves, evaluated = curves_of(lambda t: 1.0 + ((t - 0.4 * H) / H) ** 2)
    step(curves, lowest=0.5)
    assert len(evaluated) == 8


def test_rounding_is_not_refined():
    """A margin that is constant but for its last digits costs nothing."""
    rng = np.random.default_rng(0)
    curves, evaluated = curves_of(lambda t: 3.0 * (1 + 1e-15 * rng.normal()))
    step(curves)
    assert len(evaluated) == 8


@pytest.mark.parametrize("width", [1e-4, 1e-3, 1e-2, 0.1])
def test_narrow_smooth_dips(width):
    """A parabola that dips below zero between two evaluations, wherever that is, ends the step where it crosses."""
    for place in np.random.default_rng(3).uniform(width, 1 - width, 20) * H:
        half = 0.5 * width * H
        curves, _ = curves_of(lambda t, place=place, half=half: ((t - place) / half) ** 2 - 1.0)
        found = step(curves, acting=[0])
        assert found.end.t == pytest.approx(place - half, abs=1.1e-13)
        assert found.times[-1] == found.end.t
        assert found.margins[-1, 0] < 0


def test_first_of_several():
    """The earliest zero ends the step; of two in one interval too."""
    curves, _ = curves_of(lambda t: 0.0060001 - t, lambda t: 0.006 - t, lambda t: 0.0059999 - t)
    assert step(curves, acting=[0, 1, 2], signals=3).end.t == pytest.approx(0.0059999, abs=1.1e-13)
    curves, _ = curves_of(lambda t: 0.0060001 - t, lambda t: 0.006 - t, lambda t: 0.0059999 - t)
    assert step(curves, acting=[0, 1], signals=3).end.t == pytest.approx(0.006, abs=1.1e-13)


def test_refused_points():
    """A point that cannot be reached ends the step with its refusal, unless a margin was negative before."""
    curves, _ = curves_of(lambda t: 1.0, broken=0.6 * H)
    end = step(curves, acting=[0]).end
    assert end.instant is None
    assert "no further" in str(end.failure)
    curves, _ = curves_of(lambda t: 0.3 * H - t, broken=0.6 * H)
    assert step(curves, acting=[0]).end.t == pytest.approx(0.3 * H, abs=1.1e-13)


@pytest.mark.slow
def test_dips_of_a_chain():
    """Twenty dips of a contact's margin, from a quarter of a step on and of any shape, are all found."""
    dips = Dips.random(20, H, 0.25, 1.5, seed=7)
    found_dips(dips, H, scheme="midpoint", make_stepper=StagewiseStepper)


@pytest.mark.slow
def test_dips_between_knots():
    """Whatever lies between the knots of a schedule, pulses of a hundredth of a step too, is found."""
    chain, state = pressed()
    rng = np.random.default_rng(5)
    times, torques, expected = [0.0], [1.0], []
    for k in range(8):
        begin, width = H * (2 * k + 1 + rng.uniform()), H * 10 ** rng.uniform(-3, -1)
        times += [begin, begin + 0.4 * width, begin + width]
        torques += [1.0, -0.2, 1.0]
        expected.append((begin + 0.4 * width / 1.2, begin + width - 0.6 * width / 1.2))
    schedule = TorqueSchedule.linear(times, np.array(torques)[:, None])
    run = simulate(chain, state, schedule, 0.2, H, on_slip="record", scheme="midpoint")
    ends = [one.t for one in run.occurrences]
    assert [one.kind for one in run.occurrences] == 8 * ["violation", "recovery"]
    assert np.abs(np.array(ends) - np.ravel(expected)).max() <= 1e-12
    assert [one.lowest for one in run.occurrences[1::2]] == pytest.approx(8 * [-0.2 * PUSHED])


def test_dips_of_a_polynomial_piece():
    """A schedule's own turning points are step boundaries: the shallowest dip of a quintic is found."""
    chain, state = pressed()
    depth = 1e-6
    roots = np.array([0.0123, 0.0129, 0.0271])
    wiggle = np.polynomial.Polynomial.fromroots(np.r_[roots, roots]) * 1e12  # touches zero three times
    schedule = TorqueSchedule([0.0], [(wiggle - depth).coef[None]])
    run = simulate(chain, state, schedule, 0.04, H, on_slip="record", scheme="midpoint")
    found = [one.t for one in run.occurrences if one.kind in ("violation", "recovery")]
    seen = list(zip(found[::2], found[1::2], strict=True))
    assert len(seen) == 3
    for root, (begin, end) in zip(roots, seen, strict=True):
        assert begin < root < end


def test_no_limits_cost_nothing():
    """Without contacts and limits a step asks its stepper for its end alone; nor do they cost calls of a function."""
    chain, state = pressed()
    free = chain.without_grasp("pusher")
    calls = []

    def counting(t, state, memory):
        calls.append(t)
        return np.zeros(1), memory

    simulate(free, state, counting, 0.05, H)
    plain = len(calls)
    assert plain <= 4 * 5 + 2
    calls.clear()
    pushing = chain, state, lambda t, s, m: (counting(t, s, m)[0] + 1.0, m), 0.05, H
    simulate(*pushing)
    assert len(calls) == plain
    calls.clear()
    simulate(*pushing, make_stepper=ReferenceStepper)
    assert len(calls) >= 8 * (plain - 2)


def counted(f):
    """Return the function, and the list of places it was asked at."""
    asked = []

    def g(x):
        asked.append(x)
        return f(x)

    return g, asked


SHAPES = {  # (f of the distance from its lowest point, how much too high at most, most evaluations)
    "parabola": (lambda d: 3 * d * d - 1, 1e-15, 8),
    "cosine": (lambda d: 0.7 - math.cos(3 * d), 1e-13, 15),
    "skew": (lambda d: math.exp(8 * d) - 8 * d, 1e-11, 25),
    "kink": (lambda d: max(3 * d, -0.5 * d), 1e-6, 60),
    "step and slope": (lambda d: -d if d < 0 else 1 + d, 1e-6, 60),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_lowest(shape):
    """The minimum is found to rounding, at a kink to the precision of its place, in few evaluations."""
    f, most_above, most = SHAPES[shape]
    rng = np.random.default_rng(1)
    for place in rng.uniform(0.1, 0.9, 50):
        g, asked = counted(lambda x, place=place: f(x - place))
        inside = place + rng.uniform(-0.05, 0.0)
        ((x, value),) = together([search_lowest(0.0, inside, 1.0, 1e-7)], lambda places, g=g: [g(places[0])])
        assert value == g(x)
        assert value - f(0.0) <= most_above
        assert len(asked) <= most


@pytest.mark.parametrize("f", [lambda d: d, math.sinh, lambda d: d**3, lambda d: 1.0 if d > 0 else -1.0, math.atan])
@pytest.mark.parametrize("down", [1.0, -1.0])
def test_crossing(f, down):
    """The zero is found to 1e-13 from either end, and the place returned lies on the far side of it."""
    for place in np.random.default_rng(2).uniform(0.05, 0.95, 50):
        g, asked = counted(lambda x, place=place: down * f(x - place))
        for a, b in ((0.0, 1.0), (1.0, 0.0)):
            x = crossing(g, a, g(a), b, g(b), 1e-13)
            assert x == pytest.approx(place, abs=1.1e-13)
            assert (g(x) < 0) == (g(b) < 0)
        assert len(asked) < 150


def test_searches_go_side_by_side():
    """Several at once find what each finds alone, and ask for all their places in one call a round."""
    lows, calls = [0.2, 0.5, 0.9], []

    def values(asked):
        calls.append(len(asked))
        return [(x - lows[k]) ** 2 - k for k, x in asked.items()]

    found = together([search_lowest(0.0, low, 1.0, 1e-7) for low in lows], values)
    assert [x for x, _ in found] == pytest.approx(lows, abs=1e-6)
    assert [value for _, value in found] == pytest.approx([0.0, -1.0, -2.0], abs=1e-12)
    assert calls[0] == 3
    assert len(calls) < 40
    assert together([], values) == []


def test_times_end_exactly():
    """The last time is the duration, whether or not the step divides it."""
    assert step_times(2.0, 0.001)[-1] == 2.0
    assert len(step_times(2.0, 0.001)) == 2001
    assert step_times(0.1, 0.03) == pytest.approx([0, 0.03, 0.06, 0.09, 0.1])
    assert len(step_times(0.3, 0.1)) == 4


def test_jumps_have_two_sides():
    """A breakpoint is reached from below and jumped onto; grid times too near to it give way."""
    found = stops(step_times(1.0, 0.25), [0.3, 0.5 + 1e-12, 0.75], [1.0], 1e-9)
    sides = [[np.nextafter(t, -1), t] for t in (0.3, 0.5 + 1e-12, 0.75, 1.0)]
    assert found.times.tolist() == [0.25, *np.ravel(sides)]
    assert found.jumps.tolist() == [False, *4 * [False, True]]


def test_breakpoints_outside_do_not_matter():
    """Those before, at the start, at the end and after leave the grid as it is."""
    grid = step_times(1.0, 0.3)
    found = stops(grid, [-1.0, 0.0, 1.0, 7.0], [], 1e-9)
    assert np.array_equal(found.times, grid[1:])
    assert not found.jumps.any()


@pytest.mark.parametrize("seed", range(5))
def test_times_increase(seed):
    """Whatever the breakpoints, times never fall, jumps follow their other side, and the end is the end."""
    rng = np.random.default_rng(seed)
    at = rng.uniform(0, 1, 20)
    at = np.r_[at, np.nextafter(at[:5], 2), rng.choice(step_times(1.0, 0.01), 5)]
    found = stops(step_times(1.0, 0.01), at.tolist(), [], 1e-11)
    assert (np.diff(found.times) >= 0).all()
    assert found.times[-1] == 1.0
    for k in np.flatnonzero(found.jumps):
        assert np.nextafter(found.times[k], -1) in found.times[:k]
    assert set(at[(at > 0) & (at < 1)]) <= set(found.times)


@pytest.mark.parametrize("bad", [[np.inf], [np.nan], ["0.5"], [None]])
def test_bad_breakpoints(bad):
    """Only finite times are times."""
    with pytest.raises(ModelError, match="simulation: breakpoints: expected"):
        stops(step_times(1.0, 0.1), bad, [], 0.0)
