"""Sampled laws in rollouts: as in `simulate`, as on paper, and the same bits however the work is divided."""

import pickle
from functools import cache

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import GravityCompensation, noise_stream, sampled
from holdfast.control.sampled import initial_memories
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.simulation import Rollout, RolloutSystems, Trajectory
from holdfast.simulation.events import Release
from holdfast.spatial.scalar import sin
from tests.longer import mostly_slow
from tests.simulation.gantries import BLOCK, LINK, pressed, squeezed
from tests.simulation.rollout.problems import problem, same, tiled
from tests.simulation.test_checkpoint import on_disk

H = 1e-3
IMPERFECT = {
    "noise": {"q": 1e-3, "qd": 1e-2, "object_twist": 1e-2, "object_pose": 1e-3, "tau": 0.1},
    "seed": 5,
    "resolution": {"q": 1e-3, "tau": 0.01},
    "saturation": 3.0,
    "rate_limit": 500.0,
}


@cache
def law(name: str) -> hf.ControlLaw:
    """Return springs towards where the joints began, with an integral, a drive of time, and feedback of the object."""
    chain, state = problem(name)
    home, n = state.q, chain.joint_count

    def torque(t, now, memory, given):
        drive = 0.3 * sin(40.0 * t) - 0.1 * now.object_twist[3] + 0.1 * now.object_pose[4]
        return given["stiffness"] * (home - now.q) - now.qd + drive - memory, memory + 0.01 * (now.q - home)

    return hf.ControlLaw(torque, memory=np.zeros(n), parameters={"stiffness": ()})


@cache
def rollout(name: str = "one", delay: float = 0.0, scheme: str = "rk4", imperfect: bool = False) -> Rollout:
    """Return the rollout of a law sampled every two steps; the delay is in samples."""
    chain, _ = problem(name)
    options = IMPERFECT if imperfect else {}
    sampled_law = sampled(law(name), chain, sample_time=2 * H, delay=2 * H * delay, **options)
    return hf.compile_rollout(chain, sampled_law, scheme=scheme)


def started(of: Rollout, count: int, name: str = "one", **given) -> RolloutSystems:
    """Return systems at the chain's state."""
    return of.start(**tiled(problem(name)[1], count), **({"stiffness": 5.0} | given))


def after_jumps(run: Trajectory, times: np.ndarray) -> np.ndarray:
    """Return the indices of the samples at some times, of two at a jump the later one."""
    return np.searchsorted(run.t, times + 1e-12, side="right") - 1


WAYS = [("one", delay, "rk4", False) for delay in (0.0, 0.5, 1.0, 2.5, 4.0)]
WAYS += [
    ("one", 1.5, "rk4", True),
    ("one", 0.0, "midpoint", True),
    ("five", 0.5, "rk4", False),
    ("five", 1.0, "rk4", True),
]


@pytest.mark.parametrize(("name", "delay", "scheme", "imperfect"), mostly_slow(WAYS, [WAYS[3]]))
def test_as_simulate(name, delay, scheme, imperfect):
    """The same law gives the same motion and torques, for delays of part of a sample and of several, and with noise."""
    of, (chain, state) = rollout(name, delay, scheme, imperfect), problem(name)
    record = of.run(started(of, 1, name), 0.03, H, record=("q", "qd", "object_pose", "object_twist", "tau"))
    run = hf.simulate(chain, state, of.law, 0.03, H, parameters={"stiffness": 5.0}, scheme=scheme)
    assert run.stopped is None
    at = after_jumps(run, record.t)
    for array in ("q", "qd", "object_pose", "object_twist"):
        assert np.abs(record[array][:, 0] - getattr(run, array)[at]).max() <= 1e-11, array
    assert np.abs(record["tau"][:-1, 0] - run.tau[at[:-1]]).max() <= 1e-9
    assert np.ptp(run.tau, axis=0).min() > 0.01


@pytest.mark.slow
def test_a_system_as_a_run_has_both_sides_of_jumps():
    """It has the samples of `simulate`, but for the last, at which a rollout has asked its law again."""
    of, (chain, state) = rollout("one", 0.5), problem("one")
    run = hf.simulate(chain, state, of.law, 0.02, H, parameters={"stiffness": 5.0})
    found = of.run(started(of, 1), 0.02, H).trajectory(0)
    assert found.t[: len(run)] == pytest.approx(run.t, abs=1e-15)
    for array in ("q", "tau", "grasp_wrench", "work", "momentum_imbalance"):
        assert np.abs(getattr(found, array)[: len(run) - 1] - getattr(run, array)[:-1]).max() <= 1e-9, array


