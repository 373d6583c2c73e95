"""Laws that every simulated run keeps: order, closure, energy; how runs end; the state between two samples."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Inputs, State
from holdfast.dynamics import closure
from holdfast.errors import ModelError, SingularChainError, StateError
from holdfast.simulation.events import Release
from holdfast.simulation.interpolant import Knot
from holdfast.simulation.interpolant import interpolant as between_knots
from holdfast.simulation.runge_kutta import dop853
from holdfast.simulation.simulate import simulate
from holdfast.simulation.stops import MOST_STEPS
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from tests.simulation.runs import differences, limp, numbers, stepper_of
from tests.systems import planar_parallelogram, well_conditioned_system
from tests.systems.as_chain import as_chain
from tests.systems.problems import largest_gaps


def problem(seed=1, **options):
    options = {"moving_base": False, "extras": False, "joint_speed": 0.5, "gravity": (0, 0, -9.81)} | options
    return as_chain(well_conditioned_system(seed, **options))


@pytest.mark.slow
def test_observed_order():
    """Halving the step divides the error of the whole state by 2^3.8 or more."""
    p = problem(arms=2, joints=4, grasps="ball")

    def end(steps):
        run = simulate(p.chain, p.state, limp, 0.08, 0.08 / steps)
        return np.concatenate([run.q[-1], run.qd[-1], run.object_pose[-1], run.object_twist[-1]])

    exact = end(48)
    errors = [np.abs(end(n) - exact).max() for n in (3, 6, 12)]
    assert errors[0] > 1e-9, "too small to see an order"
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > 3.8, orders


def test_steps_are_bounded(monkeypatch):
    """An adaptive run that would take steps without end is stopped, and says what to try."""
    monkeypatch.setattr("holdfast.simulation.run.MOST_UNPLANNED", 3)
    p = problem(arms=1, joints=4, grasps="ball")
    run = simulate(p.chain, p.state, limp, 1.0, 1.0, scheme="dop853", rtol=1e-12)
    assert run.stopped == f"stopped after t = {run.t[-1]:.6g} s: more than 3 steps; try a larger rtol"
    assert len(run) == 5


@pytest.mark.slow
def test_free_fall_keeps_energy():
    """Two limp arms fall with their object: T + V stays what it was."""
    p = problem(seed=3, arms=2, joints=7, grasps="rigid")
    run = simulate(p.chain, p.state, limp, 0.1, 0.002)
    assert not run.work.any()
    assert np.ptp(run.kinetic) > 0.1
    assert np.abs(run.imbalance).max() < 1e-8 * np.ptp(run.kinetic)
    assert run.position_gap[:, 1].max() <= 1e-12 and run.velocity_gap[:, 1].max() <= 1e-12


@pytest.mark.slow
def test_work_of_everything_balances():
    """Drives, damping, friction, moving bases and external wrenches: T + V gains their work."""
    p = problem(seed=4, arms=2, joints=7, grasps=["hinge", "rigid"], extras=True)
    arms = {
        name: replace(arm, joints=[replace(joint, damping=0.5, friction=0.3) for joint in arm.joints])
        for name, arm in p.chain.arms.items()
    }
    chain = replace(p.chain, arms=arms)
    name = chain.names[0]
    home, w, amplitude = chain.arms[name].base, np.array([0.0, 0.4, 1.1]), np.array([0.02, 0.0, 0.03])

    def sway(t):
        pose = Pose(rotation.exp(0.1 * t**2 * w) @ home.R, home.p + t**2 * amplitude)
        return pose, np.r_[0.2 * t * w, 2 * t * amplitude], np.r_[0.2 * w, 2 * amplitude]

    def shaking(t, state, memory):
        return np.cos(30 * t) * p.tau, memory

    def wrenches(t):
        return Inputs(object_wrench=p.inputs.object_wrench, link_wrenches=p.inputs.link_wrenches)

    run = simulate(chain, p.state, shaking, 0.03, 0.001, base_motion={name: sway}, inputs=wrenches)
    assert run.stopped is None
    assert run.position_gap[:, 1].max() <= 1e-12
    assert (np.abs(run.work[-1]) > 1e-5).all()
    assert run.work[-1, 1] < 0
    assert np.abs(run.imbalance).max() < 1e-5 * np.abs(run.work).max()
    coarse = simulate(chain, p.state, shaking, 0.03, 0.002, base_motion={name: sway}, inputs=p.inputs)
    assert np.abs(coarse.imbalance).max() > 8 * np.abs(run.imbalance).max()


def test_memory_moves_on_once_a_step():
    """A controller sees the memory it returned at the step's start, at every later stage."""
    p = problem(arms=1, joints=6, grasps="rigid")
    seen = []

    def counting(t, state, memory):
        seen.append((t, memory))
        return np.zeros(6), (memory or 0) + 1

    simulate(p.chain, p.state, counting, 0.02, 0.01)
    late = [(t, memory) for t, memory in seen if memory is not None]
    assert [memory for _, memory in late] == [1, 1, 1, 1, 2, 2, 2, 2]
    assert [t for t, _ in late] == pytest.approx([0.005, 0.005, 0.01, 0.01, 0.015, 0.015, 0.02, 0.02])


