"""A sampled controller: asked once a sample, its torques held and delayed, and every law of a run as before."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast import ControlLaw, Friction, simulate
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.errors import ModelError, StateError
from holdfast.simulation.events import Attach, Release
from holdfast.simulation.rollout.compiled_steppers import STEPS_WORTH_COMPILING
from holdfast.simulation.trajectory import Trajectory, array_names
from tests.longer import mostly_long, mostly_slow
from tests.simulation.gantries import PUSHED, contact_frame, pressed, squeezed
from tests.simulation.rollout.problems import problem
from tests.simulation.test_checkpoint import on_disk
from tests.systems.n_four_bar import n_four_bar, passing_times

N = 6
PERIOD = 2e-3


class Swinging:
    """A law that branches, remembers, and keeps a list of how it was asked: no such thing can be traced."""

    def __init__(self) -> None:
        self.asked: list[tuple[float, hf.State]] = []
        self.told: list[np.ndarray] = []

    def __call__(self, t, state, memory):
        self.asked.append((t, state))
        count = 0 if memory is None else memory
        tau = 5.0 * np.cos(np.arange(len(state.q)) + 40.0 * t) - state.qd + (0.3 if count % 3 else 0.0)
        self.told.append(tau)
        return tau, count + 1


def sampled(law, samples: float, step: float = PERIOD, name: str = "one", **options) -> Trajectory:
    """Return a run of so many samples."""
    chain, state = problem(name)
    return simulate(chain, state, law, samples * PERIOD, step, sample_time=PERIOD, **options)


WAYS = [
    {}, {"step": 0.3 * PERIOD}, {"step": 2.0 * PERIOD}, {"delay": 2.0 * PERIOD}, {"delay": 0.4 * PERIOD},
    {"scheme": "midpoint", "largest_drift": 1e-9, "step": PERIOD / 4}, {"samples": 2 * STEPS_WORTH_COMPILING + 0.5},
]  # fmt: skip


@pytest.mark.parametrize(
    "options", mostly_slow(WAYS, (WAYS[4], WAYS[6])) + mostly_long([{"scheme": "dop853"}], ()), ids=str
)
def test_asked_once_a_sample_and_held(options):
    """One question a sample, with time and state of that sample; the torques act from then, or later, to the bit."""
    law, delay = Swinging(), options.get("delay", 0.0)
    given = {"samples": 6} | options
    run = sampled(law, **given)
    count = int(np.ceil(given["samples"]))
    assert [t for t, _ in law.asked] == (PERIOD * np.arange(count)).tolist()
    for t, state in law.asked:
        k = int(np.searchsorted(run.t, t))
        assert run.t[k] == t
        for part in ("q", "qd", "object_pose", "object_twist"):
            assert np.array_equal(getattr(state, part), getattr(run, part)[k])
    assert (np.diff(run.t) > 0.0).all()
    acting = np.clip(np.floor((run.t - delay) / PERIOD + 1e-9), 0, count - 1).astype(int)
    # the near side of a jump is one float before it
    before = np.flatnonzero(np.diff(run.t) < 1e-12)
    acting[before] = acting[before + 1] - 1
    acting[-1] = acting[-2]  # nothing begins at the run's end
    assert np.array_equal(run.tau, np.array(law.told)[acting])
    assert run.stopped is None


BY_PIECES = [("rk4", 0.0), ("rk4", PERIOD), ("dop853", 0.0)]


@pytest.mark.parametrize(("scheme", "delay"), mostly_long(BY_PIECES, BY_PIECES[:2]))
def test_run_made_piece_by_piece(scheme, delay):
    """It is the chain of runs under constant torques, each from where the one before has ended."""
    law, count = Swinging(), 5
    run = sampled(law, count, step=PERIOD / 2, scheme=scheme, delay=delay)
    chain, state = problem("one")
    mine, memory, waiting = Swinging(), None, []
    for k in range(count):
        tau, memory = mine(k * PERIOD, state, memory)
        waiting.append(tau)
        acting = waiting[max(0, k - round(delay / PERIOD))]
        piece = simulate(chain, state, lambda t, x, m, tau=acting: (tau, m), PERIOD, PERIOD / 2, scheme=scheme)
        state = piece.state(-1)
        end = run.state(int(np.searchsorted(run.t, (k + 1) * PERIOD * (1 - 1e-12))))
        for part in ("q", "qd", "object_pose", "object_twist"):
            assert np.abs(getattr(state, part) - getattr(end, part)).max() <= 1e-11


def test_whatever_gives_the_torques():
    """A traced law, a ready-made controller and a schedule go by the same samples as a function that asks them."""
    chain, _ = problem("one")
    memory = np.linspace(0.0, 1.0, N)
    remembers = ControlLaw(lambda t, x, m, given: (0.9 * m - x.qd, 0.9 * m + x.q), memory=memory, key="remembering")
    schedule = TorqueSchedule.linear([0.0, 1.3 * PERIOD, 1.0], np.outer([0.0, 1.0, -2.0], np.arange(N)))
    for law in (remembers, GravityCompensation(chain, joint_damping=0.2), schedule):
        asked = []

        def wrapped(t, x, memory, law=law, asked=asked):
            asked.append(t)
            return law(t, x, memory)

        plain, inside = (sampled(one, 4) for one in (law, wrapped))
        assert len(asked) == 4
        for name in array_names():
            assert getattr(plain, name).tobytes() == getattr(inside, name).tobytes()


def test_balances():
    """Energy comes out to rounding although torques jump; momentum by the trapezium rule of two samples a piece."""
    coarse, fine = (sampled(Swinging(), 8, step=PERIOD / parts) for parts in (4, 8))
    moved = np.abs(coarse.work).sum(axis=1).max()
    assert np.abs(coarse.imbalance).max() <= 1e-9 * moved
    assert np.abs(fine.imbalance).max() <= 1e-9 * moved
    for run in (coarse, fine):
        assert np.abs(run.momentum_imbalance).max() <= 1e-6 * np.abs(run.momentum).max()
    # power by finite differences inside a piece, where nothing jumps: of order 8
    h = fine.t[1] - fine.t[0]
    energy = (fine.kinetic + fine.potential)[:9]
    weights = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    joints, qd = problem("one")[0].all_joints, fine.qd[4]
    lost = [joint.damping * v + joint.friction * v / np.hypot(v, 0.05) for joint, v in zip(joints, qd, strict=True)]
    power = (fine.tau[4] - lost) @ qd
    assert weights @ energy / h == pytest.approx(power, rel=1e-6)


def test_between_samples():
    """The dense motion follows a finer run to the order that it has where nothing jumps."""
    coarse, fine = (sampled(Swinging(), 4, step=PERIOD / parts) for parts in (1, 8))
    for t in PERIOD * np.array([0.5, 1.25, 2.75, 3.5]):
        assert np.abs(coarse.state_at(float(t)).q - fine.state_at(float(t)).q).max() <= 2e-10


DELAYED = [{"delay": 0.4 * PERIOD}, {"scheme": "dop853", "delay": PERIOD}]


@pytest.mark.slow
@pytest.mark.parametrize("options", mostly_long(DELAYED, DELAYED[:1]), ids=str)
def test_going_on_changes_no_bit(options):
    """From a checkpoint through disk, with torques that wait and a memory."""
    chain, state = squeezed(("softfinger", "ball"), (Friction(0.5, torsion_radius=0.02), Friction(0.5)), ("x", ""))

    def law(t, x, memory):
        count, filtered = memory or (0, np.zeros(len(x.qd)))
        filtered = 0.9 * filtered + 0.1 * x.qd
        force = 20.0 + (count % 3)
        return np.array([force, 0, 0, 0.01, -force, 0, 0.1]) - 0.5 * filtered, (count + 1, filtered)

    grasp = hf.Grasp("ball", contact_frame(1.0), Friction(0.5))
    events = [Release(1.7 * PERIOD, "right"), Attach(3 * PERIOD, "right", grasp, here=True)]
    options = options | {"events": events, "on_slip": "release", "sample_time": PERIOD}
    checkpoints = []
    given = chain, state, law, 5 * PERIOD, PERIOD
    whole = simulate(*given, **options, on_checkpoint=checkpoints.append)
    assert whole.stopped is None
    assert {one.kind for one in whole.occurrences} >= {"attach", "release"}
    waiting = [k for k, one in enumerate(checkpoints) if one.held.waiting]
    k = waiting[len(waiting) // 2]
    rest = simulate(*given, **options, start=on_disk(checkpoints[k]))
    for name in array_names():
        assert getattr(rest, name).tobytes() == getattr(whole, name)[k + 1 :].tobytes(), name
    expected = r"start: expected sample_time=0.002 and delay=.*, as the run began with, got no"
    with pytest.raises(StateError, match=expected):
        simulate(*given, start=checkpoints[3])


def test_margins_on_both_sides_of_a_jump():
    """A limit is passed at a sample and kept again at the next: both exactly then, and nothing is searched between."""
    chain, state = pressed(effort_limit=10.0)

    def law(t, x, memory):
        k = round(t / PERIOD)
        return [12.5 if k == 2 else (9.0, 3.0)[k % 2]], memory

    run = simulate(chain, state, law, 5 * PERIOD, PERIOD / 2, sample_time=PERIOD)
    assert [(one.kind, one.t) for one in run.occurrences] == [("violation", 2 * PERIOD), ("recovery", 3 * PERIOD)]
    assert run.occurrences[1].lowest == -2.5
    assert run.lowest_joint_margin[:, 2].tolist() == (10.0 - np.abs(run.tau[:, 0])).tolist()
    stopped = simulate(chain, state, law, 5 * PERIOD, PERIOD, sample_time=PERIOD, on_limit="stop")
    assert stopped.t[-1] == 2 * PERIOD
    assert stopped.stopped is not None and "effort limit at t = 0.004" in stopped.stopped
    clipped = simulate(chain, state, law, 5 * PERIOD, PERIOD, sample_time=PERIOD, on_limit="clip")
    assert clipped.tau.max() == 10.0
    assert clipped.occurrences == ()


def test_a_slip_between_samples_and_one_at_a_sample():
    """A grasp that lets go because a sample pulls slips at that sample; what acts is pulled by a delay as long."""
    chain, state = pressed()

    def pull(t, x, memory):
        return [3.0 if t < 2.5 * PERIOD else -3.0], memory

    for delay in (0.0, 0.6 * PERIOD):
        run = simulate(chain, state, pull, 5 * PERIOD, PERIOD, sample_time=PERIOD, delay=delay)
        assert run.stopped is not None and "lifts off" in run.stopped
        assert run.t[-1] == pytest.approx(3 * PERIOD + delay, abs=1e-15)
        assert run.margin[-2:, 0] == pytest.approx([0.5 * 3.0 * PUSHED, -3.0 * PUSHED])


def test_gains_too_high_for_the_sample_time():
    """Damping that settles as a function of time shakes when it is sampled; what then ends the run says so."""
    chain, state = pressed(rate_limit=1e3)

    def law(t, x, memory):
        return [3.0 - 1e4 * (x.qd[0] - 1.0)], memory

    assert simulate(chain, state, law, 0.004, 1e-4, on_slip="record").stopped is None
    run = simulate(chain, state, law, 0.2, 1e-3, sample_time=1e-3, on_slip="record")
    rates = np.abs(run.qd[2::2, 0] - 1.0)[:5]
    # by hand: v - 1 is multiplied by 1 - 1e4 T / 3 kg a sample
    np.testing.assert_allclose(rates[1:] / rates[:-1], 1e4 * 1e-3 / 3.0 - 1.0, rtol=0.01)
    assert run.stopped is not None
    assert "lower gains: they may be too high for a sample time of 0.001 s" in run.stopped


def test_events_at_samples_come_first():
    """A grasp that opens at a sample has opened when the controller is asked; rounding keeps no two times apart."""
    chain, state = squeezed(("rigid", "rigid"))
    asked = []

    class Law:
        def __init__(self, chain):
            self.grasps = tuple(chain.grasps)

        def for_chain(self, chain):
            return Law(chain)

        def __call__(self, t, x, memory):
            asked.append((t, self.grasps))
            return np.zeros(6), memory

    release = 0.3  # three times 0.1 is one float later
    run = simulate(chain, state, Law(chain), 0.5, 0.1, sample_time=0.1, events=[Release(release, "right")])
    assert [t for t, _ in asked] == [0.0, 0.1, 0.2, release, 0.4]
    assert [len(grasps) for _, grasps in asked] == [2, 2, 2, 1, 1]
    assert len(run) == 10


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sample_time": 0.0}, "sample_time: expected > 0, got 0"),
        ({"sample_time": -1e-3}, "sample_time: expected > 0"),
        ({"sample_time": np.inf}, "sample_time: expected finite numbers, got inf"),
        ({"sample_time": "fast"}, "sample_time: expected a number"),
        ({"sample_time": 1e-12}, "sample_time: expected at most 10000000 samples, got 1e.10; try a larger"),
        ({"delay": 1e-3}, "delay: expected a sample_time with it, got 0.001 s alone.*try sample_time=1e-3"),
        ({"sample_time": 1e-3, "delay": -1e-3}, "delay: expected >= 0"),
        ({"sample_time": 1e-3, "delay": np.nan}, "delay: expected finite numbers"),
        ({"sample_time": 1e-3, "delay": 0.01}, "delay: expected less than the duration 0.01 s, got 0.01 s"),
        ({"sample_time": 1e-3, "breakpoints": ["soon"]}, "breakpoints: expected"),
    ],
    ids=str,
)
def test_impossible_samples(options, message):
    """Refused before anything moves, with what to do instead."""
    chain, state = pressed()
    with pytest.raises(ModelError, match=f"simulation: {message}"):
        simulate(chain, state, lambda t, x, m: (np.zeros(1), m), 0.01, 1e-3, **options)


def test_torques_of_another_shape():
    """At the first sample nothing begins; later the run ends there and says why."""
    chain, state = pressed()
    with pytest.raises(StateError, match="controller: torques: expected shape"):
        simulate(chain, state, lambda t, x, m: (np.zeros(2), m), 0.01, 1e-3, sample_time=2e-3)
    run = simulate(chain, state, lambda t, x, m: (np.ones(1 if t < 3e-3 else 2), m), 0.01, 1e-3, sample_time=2e-3)
    assert run.stopped is not None
    assert "controller: torques: expected shape (1,)" in run.stopped
    assert run.t[-1] == np.nextafter(4e-3, 0.0)


def test_array_that_the_law_writes_again():
    """A law may return the same array every time: what acts is what it held then."""
    chain, state = pressed()
    buffer = np.zeros(1)

    def law(t, x, memory):
        buffer[:] = 1.0 + t
        return buffer, memory

    run = simulate(chain, state, law, 0.008, 1e-3, sample_time=2e-3, delay=2e-3)
    assert np.unique(run.tau).tolist() == [1.0, 1.002, 1.004]


def test_kept_with_the_run(tmp_path):
    """Sample time and delay are in the setting, of a run in memory and of one on disk."""
    run = sampled(Swinging(), 3, delay=PERIOD)
    for one in (run, hf.load_result(run.save(tmp_path / "run")).whole_run()):
        assert one.setting.options["sample_time"] == one.setting.options["delay"] == PERIOD
    chain, state = problem("one")
    assert "sample_time" not in simulate(chain, state, Swinging(), 2e-3, 1e-3).setting.options


BESIDE = [{"scheme": "rk4"}, {"scheme": "dop853", "rtol": 1e-9}]


@pytest.mark.slow
@pytest.mark.parametrize("options", mostly_long(BESIDE, BESIDE[:1]), ids=str)
def test_samples_beside_a_singular_configuration(options):
    """The long step that passes a configuration ends at a sample too, where nothing jumps: none is late."""
    chain, state = n_four_bar(2)
    (passing,) = passing_times(2, 1)
    period, asked = (passing + 0.002) / 20, []

    def law(t, x, memory):
        asked.append((t, x))
        return np.zeros(chain.joint_count), memory

    given = {"sample_time": period, "delay": 0.4 * period, "on_singular": "continue"} | options
    run = simulate(chain, state, law, passing + 0.03, 1e-2, **given)
    assert run.stopped is None
    assert [one.kind for one in run.occurrences] == ["singular"]
    last = dict(asked)  # a sample ahead of a step that is then taken in parts is asked for again
    assert len(last) == int(np.ceil(run.t[-1] / period))
    for t, x in last.items():
        k = int(np.searchsorted(run.t, t))
        assert run.t[k] == t
        assert np.array_equal(run.q[k], x.q)