@pytest.mark.slow
def test_simulate_takes_the_law_or_its_times():
    """A sampled law is a short way to write sample time and delay, to the bit; both at once are refused."""
    chain, state = problem("one")
    given = law("one").given({"stiffness": 5.0})
    for controller in (given, GravityCompensation(chain, joint_damping=0.2)):
        inner = law("one") if controller is given else controller
        timed = sampled(inner, chain, sample_time=2 * H, delay=H)
        one = hf.simulate(chain, state, controller, 0.01, H, sample_time=2 * H, delay=H)
        other = hf.simulate(chain, state, timed.given({"stiffness": 5.0}) if controller is given else timed, 0.01, H)
        for array in ("t", "q", "tau", "grasp_wrench"):
            assert getattr(one, array).tobytes() == getattr(other, array).tobytes()
        assert other.setting.options["sample_time"] == 2 * H
    for options, got in (({"sample_time": H}, r"0\.001 and 0\.0"), ({"delay": H}, r"None and 0\.001")):
        expected = rf"expected none beside a sampled law, which has 0\.002 s and 0\.001 s, got {got}"
        with pytest.raises(ModelError, match=expected):
            hf.simulate(chain, state, timed, 0.01, H, **options)


@pytest.mark.slow
def test_controllers_follow_the_grasps():
    """A controller that is another one without a grasp is so inside a sampled law, too, with its imperfections."""
    chain, state = squeezed(("rigid", "rigid"))

    class Law:
        traceable = True

        def __init__(self, chain):
            self.push = 1.0 + len(chain.grasps)

        def for_chain(self, chain):
            return Law(chain)

        def __call__(self, t, x, memory):
            return self.push * np.ones(6), memory

    for options in ({}, {"resolution": {"tau": 0.5}}, {"resolution": {"tau": 0.5}, "clip": True}):
        on_limit = "clip" if options.pop("clip", False) else "record"
        timed = sampled(Law(chain), chain, sample_time=0.1, **options)
        run = hf.simulate(chain, state, timed, 0.4, 0.1, events=[Release(0.2, "right")], on_limit=on_limit)
        assert run.tau[:, 0].tolist() == [3.0] * 4 + [2.0] * (len(run) - 4)


def on_paper(samples: int, ahead: int, later: float, period: float, gains: tuple[float, float]) -> np.ndarray:
    """Return position and rate at every sample of a mass of 3 kg under tau = -k x - c v; accelerations are constant.

    Torques of sample j begin at (j + ahead) period + later, those of the first at once.
    """
    x, v, commands, found = 1.0, 0.0, [], []
    for j in range(samples):
        found.append((x, v))
        commands.append(-gains[0] * x - gains[1] * v)
        for length, sample in ((later, j - ahead - 1), (period - later, j - ahead)):
            a = commands[max(sample, 0)] / (BLOCK + LINK)
            x, v = x + v * length + 0.5 * a * length**2, v + a * length
    return np.array(found)


@pytest.mark.parametrize(
    ("ahead", "later"), mostly_slow([(0, 0.0), (0, 2e-3), (1, 0.0), (1, 3e-3), (3, 0.0)], [(0, 0.0), (1, 3e-3)])
)
def test_double_integrator(ahead, later):
    """A sliding mass under a sampled spring and damper is a linear map from sample to sample: exact, for any delay."""
    chain, _ = pressed()
    period, gains = 5e-3, (300.0, 25.0)

    def torque(t, now, memory, given):
        return -gains[0] * now.q - gains[1] * now.qd, memory

    timed = sampled(hf.ControlLaw(torque), chain, sample_time=period, delay=ahead * period + later)
    of = hf.compile_rollout(chain, timed)
    systems = of.start([[1.0]], [0.0], [1, 0, 0, 0, 0, 0, 1.0], np.zeros(6))
    record = of.run(systems, 0.3, H, record=("q", "qd"))
    expected = on_paper(60, ahead, later, period, gains)
    found = np.concatenate([record["q"], record["qd"]], axis=2)[:-1:5, 0]
    assert np.abs(found - expected).max() <= 1e-11