@pytest.mark.slow
def test_flat_parallelogram_stops_the_run():
    """Cranks at constant rate reach the flat position: the run ends there and says so."""
    rate, step = 0.7, 0.01
    p = as_chain(planar_parallelogram(3 * rate * step, crank_rate=-rate))
    run = simulate(p.chain, p.state, limp, 0.1, step)
    assert run.t == pytest.approx([0, 0.01, 0.02])
    assert run.stopped is not None
    assert run.stopped.startswith("stopped after t = 0.02 s, before a singular configuration at t = 0.03 s: ")
    assert "the grasp constraint has rank 8 there, 9 in general; force" in run.stopped
    (event,) = run.occurrences
    assert (event.kind, event.rank, event.generic_rank, len(event.lost)) == ("singular", 8, 9, 1)
    assert event.t == pytest.approx(0.03, abs=1e-9)
    assert run.q[-1, 0] == pytest.approx(rate * step, abs=1e-12)


@pytest.mark.slow
def test_diverging_run_stops():
    """Torques that blow the state up end the run; what came before is finite."""
    p = problem(arms=1, joints=6, grasps="rigid")
    run = simulate(p.chain, p.state, lambda t, s, m: (1e3 * np.exp(400 * t) * np.ones(6), m), 0.2, 0.01)
    assert run.stopped is not None
    assert 1 <= len(run) < 21
    assert np.isfinite(run.q).all()
    assert "\n" not in run.stopped


@pytest.mark.slow
def test_torques_that_stop_fitting_end_the_run():
    """A controller that returns NaN later on does not spoil what was done."""
    p = problem(arms=1, joints=6, grasps="rigid")
    run = simulate(p.chain, p.state, lambda t, s, m: (np.full(6, np.nan if t > 0.02 else 0.0), m), 0.05, 0.01)
    assert run.t[-1] == pytest.approx(0.02)
    assert "controller: torques: expected finite numbers" in str(run.stopped)


@pytest.mark.parametrize(
    ("error", "change", "message"),
    [
        (StateError, {"state": "open"}, "does not satisfy the grasps"),
        (StateError, {"state": "short"}, "expected 12 joint positions"),
        (StateError, {"controller": lambda t, s, m: (np.zeros(5), m)}, "controller: torques: expected shape (12,)"),
        (ModelError, {"duration": -1.0}, "simulation: duration: expected > 0"),
        (ModelError, {"duration": float("nan")}, "simulation: duration: expected finite"),
        (ModelError, {"step": 0.0}, "simulation: step: expected > 0"),
        (ModelError, {"step": 2.0}, "expected <= the duration"),
        (ModelError, {"step": 1e-12}, f"at most {MOST_STEPS} steps"),
        (ModelError, {"base_motion": {"arm3": None}}, "no such arm. Did you mean 'arm"),
    ],
)
def test_refused_before_the_first_step(error, change, message):
    """What cannot be simulated is refused by name, nothing sampled."""
    p = problem(arms=2, joints=6, grasps="rigid")
    states = {
        "open": State(p.state.q + 0.1, p.state.qd, p.state.object_pose),
        "short": State(p.state.q[:7], p.state.qd[:7], p.state.object_pose),
    }
    given = {"state": p.state, "controller": limp, "duration": 1.0, "step": 0.1} | change
    given["state"] = states.get(given["state"], p.state) if isinstance(given["state"], str) else given["state"]
    with pytest.raises(error) as caught:
        simulate(p.chain, on_sample=lambda s: pytest.fail("sampled"), **given)
    assert message in str(caught.value)


def test_singular_start_is_refused():
    """A chain that begins flat is refused, not simulated."""
    p = as_chain(planar_parallelogram(0.0))
    with pytest.raises(SingularChainError, match="rank 8 of 12"):
        simulate(p.chain, p.state, limp, 0.1, 0.01)


