"""Runs against exact motions; the checks of `tests/acceptance/test_simulation_accuracy.py`, over shorter times."""

from dataclasses import replace
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import holdfast as hf
from holdfast.simulation.runge_kutta import dop853
from tests.longer import mostly_slow
from tests.oracles import sundials
from tests.oracles.planar_linkage import Motion, rate
from tests.oracles.slider_crank import SliderCrank
from tests.simulation.problems import PROBLEMS
from tests.simulation.runs import adaptive, balances_of, differences, fixed, limp, stepper_of
from tests.systems.as_case import as_case
from tests.systems.five_bar import FiveBar, five_bar_chain, five_bar_state
from tests.systems.problems import largest_gaps

BAR = FiveBar()
POINT = 0.2 + 0.1j  # on the left inner link, in its axes [m]
CORNER = 0.05 - 0.08j  # on the object, from C
HOOK = 0.3 + 0.9j  # in the world
ELBOW = (40.0, 0.35, 1.5)  # from the point to the right outer joint: stiffness, natural length, damping
STRING = (25.0, 0.2, 0.8)  # from the object's corner to the hook
TURN, REST = 6.0, -0.4  # of the left outer joint: N m/rad, rad
START = 0.4, 11.0  # angle and rate of the crank [rad, rad/s]


def sprung_five_bar() -> hf.ClosedChain:
    """Return the linkage with its springs."""
    plain = five_bar_chain(BAR)
    inner, outer = plain.arms["left"].joints
    left = replace(plain.arms["left"], joints=[inner, replace(outer, stiffness=TURN, rest=REST)])
    springs = [
        hf.Spring(("left", 0, point(POINT)), ("right", 1, point(0)), *ELBOW),
        hf.Spring(("object", point(CORNER)), ("world", point(HOOK)), *STRING),
    ]
    return replace(plain, arms={**plain.arms, "left": left}, springs=springs)


def point(z: complex) -> tuple[float, float, float]:
    """Return a point of the plane."""
    return complex(z).real, complex(z).imag, 0.0


def pulls(turns: list, ways: list, rates: list) -> list:
    """Return the generalised forces of the springs: what their forces do along each way of moving."""
    inner, outer, third, _ = BAR.bars
    # each point as what the four links carry it by, and what the world does
    ends = [
        (((POINT, 0, 0, 0), 0), ((0, 0, third.length, 0), BAR.span), *ELBOW),
        (((inner.length, outer.length - BAR.left + CORNER, 0, 0), 0), ((0, 0, 0, 0), HOOK), *STRING),
    ]
    load = [0, 0]
    for (a, at_a), (b, at_b), stiffness, natural, damping in ends:
        carried = [(y - x) * e for x, y, e in zip(a, b, turns, strict=True)]
        line = sum(carried) + at_b - at_a
        length = abs(line)
        grows = [(line.conjugate() * sum(1j * u * z for u, z in zip(way, carried, strict=True))).real for way in ways]
        rate = (line.conjugate() * sum(1j * w * z for w, z in zip(rates, carried, strict=True))).real / length
        tension = stiffness * (length - natural) + damping * rate
        load = [x - tension * g / length for x, g in zip(load, grows, strict=True)]
    bent = mpmath.atan2((turns[1] / turns[0]).imag, (turns[1] / turns[0]).real)
    torque = -TURN * (bent - REST)
    return [x + torque * (way[1] - way[0]) for x, way in zip(load, ways, strict=True)]


@pytest.mark.parametrize("problem", mostly_slow(PROBLEMS, [*PROBLEMS][::2]))
def test_every_grasp(problem):
    """Closed to 1e-12 and 1e-11 after every step, by `closure`."""
    balances = balances_of(fixed(*stepper_of(*PROBLEMS[problem]()), np.linspace(0.0, 0.008, 5)))
    assert balances.position <= 1e-12
    assert balances.velocity <= 1e-11
    assert balances.drift <= 1e-7 * balances.peak_kinetic


@pytest.mark.parametrize(
    ("rtol", "steps", "drift"), mostly_slow([(1e-6, 10, 1e-5), (1e-12, 40, 1e-11)], [(1e-6, 10, 1e-5)])
)
def test_tolerance_buys_energy(rtol, steps, drift):
    """Two Pandas fall for 0.2 s: energy is kept as the tolerance asks, and steps are as long as it allows."""
    balances = balances_of(adaptive(*stepper_of(*PROBLEMS["pandas"](), dop853(), rtol), 0.2))
    assert balances.position <= 1e-12
    assert balances.velocity <= 1e-11
    assert balances.drift <= drift * balances.peak_kinetic
    assert balances.steps <= steps


@pytest.mark.slow
def test_thirty_digits():
    """A five-bar linkage after 0.05 s agrees with two coordinates integrated in 30 digits, and so with springs."""
    motions = [Motion(BAR, (0.2, -0.5), (1.0, -2.0), *forces) for forces in ((), (pulls,))]
    start = five_bar_state(BAR, *motions[0].links(motions[0].start))
    exact = [five_bar_state(BAR, *motion.links(motion.after(0.05, 2))) for motion in motions]
    for chain, state, bound in zip((five_bar_chain(BAR), sprung_five_bar()), exact, (1e-11, 1e-10), strict=True):
        balances = balances_of(adaptive(*stepper_of(chain, start, dop853(), 1e-12), 0.05))
        assert balances.last is not None
        assert differences(balances.last.state, state).max() <= bound
        assert differences(balances.last.state, start).max() > 0.05
    assert differences(*exact).max() > 1e-3  # the springs do count


@pytest.mark.slow
def test_sundials():
    """Two Pandas falling for 0.05 s agree to 1e-7 with IDA on the dense equations of motion."""
    chain, state = PROBLEMS["pandas"]()
    theirs = sundials.integrated(as_case(chain, state), state.object_pose, 0.05, 1e-9)
    balances = balances_of(adaptive(*stepper_of(chain, state, dop853(), 1e-10), 0.05))
    assert balances.last is not None
    for key, x in theirs.items():
        np.testing.assert_allclose(getattr(balances.last.state, key), x, rtol=0, atol=1e-7, err_msg=key)
    assert np.abs(balances.last.state.qd).max() > 1.0


@pytest.mark.slow
def test_a_second_of_springs():
    """The two equations of a sprung five-bar linkage on floats, by SciPy's order 8: a second of it to 1e-9."""
    motion = Motion(BAR, (0.2, -0.5), (1.0, -2.0), pulls)
    start = motion.start.astype(float)
    state = five_bar_state(BAR, *motion.links(start))
    run = hf.simulate(sprung_five_bar(), state, limp, 1.0, 0.05, scheme="dop853", rtol=1e-13)
    found = solve_ivp(
        lambda t, y: rate(BAR, y, mpmath.fp, pulls).astype(float), (0.0, 1.0), start, "DOP853", rtol=1e-13, atol=1e-14
    )
    gap = differences(run.state(-1), five_bar_state(BAR, *motion.links(found.y[:, -1]))).max()
    print(f"largest difference {gap:.1e}")
    assert run.stopped is None and gap <= 1e-9
    assert abs(run.imbalance).max() < 1e-10 * run.kinetic.max()


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
    for t, motion in zip(times, mechanism.motion(*START, torque, push, times), strict=True):
        found, expected = run.state_at(t), mechanism.state(*motion)
        worst = max(worst, differences(found, expected).max())
    assert worst <= 1e-9
    assert np.ptp(run.q[:, 0]) > 2 * np.pi
    assert np.abs(run.imbalance).max() < 1e-10 * run.kinetic.max()
    print(f"largest difference {worst:.1e}")