def test_gain_at_the_border_of_stability():
    """By Jury's criterion: v' = (1 - c T / m) v is stable up to c = 2 m / T; with a delay of one sample up to m / T."""
    chain, _ = pressed()
    mass = BLOCK + LINK

    def torque(t, now, memory, given):
        return -given["damping"] * now.qd, memory

    for delay, border in ((0.0, 2.0 * mass / H), (H, mass / H)):
        of = hf.compile_rollout(
            chain, sampled(hf.ControlLaw(torque, parameters={"damping": (1,)}), chain, sample_time=H, delay=delay)
        )
        damping = border * np.array([[0.99], [1.01]])
        systems = of.start(np.zeros((2, 1)), [1.0], [1, 0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1.0], damping=damping)
        of.step(systems, H, steps=2000)
        assert np.abs(systems.qd[0]) < 1e-3 < 1e2 < np.abs(systems.qd[1])


@pytest.mark.slow
def test_bits_however_the_work_is_divided(tmp_path):
    """Noise belongs to a system and its sample: batches, threads, records, calls and processes change no bit."""
    of = rollout("one", 0.5, imperfect=True)
    whole = started(of, 7)
    of.step(whole, H, steps=20)
    assert np.unique(whole.q[:, 0]).size == 7  # each has its own
    memories = initial_memories(of.law, range(7))
    for rows in ([0, 1, 2], [6], [5, 3]):
        part = started(of, len(rows), memory=memories[rows])
        of.step(part, H, steps=20)
        assert same(part, whole.copy(rows))
    threaded = of.step(started(of, 7), H, steps=20, threads=3)
    assert same(threaded, whole)
    piecewise = started(of, 7)
    for count in (1, 4, 7):
        of.step(piecewise, H, steps=count)
    again, systems = pickle.loads(pickle.dumps((of, piecewise)))
    again.step(systems, H, steps=8)
    assert same(systems, whole)
    for options in ({}, {"every": 3}, {"folder": tmp_path / "record"}):
        assert same(of.run(started(of, 7), 0.02, H, **options).systems, whole)
    alone = hf.compile_rollout(of.chain, noise_stream(of.law, 5))
    one = started(alone, 1, memory=alone.law.memory)
    alone.step(one, H, steps=20)
    assert same(one, whole.copy([5]))
    run = hf.simulate(*problem("one"), alone.law, 0.02, H, parameters={"stiffness": 5.0})
    assert np.abs(run.q[-1] - whole.q[5]).max() <= 1e-11


def test_going_on_from_a_checkpoint():
    """A run with noise, torques that wait and an integral goes on to the bit, through disk."""
    chain, state = problem("one")
    timed, checkpoints = rollout("one", 1.5, imperfect=True).law, []
    given = {"parameters": {"stiffness": 5.0}}
    whole = hf.simulate(chain, state, timed, 0.02, H, on_checkpoint=checkpoints.append, **given)
    k = len(checkpoints) // 2
    rest = hf.simulate(chain, state, timed, 0.02, H, start=on_disk(checkpoints[k]), **given)
    for array in ("t", "q", "tau"):
        assert getattr(rest, array).tobytes() == getattr(whole, array)[k + 1 :].tobytes()


def test_limits_hold_at_every_sample():
    """What is commanded stays within the limits, and changes no faster, in every system."""
    chain, _ = problem("one")
    options = {"saturation": 2.0, "rate_limit": 100.0}
    of = hf.compile_rollout(chain, sampled(law("one"), chain, sample_time=2 * H, **options))
    tau = of.run(started(of, 3, stiffness=np.array([5.0, 500.0, 5e3])), 0.06, H, record=("tau",))["tau"]
    assert np.abs(tau).max() <= 2.0
    assert (np.abs(tau[1:]).max(axis=(0, 2)) == 2.0).sum() >= 1
    changes = np.abs(np.diff(tau, axis=0))
    assert changes.max() <= 0.2 * (1 + 1e-12)
    assert changes[1::2].max() > 0.0 == changes[::2].max()


