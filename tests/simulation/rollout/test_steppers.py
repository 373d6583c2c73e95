"""A step in machine code is the reference's, to rounding; all measure the gaps of grasps alike and close them alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast import Inputs, Pose, State
from holdfast.dynamics import closure
from holdfast.dynamics.projection import largest_gaps as largest_in_step
from holdfast.dynamics.projection import moved
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.compiled_steppers import StagewiseStepper, stepper_for
from holdfast.simulation.rollout.fused_stepper import FusedStepper
from holdfast.simulation.rollout.python_law_stepper import PythonLawStepper
from holdfast.simulation.runge_kutta import scheme
from holdfast.simulation.stepper import ReferenceStepper, Stepper
from holdfast.spatial import rotation
from tests.dynamics.problems import random_problem
from tests.longer import mostly_long, mostly_slow
from tests.simulation.rollout.problems import arrays, difference, generic_rank, numbers, problem, swinging, swinging_law
from tests.systems.lower_pairs import JOINTS, grasp_of
from tests.systems.problems import largest_gaps

ROUNDING = 1e-12
BEGIN = 0.25
KINDS = ("rigid", "hinge", "softfinger", "ball", *JOINTS)


def pushed(chain: hf.ClosedChain) -> Environment:
    """Return the chain with a constant wrench on its object."""
    return Environment(chain, inputs=Inputs(object_wrench=np.array([0.3, -0.2, 0.1, 1.0, 2.0, -1.5])))


def agree(stepper: Stepper, reference: Stepper, state: State, memory: Any = None) -> None:
    """Take one step to several ends with both, and compare all that is known there."""
    starts = [each.start(BEGIN, state, memory) for each in (stepper, reference)]
    assert difference(numbers(starts[0][0]), numbers(starts[1][0])) <= ROUNDING
    ends = [BEGIN + 0.004, BEGIN + 0.01]
    found, expected = (each.advance(now, ends) for each, (now, _) in zip((stepper, reference), starts, strict=True))
    for a, b, end in zip(found, expected, ends, strict=True):
        assert a.failure is None and b.failure is None and a.instant and b.instant
        assert a.t == b.t == end
        assert difference(numbers(a.instant), numbers(b.instant)) <= ROUNDING
        assert difference({"work": a.work}, {"work": b.work}) <= ROUNDING
        # the estimates are differences of numbers 1e8 times their size
        assert a.error == pytest.approx(b.error, rel=1e-3, abs=1e-12)
        for mine, theirs in ((a.gaps.position, b.gaps.position), (a.gaps.velocity, b.gaps.velocity)):
            assert mine[0] == pytest.approx(theirs[0], abs=1e-12)
            assert mine[1] <= 1e-13


FEWER = [("nobody holds", "rk4"), ("one", "midpoint")]


@pytest.mark.parametrize(
    ("name", "by"), mostly_slow([("five", "rk4"), ("one", "dop853"), ("five", "dop853"), *FEWER], FEWER)
)
def test_fused(name, by):
    """Torques of time, state and memory; a wrench on the object; estimated errors."""
    chain, state = problem(name)
    environment, law, rank = pushed(chain), swinging_law(chain.joint_count), generic_rank(chain, state)
    tolerance = Tolerance(1e-9, 1e-7)
    reference = ReferenceStepper(environment, law, rank, scheme(by), tolerance)
    agree(FusedStepper.of(environment, law, scheme(by), rank, tolerance=tolerance), reference, state, law.memory)


def stubborn(t: float, state: State, memory: Any) -> tuple[np.ndarray, Any]:
    """A controller that cannot be traced: it branches, and remembers in a list."""
    count = [] if memory is None else memory
    tau = 2.0 * np.cos(np.arange(len(state.q)) + 40.0 * t) - state.qd
    if state.object_twist[3] > 0.0 or len(count) > 1:
        tau = tau + 1.0
    return tau, [*count, t]


@pytest.mark.parametrize(("name", "by"), mostly_slow([("five", "rk4"), *FEWER], FEWER))
def test_python_law(name, by):
    """A function that branches and remembers, asked once a stage; torques between the stages are close to its own."""
    chain, state = problem(name)
    environment, rank = pushed(chain), generic_rank(chain, state)
    reference = ReferenceStepper(environment, stubborn, rank, scheme(by))
    stepper = PythonLawStepper.of_controller(environment, stubborn, scheme(by), rank)
    agree(stepper, reference, state)
    (now, _), ends = stepper.start(BEGIN, state, None), [BEGIN + part * 1e-3 for part in (0.3, 0.5, 1.0)]
    screened, exact = stepper.screened(now, ends), stepper.advance(now, ends)
    assert screened[-1].instant and exact[-1].instant
    assert difference(numbers(screened[-1].instant), numbers(exact[-1].instant)) == 0.0
    assert screened[-1].instant.memory == exact[-1].instant.memory == [BEGIN, BEGIN + 1e-3]
    for a, b in zip(screened, exact, strict=True):
        assert a.instant and b.instant
        np.testing.assert_allclose(a.instant.tau, b.instant.tau, atol=1e-3 * max(1.0, np.abs(now.tau).max()))
        np.testing.assert_allclose(a.instant.state.q, b.instant.state.q, atol=1e-8)


def wind(t: float) -> Inputs:
    """A wrench on the object that changes with time."""
    return Inputs(object_wrench=np.array([0.1, 0.0, -0.2, 3.0 * np.sin(30.0 * t), 1.0, t]))


def shaken(base: Pose, seed: int) -> Any:
    """A base that turns and shifts about where it stands at t = BEGIN."""
    random = np.random.default_rng(seed)
    turning, shift, rate = random.normal(size=3), 0.1 * random.normal(size=3), 5.0

    def motion(t: float) -> tuple[Pose, np.ndarray, np.ndarray]:
        s = t - BEGIN
        place = Pose(rotation.exp(turning * s) @ base.R, base.p + shift * np.sin(rate * s))
        twist = np.concatenate([turning, rate * shift * np.cos(rate * s)])
        return place, twist, np.concatenate([np.zeros(3), -(rate**2) * shift * np.sin(rate * s)])

    return motion


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "moving", "by", "traced"),
    mostly_long([
        ("one", False, "midpoint", False), ("five", True, "rk4", False), ("five", True, "dop853", False),
        ("one", False, "dop853", True), ("five", True, "rk4", True),
    ], [("one", False, "midpoint", False), ("five", True, "rk4", True)]),
)  # fmt: skip
def test_stagewise(name, moving, by, traced):
    """Any controller, and laws as machine code; wrenches as functions of time, moving bases, estimated errors."""
    chain, state = problem(name)
    law, rank = swinging_law(chain.joint_count) if traced else None, generic_rank(chain, state)
    bases = {arm: shaken(chain.arms[arm].base, k) for k, arm in enumerate(chain.names) if k % 2 == 0}
    environment = Environment(chain, bases, wind) if moving else pushed(chain)
    given = environment, law or stubborn, rank, scheme(by), Tolerance(1e-9)
    agree(StagewiseStepper(*given, law), ReferenceStepper(*given), state, law and law.memory)


@pytest.mark.parametrize("given", ["base_twists", "base_accelerations"])
def test_constant_motion_of_bases(given):
    """A twist or an acceleration of the bases is obeyed wherever it is given, also one without the other."""
    chain, state = problem("nobody holds")
    law, rank = swinging_law(chain.joint_count), generic_rank(chain, state)
    moves = 0.3 * np.arange(1.0, 6 * len(chain.arms) + 1).reshape(-1, 6)
    environment = Environment(chain, inputs=Inputs(**{given: moves}))
    chosen = stepper_for(environment, law, rank, scheme("rk4"), Tolerance(), steps=1000)
    agree(chosen, ReferenceStepper(environment, law, rank, scheme("rk4")), state, law.memory)


@pytest.mark.slow
def test_failures_are_each_ends_own():
    """One end too far away does not spoil the others; the reason is the reference's."""
    chain, state = problem("one")
    rank, law = generic_rank(chain, state), swinging_law(chain.joint_count)
    environment = pushed(chain)
    for stepper in (
        FusedStepper.of(environment, law, scheme("rk4"), rank),
        StagewiseStepper(environment, stubborn, rank, scheme("rk4"), Tolerance()),
        PythonLawStepper.of_controller(environment, stubborn, scheme("rk4"), rank),
    ):
        now, _ = stepper.start(BEGIN, state, None)
        near, far = stepper.advance(now, [BEGIN + 1e-3, BEGIN + 5.0])
        (alone,) = stepper.advance(now, [BEGIN + 1e-3])
        assert near.instant is not None and alone.instant is not None
        assert difference(numbers(near.instant), numbers(alone.instant)) == 0.0
        assert far.instant is None and far.failure is not None
        assert "try a smaller time step" in str(far.failure)


