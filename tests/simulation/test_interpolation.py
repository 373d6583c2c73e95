"""The state between two samples."""

import numpy as np
import pytest

from holdfast import StateError
from holdfast.dynamics import closure
from holdfast.simulation.events import Release
from holdfast.simulation.runge_kutta import dop853
from holdfast.simulation.simulate import simulate
from holdfast.simulation.trajectory import Knot
from holdfast.simulation.trajectory import interpolant as between_knots
from tests.simulation.runs import differences, numbers, stepper_of
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain
from tests.systems.problems import largest_gaps


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


@pytest.mark.parametrize("part", [0.2, 0.5, 0.85])
def test_observed_order(moving, part):
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
    from dataclasses import replace

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
