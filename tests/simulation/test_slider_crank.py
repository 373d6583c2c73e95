"""A slider-crank in space with a universal joint against its one equation of motion."""

from typing import Any

import numpy as np
import pytest

import holdfast as hf
from tests.oracles.slider_crank import SliderCrank
from tests.simulation.runs import differences
from tests.systems.problems import largest_gaps

START = 0.4, 11.0  # angle and rate of the crank [rad, rad/s]


def torque(t: float) -> float:
    """Return the crank's torque [N m]."""
    return 0.8 * np.sin(9.0 * t)


def push(place: float, speed: float) -> float:
    """Return the force on the slider along its line [N]."""
    return 4.0 / place**2 - 0.5 * speed**3


def drive(t: float, state: hf.State, memory: Any) -> tuple[list[float], Any]:
    """Return the torques of crank and slider."""
    return [torque(t), 0.0], memory


def pressed(t: float, state: hf.State) -> hf.Inputs:
    """Return what presses on the slider, as wrenches on links."""
    wrenches = np.zeros((2, 6))
    wrenches[1, 3] = push(state.q[1], state.qd[1])
    return hf.Inputs(link_wrenches=wrenches)


@pytest.fixture
def mechanism() -> SliderCrank:
    """The mechanism of every test."""
    return SliderCrank()


def test_its_derivatives(mechanism):
    """By differences: the equations themselves."""
    h, angle = 1e-5, 1.1
    at, before, after = (mechanism.at(angle + x) for x in (0.0, -h, h))
    for name in ("place", "pin", "turn"):
        for k in (1, 2):
            slope = (np.array(getattr(after, name)[k - 1]) - getattr(before, name)[k - 1]) / (2 * h)
            assert getattr(at, name)[k] == pytest.approx(slope, abs=1e-8)
    assert at.spin[1] == pytest.approx((after.spin[0] - before.spin[0]) / (2 * h), abs=1e-8)
    assert at.turn[0].T @ at.turn[0] == pytest.approx(np.eye(3), abs=1e-15)


def test_one_freedom(mechanism):
    """Nothing is held twice, and the state that the equations give is the chain's."""
    chain, state = mechanism.chain(), mechanism.state(*START)
    diagnosis = hf.diagnose(chain, state)
    assert diagnosis.mobility == 1 and diagnosis.rank == chain.constraint_row_count
    assert largest_gaps(hf.dynamics.closure(chain, state)).max() < 1e-14


@pytest.mark.parametrize("angle", [0.4, 1.9, -2.5, 3.6])
def test_accelerations_and_forces(mechanism, angle):
    """Of crank and slider; the joint's force along the line is what the slider's own equation leaves over."""
    state = mechanism.state(angle, START[1])
    found = hf.forward_dynamics(mechanism.chain(), state, [1.5, 0.0], inputs=pressed(0.0, state))
    (place, place_1, place_2), speed = mechanism.at(angle).place, state.qd[1]
    expected = mechanism.acceleration(angle, START[1], 1.5, push)
    slider = place_1 * expected + place_2 * START[1] ** 2
    assert found.qdd == pytest.approx([expected, slider], rel=1e-11)
    own = push(place, speed) - mechanism.sliding * speed - mechanism.stiffness * (place - mechanism.rest)
    assert found["slider"].grasp_wrench[3] == pytest.approx(own - mechanism.slider_mass * slider, rel=1e-9)
    first, second = np.eye(3)[2], state.object_frame.R[:, 1]  # the cross's arms bear no moment
    assert np.abs(found["slider"].grasp_wrench[:3] @ np.array([first, second]).T).max() < 1e-12
    assert np.linalg.norm(found["slider"].grasp_wrench[:3]) > 1e-3


@pytest.mark.slow
def test_a_second_of_motion(mechanism):
    """All positions and velocities agree to 1e-9 at every twentieth of it, over more than a turn of the crank."""
    chain, times = mechanism.chain(), np.arange(21) / 20
    options: dict[str, Any] = {"scheme": "dop853", "rtol": 1e-13, "inputs": pressed}
    run = hf.simulate(chain, mechanism.state(*START), drive, 1.0, 0.05, **options)
    assert run.stopped is None
    worst = 0.0
    for t, (angle, rate) in zip(times, mechanism.motion(*START, torque, push, times), strict=True):
        found, expected = run.state_at(t), mechanism.state(angle, rate)
        worst = max(worst, differences(found, expected).max())
    assert worst <= 1e-9
    assert np.ptp(run.q[:, 0]) > 2 * np.pi
    assert np.abs(run.imbalance).max() < 1e-10 * run.kinetic.max()
    print(f"largest difference {worst:.1e}")
