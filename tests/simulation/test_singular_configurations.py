"""Singular configurations between steps: found, named, and passed where only one motion leads on; losses of rank."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.simulation import adaptive_parts
from holdfast.simulation.collocation import CollocationStepper
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.fused_stepper import FusedStepper
from holdfast.simulation.runge_kutta import IMEX, RK4
from holdfast.simulation.singular_configuration import ConstraintFactors, rank_drop
from holdfast.simulation.stepper import ReferenceStepper, in_parts
from tests.control.two_pandas import two_pandas
from tests.longer import mostly_long, mostly_slow
from tests.simulation.test_overconstrained import FREE, free
from tests.systems.n_four_bar import n_four_bar, passing_times
from tests.systems.parallel_cranks import parallel_cranks

SCHEMES = [{"scheme": "rk4"}, {"scheme": "dop853", "rtol": 1e-9}, {"scheme": "dop853", "rtol": 1e-12}]
SOON = [(SCHEMES[0], free), (SCHEMES[1], FREE)]
LATER = [of for of in itertools.product(SCHEMES, [free, FREE]) if of not in SOON]
ROWS, COLUMNS = 11, 9


def with_longer_crank(chain, state, longer):
    """Return the mechanism with a longer second crank [m], closed again."""
    crank = chain.arms["crank1"]
    arms = {**chain.arms, "crank1": replace(crank, tip=hf.Pose(crank.tip.R, (1.0 + longer, 0.0, 0.0)))}
    unlike = hf.ClosedChain(arms, chain.held_object, chain.grasps, gravity=chain.gravity)
    return unlike, hf.close(unlike, state)


def energy_error(run) -> float:
    energy = run.kinetic + run.potential
    return float(np.abs(energy - energy[0]).max())


@pytest.mark.slow
@pytest.mark.parametrize(("options", "controller"), [SOON[0], *mostly_slow(SOON[1:], ()), *mostly_long(LATER, ())])
def test_a_run_stops_before_a_singular_configuration(options, controller):
    """To a millionth of a second of the instant on paper, whatever the scheme, with ranks and what is lost."""
    chain, state = n_four_bar()
    (expected,) = passing_times(3, 1)
    run = hf.simulate(chain, state, controller, 1.0, 1e-2, **options)
    (event,) = run.occurrences
    assert event.kind == "singular" and event.t == pytest.approx(expected, abs=1e-7)
    assert (event.rank, event.generic_rank) == (10, 11)
    assert "at 'crank0' (hinge) against force" in event.lost[0] and "causes no joint torque" in event.lost[0]
    assert run.stopped is not None and f"before a singular configuration at t = {event.t:.9g} s" in run.stopped
    assert expected - 1e-2 < run.t[-1] < expected


@pytest.mark.slow
@pytest.mark.parametrize("options", mostly_long(SCHEMES, SCHEMES[::2]))
def test_continuing_through_singular_configurations(options):
    """A parallelogram stays one: every configuration within a millionth of a second, energy as on the way to them."""
    chain, state = n_four_bar(2)
    expected = passing_times(2, 2)
    run = hf.simulate(chain, state, free, 1.3, 1e-2, on_singular="continue", **options)
    assert run.stopped is None and run.t[-1] == pytest.approx(1.3)
    assert [one.t for one in run.occurrences] == pytest.approx(expected, abs=1e-7)
    assert all("passes a singular configuration" in one.text for one in run.occurrences)
    assert np.abs(run.q[:, 0] - run.q[:, 1]).max() < 1e-10
    before = run.t < expected[0] - 0.02
    energy = run.kinetic + run.potential
    assert energy_error(run) < 4.0 * np.abs(energy[before] - energy[0]).max() + 1e-9


@pytest.mark.long
def test_what_no_step_sees():
    """The configuration lies where a grid time is, as near as a step can hardly end: it is found all the same."""
    chain, state = n_four_bar(2)
    (expected,) = passing_times(2, 1)
    step = (expected - 1e-6) / 20
    stopped = hf.simulate(chain, state, free, 30 * step, step)
    assert stopped.stopped is not None and stopped.occurrences[0].t == pytest.approx(expected, abs=1e-6)
    run = hf.simulate(chain, state, free, 30 * step, step, on_singular="continue")
    assert run.stopped is None and len(run.occurrences) == 1 and energy_error(run) < 1e-2


@pytest.mark.long
@pytest.mark.parametrize("longer", [1e-2, 1e-6])
def test_nearly_singular(longer):
    """With cranks of unlike lengths the mechanism folds instead: too fast for the steps, which are taken in parts."""
    unlike, start = with_longer_crank(*n_four_bar(2), longer)
    fixed = hf.simulate(unlike, start, free, 0.8, 1e-2)
    exact = hf.simulate(unlike, start, free, 0.8, 1e-2, scheme="dop853", rtol=1e-11)
    for run in (fixed, exact):
        assert run.stopped is None and not run.occurrences
    assert abs(exact.q[-1, 0] - exact.q[-1, 1]) > 0.5  # the cranks have parted
    there = [int(np.argmin(np.abs(run.t - 0.8))) for run in (fixed, exact)]
    assert np.abs(fixed.q[there[0]] - exact.q[there[1]]).max() < 1e-5
    assert energy_error(fixed) < 1e-5 and energy_error(exact) < 1e-9


@pytest.mark.slow
def test_implicit_steps_near_a_singular_configuration_are_taken_in_parts():
    """Whole steps of 10 ms end 0.7 rad elsewhere, or cannot be closed; so they are halved as far as need be."""
    unlike, start = with_longer_crank(*n_four_bar(2), 1e-4)
    run = hf.simulate(unlike, start, free, 0.8, 1e-2, scheme="imex")
    exact = hf.simulate(unlike, start, free, 0.8, 1e-2, scheme="dop853", rtol=1e-9)
    assert run.stopped is None and np.abs(run.q[-1] - exact.q[-1]).max() < 1e-4
    assert energy_error(run) < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "same"), [(RK4, 1e-7), (IMEX, 1e-5)], ids=["rk4", "imex"])
def test_parts_of_a_step_near_a_singular_configuration(scheme, same):
    """As many as bring twice as many to the same; further ones end within what two such differences come to."""
    cranks = parallel_cranks(2, 1.15e-3)
    generic = hf.forward_dynamics(cranks.chain, cranks.state, np.zeros(2)).rank
    stepper = FusedStepper.of(Environment(cranks.chain), FREE, scheme, generic)
    now, _ = stepper.start(0.0, cranks.state, np.zeros(0))
    (later,) = stepper.advance(now, [0.016])
    parts = adaptive_parts.agreeing_parts(stepper, now, later.instant)
    assert parts is not None and 1 < parts <= 32
    equal, halved = adaptive_parts.EqualPartsStepper(stepper, 0.016 / parts), adaptive_parts.HalvedPartsStepper(stepper)
    ends = [one.advance(now, [0.008, 0.016])[1].instant for one in (equal, halved)]
    exact = in_parts(stepper, now, 0.016, 128).instant
    change = np.abs(exact.velocities - now.velocities).max()
    assert np.abs(later.instant.velocities - exact.velocities).max() > same * change  # the whole step is too long
    assert all(np.abs(end.velocities - exact.velocities).max() < 2.0 * same * change for end in ends)


@pytest.mark.slow
def test_ordinary_steps_far_from_singular_configurations_need_no_adaptive_parts(monkeypatch):
    """Two Pandas lifting a box in steps of 20 ms once spent ten times as long in such parts as in all steps else."""
    monkeypatch.setattr(
        adaptive_parts.AdaptivePartsStepper, "advance", lambda *_: pytest.fail("a step was taken adaptively")
    )
    chain, state = two_pandas()
    path = hf.control.RestToRest(state.object_frame, [0.0, 0.0, 0.2])
    run = hf.simulate(chain, state, hf.control.ObjectTracking(chain, path, internal_force=20.0), 1.0, 0.02)
    assert run.stopped is None and len(run.t) == 51


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "step"),
    mostly_long(
        [("rk4", 1e-3), ("rk4", 7e-3), ("rk4", 2.3e-2), ("midpoint", 1e-3), ("midpoint", 7e-3)]
        + [("imex", step) for step in (1e-3, 7e-3, 2.3e-2)],
        [("rk4", 7e-3), ("midpoint", 1e-3), ("imex", 7e-3)],
    ),
)
def test_rollouts_stand_still_before_a_singular_configuration(scheme, step):
    chain, state = n_four_bar(2)
    (expected,) = passing_times(2, 1)
    rollout = hf.compile_rollout(chain, FREE, scheme=scheme)
    count = 12
    systems = rollout.start(np.tile(state.q, (count, 1)), state.qd, state.object_pose, state.object_twist)
    lengths = step * (1.0 + 0.08 * np.arange(count) / count)
    rollout.step(systems, lengths, steps=int(1.0 / step))
    assert [status.name for status in systems.status] == ["SINGULAR"] * count
    assert (systems.t < expected + 0.06 * lengths).all() and (systems.t > expected - 1.06 * lengths).all()


@pytest.mark.slow
def test_collocation_is_of_order_twelve_and_closed():
    """Away from singular configurations it is a scheme like any other."""
    chain, state = n_four_bar(2)
    environment = Environment(chain)
    exact = hf.simulate(chain, state, free, 0.4, 1e-2, scheme="dop853", rtol=1e-13)
    generic = hf.forward_dynamics(chain, state, np.zeros(2)).rank
    stepper = CollocationStepper(ReferenceStepper(environment, free, generic))
    now, _ = stepper.start(0.0, state, None)
    errors = []
    for end in (0.4, 0.2):
        (reached,) = stepper.advance(now, [end])
        there = int(np.argmin(np.abs(exact.t - end)))
        errors.append(np.abs(reached.instant.state.q - exact.q[there]).max())
        assert reached.gaps.position[1] < 1e-14
    assert errors[0] < 1e-7 and errors[1] < 1e-11


def test_unknown_policies():
    chain, state = n_four_bar(2)
    with pytest.raises(hf.errors.ModelError, match="on_singular: expected one of stop, continue, got 'go on'"):
        hf.simulate(chain, state, free, 0.1, 1e-2, on_singular="go on")


@pytest.mark.slow
def test_rollouts_do_not_leap_from_branch_to_branch():
    """Steps that are too long for a motion that folds say so; shorter ones follow it."""
    unlike, start = with_longer_crank(*n_four_bar(2), 1e-2)
    rollout = hf.compile_rollout(unlike, FREE)
    long_steps, short_steps = (
        rollout.step(rollout.start(start.q, start.qd, start.object_pose, start.object_twist), step, steps=steps)
        for step, steps in ((1e-2, 80), (2e-4, 4000))
    )
    exact = hf.simulate(unlike, start, free, 0.8, 2e-2, scheme="dop853", rtol=1e-11)
    assert long_steps.status[0].name in ("TOO_LONG", "SINGULAR") and 0.6 < long_steps.t[0] < 0.72
    assert short_steps.status[0].name == "RUNNING" and short_steps.t[0] == pytest.approx(0.8)
    assert np.abs(short_steps.q[0] - exact.q[-1]).max() < 1e-5


def path(values, seed=0, turning=1.0):
    """Return factors of matrices with given singular values, their vectors turning smoothly; and how often asked."""
    random = np.random.default_rng(seed)
    left, right = (random.normal(size=(n, n)) for n in (ROWS, COLUMNS))
    left, right = left - left.T, right - right.T

    def turned(skew, t):
        w, V = np.linalg.eig(turning * t * skew / np.linalg.norm(skew))
        return ((V * np.exp(w)) @ np.linalg.inv(V)).real

    def factors(t):
        s = np.array(values(t))
        U, V = turned(left, t), turned(right, t)
        U, s, Vt = np.linalg.svd(U[:, : len(s)] * s @ V[:, : len(s)].T, full_matrices=False)
        return ConstraintFactors(U, s / s[0], Vt)

    return factors


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("at", [0.013, 0.31, 0.5, 0.72, 0.998])
def test_one_value_passes_through_zero(seed, at):
    found = rank_drop(path(lambda t: [3.0, 1.0 + t, 0.5, 0.2 * (t - at) * (2 + t)], seed), 0.0, 1.0, 4)
    assert found is not None and found.through
    assert found.at == pytest.approx(at, abs=1e-9) and found.rank == 3


@pytest.mark.parametrize("seed", range(5))
def test_several_pass_through_zero_at_once(seed):
    """An even number of them changes no determinant's sign."""
    found = rank_drop(path(lambda t: [3.0, 1.0, 0.4 * (t - 0.3), -0.2 * (t - 0.3)], seed), 0.0, 1.0, 4)
    assert found is not None and found.through
    assert found.at == pytest.approx(0.3, abs=1e-8) and found.rank == 2