@pytest.mark.slow
def test_what_stagewise_cannot_is_refused():
    """A wrench on a link that begins later, torques of a wrong shape: errors, never other physics."""
    chain, state = problem("five")
    rank, n = generic_rank(chain, state), chain.joint_count

    def late(t: float) -> Inputs:
        return Inputs(link_wrenches=np.full((n, 6), 1.0)) if t > BEGIN else Inputs()

    stepper = StagewiseStepper(Environment(chain, inputs=late), stubborn, rank, scheme("rk4"), Tolerance())
    now, _ = stepper.start(BEGIN, state, None)
    failure = stepper.advance(now, [BEGIN + 1e-3])[0].failure
    assert isinstance(failure, MethodNotApplicable) and "inputs: link_wrenches: expected none" in str(failure)
    environment = Environment(chain, inputs=wind)
    short = StagewiseStepper(environment, lambda t, x, m: (np.zeros(3), m), rank, scheme("rk4"), Tolerance())
    with pytest.raises(StateError, match="controller: torques"):
        short.start(BEGIN, state, None)


def opened(chain: hf.ClosedChain, state: hf.State, size: float) -> hf.State:
    """Return a state whose grasps are open by about so much [m, rad; m/s, rad/s]."""
    random = np.random.default_rng(3)
    beside = moved(state, size * random.uniform(-1.0, 1.0, size=chain.joint_count + 6))
    twist = beside.object_twist + size * random.uniform(-1.0, 1.0, size=6)
    return hf.State(beside.q, beside.qd, beside.object_pose, twist)


