"""What is found inside a step: dips, minima and zeros of margins that are given functions of time."""

from types import SimpleNamespace

import numpy as np
import pytest

from holdfast import StateError
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.simulation.simulate import simulate
from holdfast.simulation.stepper import NO_GAPS, Advance
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


def test_dips_of_a_chain():
    """Twenty dips of a contact's margin, from a quarter of a step on and of any shape, are all found."""
    dips = Dips.random(20, H, 0.25, 1.5, seed=7)
    found_dips(dips, H, scheme="midpoint")


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
    """Without contacts and limits a step asks its stepper for its end alone."""
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
    simulate(chain, state, lambda t, s, m: (counting(t, s, m)[0] + 1.0, m), 0.05, H)
    assert len(calls) >= 8 * (plain - 2)