def test_the_first_of_two():
    found = rank_drop(path(lambda t: [3.0, 1.0, 0.4 * (t - 0.3), 0.2 * (t - 0.4)]), 0.0, 1.0, 4)
    assert found is not None and found.at == pytest.approx(0.3, abs=1e-8) and found.rank == 3


def test_zero_is_touched():
    found = rank_drop(path(lambda t: [3.0, 1.0, 0.5, 0.7 * (t - 0.4) ** 2]), 0.0, 1.0, 4)
    assert found is not None and not found.through
    assert found.at == pytest.approx(0.4, abs=1e-3) and found.rank == 3


@pytest.mark.parametrize("least", [1e-3, 1e-2, 0.1])
def test_a_dip_above_zero(least):
    values = path(lambda t: [3.0, 1.0, 0.5, np.hypot(least, t - 0.4)])
    assert rank_drop(values, 0.0, 1.0, 4) is None


def test_vectors_that_turn():
    """Singular values that change places, and subspaces that turn by a radian, are no loss of rank."""
    for seed in range(20):
        values = path(lambda t: [1.0, 0.5 + t, 0.9 - t / 2, 0.3 + 0.1 * np.sin(9 * t)], seed, turning=2.0)
        assert rank_drop(values, 0.0, 1.0, 4) is None