@pytest.mark.slow
def test_steps_in_parts_take_no_more_samples():
    """A step that is divided, or repeated to confirm a slip, samples once, at its end."""
    of = rollout("five", 0.5)
    size = len(of.law.torque.law.memory)
    systems = of.step(started(of, 2, "five"), H, steps=8, largest_drift=1e-15)
    assert (systems.memory[:, size + 1] == 5.0).all()
    np.testing.assert_allclose(systems.memory[:, size], 8 * H, rtol=1e-12)
    whole = of.step(started(of, 2, "five"), H, steps=8)
    assert 0.0 < np.abs(systems.q - whole.q).max() < 1e-6


@pytest.mark.slow
def test_gradients():
    """Those of the discrete steps with delayed torques, beside central differences; clipped torques have none."""
    chain, state = problem("one")
    options = {"noise": {"q": 1e-3, "tau": 0.1}, "seed": 5, "saturation": 30.0}
    of = hf.compile_rollout(chain, sampled(law("one"), chain, sample_time=2 * H, delay=H, **options))

    def tape(stiffness, turned=0.0):
        given = tiled(state, 1)
        given["qd"] = given["qd"] + turned
        return of.tape(of.start(**given, stiffness=stiffness), H, steps=30)

    found = tape(50.0).vjp({"q": np.arange(1.0, 7.0)[None]}, by=("stiffness", "qd"))
    weigh, e = np.arange(1.0, 7.0), 1e-3
    by_stiffness = weigh @ (tape(50.0 + e).systems.q - tape(50.0 - e).systems.q)[0] / (2 * e)
    assert found["stiffness"][0] == pytest.approx(by_stiffness, rel=1e-6)
    direction = np.linspace(-1.0, 1.0, 6)
    by_rates = weigh @ (tape(50.0, e * direction).systems.q - tape(50.0, -e * direction).systems.q)[0] / (2 * e)
    assert found["qd"][0] @ direction == pytest.approx(by_rates, rel=1e-4)
    with pytest.raises(StateError, match="tape: by: no 'step'"):
        tape(50.0).vjp(by=("step",))
    rounded = rollout("one", 0.5, imperfect=True)
    with pytest.raises(MethodNotApplicable, match=r"expected no rounding of what is varied.*try a law without"):
        rounded.tape(started(rounded, 1), H, steps=2).vjp()


@pytest.mark.slow
def test_steps_that_miss_samples():
    """Refused before anything moves, with the steps that would do."""
    chain, _ = problem("one")
    of = rollout("one", 0.5)
    for step, message in (
        (1.5e-3, "expected one that divides the sample time 0.002 s and the delay 0.001 s of the law, got 0.0015 s; try"
         " 0.001 s"),
        (4e-4, "try 0.0005 s or 0.000333333 s"),
        (2e-3, "try 0.001 s"),
    ):  # fmt: skip
        systems = started(of, 1)
        for call in (
            lambda step=step, systems=systems: of.step(systems, step),
            lambda step=step, systems=systems: of.run(systems, 12 * step, step),
            lambda step=step, systems=systems: of.tape(systems, step, steps=1),
        ):
            with pytest.raises(StateError, match=message):
                call()
        assert systems.t[0] == 0.0
    late = hf.compile_rollout(chain, sampled(law("one"), chain, sample_time=2 * H))
    systems = late.step(started(late, 1), H)
    with pytest.raises(StateError, match=r"at 0\.001 s after the last sample of system 0; try steps of 0\.001 s"):
        late.step(systems, 2 * H)
    late.step(late.step(systems, H), 2 * H)


@pytest.mark.slow
def test_another_rollout_samples_again():
    """Where grasps open at a sample, the new rollout's law is asked, as in `simulate`; in between, torques stay."""
    chain, state = squeezed(("rigid", "rigid"))
    one_hand = chain.without_grasp("right")
    laws = [hf.ControlLaw(lambda t, x, m, given, k=k: (k * np.ones(6), m)) for k in (1.0, 2.0)]
    both, single = (
        hf.compile_rollout(c, sampled(one, c, sample_time=2 * H))
        for c, one in zip((chain, one_hand), laws, strict=True)
    )
    systems = both.step(both.start(**tiled(state, 1)), H, steps=4)
    assert single.take_over(systems).tau[0, 0] == 2.0
    between = single.take_over(both.step(systems, H))
    assert between.tau[0, 0] == 1.0
    assert single.step(between, H).tau[0, 0] == 2.0