def test_callbacks():
    """Every sample is handed out as it is made, and progress once a step."""
    p = problem(arms=1, joints=6, grasps="rigid")
    samples, times = [], []
    run = simulate(p.chain, p.state, limp, 0.03, 0.01, progress=times.append, on_sample=samples.append)
    assert times == pytest.approx([0.01, 0.02, 0.03])
    assert [float(s.t) for s in samples] == list(run.t)
    assert np.array_equal(np.stack([s.q for s in samples]), run.q)


def test_unclosable_step_stops():
    """A step far too long for the speeds leaves the constraint, and the run says what to try."""
    p = problem(seed=2, arms=2, joints=7, grasps="rigid", joint_speed=20.0)
    run = simulate(p.chain, p.state, limp, 2.0, 0.5)
    assert run.stopped is not None
    assert len(run) == 1
    assert "try a smaller time step" in run.stopped


def interpolant(now, later):
    """Return the interpolant between two instants."""
    return between_knots(*(Knot(x.t, x.state, x.accelerations) for x in (now, later)))


@pytest.fixture(scope="module")
def moving():
    """Return a stepper and the start of two arms that turn their object."""
    p = as_chain(
        well_conditioned_system(1, arms=2, joints=4, grasps="ball", moving_base=False, extras=False, joint_speed=1.5)
    )
    return stepper_of(p.chain, p.state, dop853())


def test_ends(moving):
    """At both ends it is the state there, to rounding."""
    stepper, now = moving
    later = stepper.advance(now, [0.02])[0].instant
    between = interpolant(now, later)
    for at in (now, later):
        np.testing.assert_allclose(numbers(between(at.t)), numbers(at.state), rtol=0, atol=2e-14)


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.2, 0.5, 0.85])
def test_order_between_samples(moving, part):
    """Halving the step divides the error by 2^6 in positions and 2^5 in velocities."""
    stepper, now = moving
    errors = []
    for step in (0.04, 0.02, 0.01):
        t = part * step
        exact, later = (reached.instant for reached in stepper.advance(now, [t, step]))
        errors.append(differences(interpolant(now, later)(t), exact.state))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert errors[-1][0] > 1e-14, "too small to see an order"
    assert orders[:, 0].min() > 5.5, orders
    assert orders[:, 1].min() > 4.5, orders


def test_grasps_open_by_the_same(moving):
    """It is not projected: the grasps are open by no more than the state is off."""
    stepper, now = moving
    step = 0.02
    exact, later = (reached.instant for reached in stepper.advance(now, [0.5 * step, step]))
    found = interpolant(now, later)(0.5 * step)
    off = differences(found, exact.state)
    assert (largest_gaps(closure(now.chain, found)) < 10 * np.asarray(off)[:2]).all()


def test_both_quaternions_of_an_attitude(moving):
    """An end given by the other quaternion of the same attitude changes nothing."""
    stepper, now = moving
    later = stepper.advance(now, [0.02])[0].instant
    pose = np.concatenate([-later.state.object_pose[:4], later.state.object_pose[4:]])
    other = replace(later, state=replace(later.state, object_pose=pose))
    a, b = interpolant(now, later)(0.013), interpolant(now, other)(0.013)
    np.testing.assert_array_equal(numbers(a), numbers(b))


@pytest.mark.parametrize("t", [0.021, np.nan])
def test_no_time_outside(moving, t):
    """It does not extrapolate."""
    stepper, now = moving
    later = stepper.advance(now, [0.02])[0].instant
    with pytest.raises(StateError, match=r"interpolation: t: expected 0 to 0.02 s, got"):
        interpolant(now, later)(t)


def test_any_time_of_a_run(moving):
    """A run has its state at any time: at samples theirs, between them the quintic's, at a jump what comes after."""
    stepper, now = moving
    chain, step = now.chain, 0.01
    release = Release(2 * step, chain.names[0])
    run = simulate(chain, now.state, lambda t, state, memory: (0 * state.q, memory), 3 * step, step, events=[release])
    for k, t in enumerate(run.t):
        if t != np.nextafter(2 * step, 0):
            np.testing.assert_array_equal(numbers(run.state_at(t)), numbers(run.state(k)))
    exact = stepper.advance(now, [0.4 * step])[0].instant
    assert (differences(run.state_at(0.4 * step), exact.state) < [1e-10, 1e-7]).all()  # h^6 and h^5
    assert run.t[3] == 2 * step
    np.testing.assert_array_equal(numbers(run.state_at(2 * step)), numbers(run.state(3)))
    for t, expected in ((-1e-9, "0 to 0.03 s"), (3.1 * step, "0 to 0.03 s"), (np.nan, "finite numbers")):
        with pytest.raises(StateError, match=f"run: t: expected {expected}, got"):
            run.state_at(t)
