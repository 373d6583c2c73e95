"""Systems that cannot go on: each stands still at its last good state and says why, the others never notice."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from holdfast import ControlLaw, Friction, State, WrenchLimits, compile_rollout
from holdfast.errors import SingularChainError
from holdfast.forces import grasp_margins
from holdfast.simulation import Rollout, RolloutStatus, RolloutSystems
from holdfast.simulation.environment import Environment
from holdfast.simulation.runge_kutta import RK4
from holdfast.simulation.stepper import ReferenceStepper
from tests.compiler.programs import same_bits
from tests.longer import mostly_slow
from tests.simulation.gantries import squeezed
from tests.simulation.rollout.problems import arrays, elsewhere, problem, swinging, tiled
from tests.systems import planar_parallelogram
from tests.systems.as_chain import as_chain

MU, RADIUS = 0.5, 0.02
SQUEEZE, TWIST = 30.0, 0.15  # N, N m about the line through both contacts
STEP = 1e-3


@cache
def gantries() -> tuple[Rollout, State]:
    """Return a block between two gantries, a soft finger and a ball, pushed up by a force that grows."""
    friction = Friction(MU, torsion_radius=RADIUS), Friction(2.0)
    chain, state = squeezed(("softfinger", "ball"), friction)

    def torque(t, state, memory, given):
        up = given["rate"][()] * t
        return np.array([SQUEEZE, 0.0, up, -SQUEEZE, 0.0, up]), memory

    return compile_rollout(chain, ControlLaw(torque, parameters={"rate": ()}), scheme="midpoint"), state


def slip_time(rate: np.ndarray) -> np.ndarray:
    """Return when mu f_n = sqrt(f_t^2 + (m_n / e)^2) of the soft finger, which carries half the block's inertia.

    Two slides and the block, 1 + 1 + 2 kg, are pushed by 2 rate t: each contact passes on f_t = rate t / 2.
    """
    return 2.0 * np.sqrt((MU * SQUEEZE) ** 2 - (TWIST / RADIUS) ** 2) / rate


def given(rate: np.ndarray) -> dict[str, np.ndarray]:
    """Return the parameters of the law: how fast the force grows [N/s], and the twisting moment."""
    return {"rate": rate, "object_wrench": np.array([TWIST, 0.0, 0.0, 0.0, 0.0, 0.0])}


def test_slip():
    """The instant is that on paper; the last good state is the one before; the others are as in a clean batch."""
    rollout, state = gantries()
    rate = np.array([400.0, 0.0, 600.0, 20.0, 999.0, 100.0, 10.0, 0.0, 5.0, 700.0])
    systems = rollout.start(**tiled(state, 10), **given(rate))
    record = rollout.run(systems, 0.2, STEP, every=7, record=("q", "margin", "status"), least_margin=0.0, **given(rate))
    slips = rate >= 400.0
    with np.errstate(divide="ignore"):
        expected = np.where(slips, slip_time(rate), np.inf)
    assert np.array_equal(record.systems.status == RolloutStatus.SLIPPED, slips) and np.array_equal(
        record.systems.running, ~slips
    )
    assert np.abs(record.stopped[slips] - expected[slips]).max() <= 1e-9
    assert np.isinf(record.stopped[~slips]).all()
    last = np.floor(expected[slips] / STEP)
    assert np.abs(record.systems.t[slips] - STEP * last).max() <= 1e-12
    assert (record.systems.margin >= 0.0).all() and (record.systems.worst_margin >= 0.0).all()
    assert same_bits(record["q"][-1][slips], record.systems.q[slips])
    assert same_bits(record["q"][-1][slips], record["q"][-4][slips])
    clean = rollout.run(systems.copy(~slips), 0.2, STEP, least_margin=0.0, **given(rate[~slips]))
    for name, x in clean.systems.arrays.items():
        assert same_bits(x, record.systems.arrays[name][~slips]), name
    again = rollout.run(record.systems, 0.01, STEP, least_margin=0.0, **given(rate))
    assert same_bits(again.stopped[slips], record.systems.t[slips]) and np.isinf(again.stopped[~slips]).all()
    assert again.t[0] == pytest.approx(0.2, abs=1e-15)


def test_margins():
    """Machine code's margins are the reference's, those of wrench limits and of rigid grasps included."""
    rollout, state = gantries()
    limited = replace(rollout.chain.grasps["right"], wrench_limits=WrenchLimits(moment=2.0, force=45.0))
    chain = replace(rollout.chain, grasps=rollout.chain.grasps | {"right": limited})
    rate = np.array([400.0])
    for each in (rollout, compile_rollout(chain, rollout.law, scheme="midpoint")):
        systems = each.start(**arrays(state), **given(rate))
        least = systems.margin[0].copy()
        for _ in range(5):
            each.step(systems, 5e-3, **given(rate))
            expected = grasp_margins(each.chain, systems.state(0), systems.grasp_wrench[0])
            assert np.abs(systems.margin[0] - expected).max() <= 1e-12
            least = np.minimum(least, expected)
        assert systems.margin[0, 1] == pytest.approx(SQUEEZE if each is rollout else 45.0 - np.hypot(SQUEEZE, 5.0))
        assert np.abs(systems.worst_margin[0] - least).max() <= 1e-12
        assert systems.worst_time[0, 0] == pytest.approx(0.025)
    free = swinging("one")
    assert np.isinf(free.start(**arrays(problem("one")[1])).margin).all()
    (name,) = free.chain.grasps
    weak = replace(free.chain.grasps[name], wrench_limits=WrenchLimits(force=50.0))
    chain = replace(free.chain, grasps={name: weak})
    systems = compile_rollout(chain, free.law, scheme="midpoint").start(**arrays(problem("one")[1]))
    expected = grasp_margins(chain, systems.state(0), systems.grasp_wrench[0])
    assert np.isfinite(expected).all() and np.abs(systems.margin[0] - expected).max() <= 1e-11


@cache
def parallelogram() -> Rollout:
    """Return cranks that carry the object at a constant rate, through the flat position where rank is lost."""
    return compile_rollout(as_chain(planar_parallelogram(0.05, -0.7)).chain)


def cranks(*angles: float) -> dict[str, np.ndarray]:
    """Return states of the parallelogram, cranks turning towards flat at 0.7 rad/s."""
    states = [arrays(as_chain(planar_parallelogram(angle, -0.7)).state) for angle in angles]
    return {name: np.array([state[name] for state in states]) for name in states[0]}


@pytest.mark.slow
def test_singular_at_a_steps_end_or_inside():
    """A step that ends flat, one whose middle is flat, one that stays away: the first two are refused."""
    rollout, tau = parallelogram(), np.zeros(4)
    given = cranks(7 * 7e-3, 7.5 * 7e-3, 0.5)
    systems = rollout.start(**given, tau=tau)
    rollout.step(systems, 1e-2, steps=12, tau=tau)
    assert list(systems.status) == [RolloutStatus.SINGULAR, RolloutStatus.SINGULAR, RolloutStatus.RUNNING]
    assert np.allclose(systems.t, [0.06, 0.07, 0.12], atol=1e-12)
    assert np.allclose(systems.q[:2, 0], [7e-3, 3.5e-3], atol=1e-12)
    alone = rollout.step(rollout.start(**{k: x[2] for k, x in given.items()}, tau=tau), 1e-2, steps=12, tau=tau)
    assert all(same_bits(x[0], systems.arrays[name][2]) for name, x in alone.arrays.items())
    for row in (0, 1):
        at = systems.state(row)
        reference = ReferenceStepper(Environment(rollout.chain), lambda t, x, m: (tau, m), 9, RK4)
        now, _ = reference.start(0.0, at, None)
        assert isinstance(reference.advance(now, [1e-2])[0].failure, SingularChainError)


@pytest.mark.slow
@pytest.mark.parametrize("first", mostly_slow([True, False], [False]))
def test_singular_at_the_start(first):
    """A batch may begin with a singular system: it stands still, the generic rank is found from another."""
    rollout = compile_rollout(parallelogram().chain)
    angles = (0.0, 0.3, 0.4) if first else (0.3, 0.4, 0.0)
    systems = rollout.start(**cranks(*angles), tau=np.zeros(4))
    assert rollout.generic_rank == 9
    assert list(systems.running) == [angle > 0.0 for angle in angles]
    assert systems.status[angles.index(0.0)] is RolloutStatus.SINGULAR
    alone = compile_rollout(parallelogram().chain).start(**cranks(0.0), tau=np.zeros(4))
    assert list(alone.status) == [RolloutStatus.SINGULAR]


@pytest.mark.slow
def test_too_long_a_step():
    """A step that leaves a grasp open by more than a centimetre is refused, for that system only."""
    rollout, (_, state) = swinging("legs"), problem("legs")
    systems = rollout.start(**elsewhere(rollout.chain, state, 3))
    initial = systems.copy()
    rollout.step(systems, np.array([1e-3, 0.5, 1e-3]))
    assert list(systems.status) == [RolloutStatus.RUNNING, RolloutStatus.OPEN, RolloutStatus.RUNNING]
    assert np.allclose(systems.t, [1e-3, 0.0, 1e-3], atol=0.0)
    assert same_bits(systems.q[1], initial.q[1]) and same_bits(systems.qdd[1], initial.qdd[1])
    short = rollout.step(initial.copy(), 1e-3)
    assert same_bits(systems.q[[0, 2]], short.q[[0, 2]])
    far = elsewhere(rollout.chain, state, 2)
    far["object_pose"][1, 4] += 0.5
    assert list(rollout.start(**far).status) == [RolloutStatus.RUNNING, RolloutStatus.OPEN]


def broken(rows: dict[str, tuple[int, int, float]]) -> tuple[RolloutSystems, RolloutSystems]:
    """Return a batch with bad numbers in some systems, and a clean one, both a few steps later."""
    rollout, (_, state) = swinging("legs"), problem("legs")
    clean = elsewhere(rollout.chain, state, 12)
    dirty = {name: x.copy() for name, x in clean.items()}
    for name, (row, column, value) in rows.items():
        dirty[name][row, column] = value
    return tuple(rollout.step(rollout.start(**x), STEP, steps=3) for x in (dirty, clean))  # type: ignore[return-value]


@pytest.mark.slow
def test_bad_numbers():
    """Not-a-number, infinities, angles beyond 1e5 rad, quaternions not of unit length."""
    for rows in (
        {"q": (0, 2, np.nan), "qd": (3, 1, np.inf), "object_pose": (5, 0, 3.0), "object_twist": (11, 5, -np.inf)},
        {"q": (4, 6, 2e5), "qd": (0, 0, np.nan), "object_pose": (7, 5, np.nan), "object_twist": (1, 0, 1e200)},
    ):
        dirty, clean = broken(rows)
        bad = np.isin(np.arange(12), [row for row, _, _ in rows.values()])
        assert all((status is RolloutStatus.BROKEN) == wrong for status, wrong in zip(dirty.status, bad, strict=True))
        assert clean.running.all()
        assert not dirty.qdd[bad].any() and not dirty.t[bad].any()
        for name, x in clean.arrays.items():
            assert same_bits(x[~bad], dirty.arrays[name][~bad]), name


@pytest.mark.slow
def test_quaternion_of_no_length():
    """All zeros: invalid, without a warning."""
    rollout, (_, state) = swinging("legs"), problem("legs")
    given = elsewhere(rollout.chain, state, 2)
    given["object_pose"][0, :4] = 0.0
    assert list(rollout.start(**given).status) == [RolloutStatus.BROKEN, RolloutStatus.RUNNING]


@pytest.mark.slow
def test_torques_that_are_no_numbers():
    """They break the step they are given to: the state stays."""
    rollout = parallelogram()
    systems = rollout.start(**cranks(0.3, 0.4), tau=np.zeros(4))
    initial = systems.copy()
    rollout.step(systems, STEP, tau=np.array([[np.nan, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]]))
    assert list(systems.status) == [RolloutStatus.BROKEN, RolloutStatus.RUNNING]
    assert same_bits(systems.q[0], initial.q[0]) and systems.t[0] == 0.0
    rollout.step(systems, STEP, tau=np.zeros(4))  # too late
    assert list(systems.status) == [RolloutStatus.BROKEN, RolloutStatus.RUNNING]


@pytest.mark.parametrize("scheme", mostly_slow(["rk4", "midpoint"], ("rk4",)))
def test_feedback_that_blows_up_is_no_slip(scheme):
    """h gain / inertia from what a step can follow to far beyond: `TOO_LONG`, never `SLIPPED`; true slips stay."""
    chain, state = squeezed(("ball", "ball"), Friction(MU))

    def torque(t, state, memory, given):
        up = given["up"][()] * t
        return np.array([SQUEEZE, 0.0, up, -SQUEEZE, 0.0, up]) - given["gain"][()] * state.qd, memory

    rollout = compile_rollout(chain, ControlLaw(torque, parameters={"gain": (), "up": ()}), scheme=scheme)
    ratio = np.array([0.0, 1.0, 4.0, 10.7, 30.0, 1e3, 1e5, 0.0, 0.01])
    gains = {"gain": ratio * 2.0 / STEP, "up": np.array([40.0] * 7 + [1000.0] * 2)}
    systems = rollout.start(**tiled(state, 9), **gains)
    record = rollout.run(systems, 60 * STEP, STEP, least_margin=0.0, **gains)
    expected = [RolloutStatus.RUNNING] * 2 + [RolloutStatus.TOO_LONG] * 5
    assert list(record.systems.status[:7]) == expected
    assert (record.systems.status[7:] == RolloutStatus.SLIPPED).all()
    expected_times = [0.03, -np.log(0.7) / 10.0]  # a' + gain/2 a = 500 m/s^3
    assert record.stopped[7:] == pytest.approx(expected_times, rel=1e-6 if scheme == "rk4" else 1e-4)
    assert np.array_equal(record.stopped[2:7], record.systems.t[2:7]) and np.isinf(record.stopped[:2]).all()
    assert np.isfinite(record.systems.qd).all() and (record.systems.margin >= 0.0).all()
    again = rollout.step(record.systems.copy(), STEP, least_margin=0.0, **gains)
    assert list(again.status[2:7]) == expected[2:] and same_bits(again.q[2:7], record.systems.q[2:7])