@pytest.mark.parametrize("kind", KINDS)
def test_closure_and_steps_measure_the_same(kind):
    """Steps take sines of angles, t - t^3 / 6, where `closure` has angles; lengths and velocities are the same."""
    p = random_problem(4, grasps=("rigid", "rigid"), joints=(6, 6), moving_base=False, extras=False)
    name = p.chain.names[1]
    frame = p.chain.grasps[name].frame
    chain = p.chain.without_grasp(name).with_grasp(name, grasp_of(kind, frame))
    for size in (1e-6, 1e-4, 1e-2):
        state = opened(chain, p.state, size)
        expected, found = largest_gaps(closure(chain, state)), largest_in_step(chain, state, hf.Inputs().shaped(chain))
        assert expected.min() > 0.1 * size
        assert abs(found.position - expected[0]) <= expected[0] ** 3 + 1e-15
        assert found.velocity == pytest.approx(expected[1], rel=1e-12)


@pytest.mark.slow
def test_every_backend_reports_and_closes_the_same_gaps():
    """A state a tenth of a millimetre off its grasps: the gaps before, none after, and the same closed state."""
    chain, state = problem("five")
    loose, law, rank = opened(chain, state, 1e-4), swinging_law(chain.joint_count), generic_rank(chain, state)
    environment, rk4, tolerance = Environment(chain), scheme("rk4"), Tolerance(1e-6, 1e-9)
    expected, memory = largest_gaps(closure(chain, loose)), law.memory
    steppers = (
        ReferenceStepper(environment, law, rank, rk4),
        FusedStepper.of(environment, law, rk4, rank),
        StagewiseStepper(environment, law, rank, rk4, tolerance),
    )
    starts = [stepper.start(0.0, loose, memory) for stepper in steppers]
    systems = swinging("five").start(**{name: x[None] for name, x in arrays(loose).items()})
    before = [np.array([gaps.position[0], gaps.velocity[0]]) for _, gaps in starts] + [systems.drift[0]]
    after = [np.array([gaps.position[1], gaps.velocity[1]]) for _, gaps in starts] + [systems.gap[0]]
    for found in before:
        assert np.abs(found - before[0]).max() <= ROUNDING
        assert np.abs(found - expected).max() <= expected[0] ** 3 + ROUNDING
    assert np.max(after) <= ROUNDING

    closed = arrays(hf.project(chain, loose)[0])
    assert largest_gaps(closure(chain, hf.State(**closed))).max() <= ROUNDING
    compiled = hf.compile(chain).project(**arrays(loose))
    others = [arrays(instant.state) for instant, _ in starts] + [arrays(systems.state(0)), compiled]
    assert [difference(found, closed) <= ROUNDING for found in others] == [True] * len(others)
