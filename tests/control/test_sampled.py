"""Sampled laws as functions: what is measured, commanded and refused."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import GravityCompensation, compile_law, noise_stream, sampled
from holdfast.errors import ModelError
from tests.control.two_pandas import two_pandas

CHAIN, STATE = two_pandas()
N = CHAIN.joint_count
EVERY = {"sample_time": 1e-3}


def joints(t, now, memory, given):
    """Return the measured joint positions as torques."""
    return now.q, memory


def commands(t, now, memory, given):
    """Return torques that are the time times one hundred, whatever the state."""
    return 100.0 * t * np.ones(N), memory


def asked(law: hf.ControlLaw, times) -> np.ndarray:
    """Return the torques of a law at some times, with the memory from one to the next, (times, n)."""
    memory, found = None, []
    for t in times:
        tau, memory = law(t, STATE, memory)
        found.append(tau)
    return np.array(found)


def test_measurements_lie_on_the_grid():
    """A resolution rounds to the nearest multiple; with noise, what is measured with noise is rounded."""
    step = 2.0 * np.pi / 2**14
    law = sampled(hf.ControlLaw(joints), CHAIN, **EVERY, resolution={"q": step})
    (tau,) = asked(law, [0.0])
    assert np.abs(tau - STATE.q).max() <= 0.5 * step * (1 + 1e-9)
    np.testing.assert_allclose(tau / step, np.round(tau / step), atol=1e-9)
    assert (tau != STATE.q).any()
    noisy = sampled(hf.ControlLaw(joints), CHAIN, **EVERY, resolution={"q": step}, noise={"q": 10 * step}, seed=1)
    tau = asked(noisy, 1e-3 * np.arange(50))
    np.testing.assert_allclose(tau / step, np.round(tau / step), atol=1e-9)
    assert 5.0 < (tau - STATE.q).std() / step < 15.0


def test_limits_of_commands():
    """By hand: 100 t is clipped at 1 after 10 samples; a change of 0.04 a sample follows 0.1 a sample more slowly."""
    times = 1e-3 * np.arange(40)
    ramp = hf.ControlLaw(commands)
    clipped = asked(sampled(ramp, CHAIN, **EVERY, saturation=1.0), times)
    np.testing.assert_allclose(clipped, np.minimum(100.0 * times, 1.0)[:, None] * np.ones(N), atol=1e-15)
    slow = asked(sampled(ramp, CHAIN, **EVERY, saturation=1.0, rate_limit=40.0), times)
    np.testing.assert_allclose(slow, np.minimum(40.0 * times, 1.0)[:, None] * np.ones(N), atol=1e-12)
    begun = asked(sampled(ramp, CHAIN, **EVERY, rate_limit=40.0), times + 0.01)
    np.testing.assert_allclose(begun[:, 0], 1.0 + 40.0 * times, atol=1e-12)  # no limit for the first
    efforts = np.array([joint.effort_limit for joint in CHAIN.all_joints])
    large = hf.ControlLaw(lambda t, now, memory, given: (1e4 * np.ones(N), memory))
    assert (asked(sampled(large, CHAIN, **EVERY, saturation=True), [0.0]) == efforts).all()
    rounded = asked(sampled(ramp, CHAIN, **EVERY, resolution={"tau": 0.03}), times)
    np.testing.assert_allclose(rounded[:, 0], 0.03 * np.rint(100.0 * times / 0.03), atol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.25, 1.0, 1.75, 3.0])
def test_what_acts_when(delay):
    """Torques act from `delay` samples after theirs, and the first ones from the start; by the definition."""
    law = sampled(hf.ControlLaw(commands), CHAIN, sample_time=4e-3, delay=delay * 4e-3)
    times = 1e-3 * np.arange(60)
    sample = np.maximum(np.floor(times / 4e-3 - delay + 1e-6), 0.0)
    np.testing.assert_allclose(asked(law, times)[:, 0], 100.0 * 4e-3 * sample, atol=1e-12)


@pytest.mark.slow
def test_noise_is_what_was_asked_for():
    """The sizes of all noises, by names; a pose turns and shifts; another stream, other numbers; the same, the same."""

    def measured(t, now, memory, given):
        return np.zeros(N), np.concatenate([now.q, now.qd, now.object_twist, now.object_pose])

    law = hf.ControlLaw(measured, memory=np.zeros(2 * N + 13))
    sizes = {"q": 1e-3, "qd": np.linspace(0.01, 0.02, N), "object_twist": 0.1, "object_pose": [0.01] * 3 + [0.002] * 3}
    noisy, found, memory = sampled(law, CHAIN, **EVERY, noise=sizes | {"tau": 0.5}, seed=2), [], None
    for k in range(4000):
        tau, memory = noisy(1e-3 * k, STATE, memory)
        found.append(np.concatenate([memory[: 2 * N + 13], tau]))
    x = np.array(found)
    exact = np.concatenate([STATE.q, STATE.qd, STATE.object_twist])
    expected = np.concatenate([np.full(N, 1e-3), sizes["qd"], np.full(6, 0.1)])
    share = 5.0 / np.sqrt(2 * 4000)  # five standard errors of a standard deviation
    np.testing.assert_allclose((x[:, : 2 * N + 6] - exact).std(axis=0), expected, rtol=share)
    np.testing.assert_allclose(x[:, -N:].std(axis=0), 0.5, rtol=share)
    poses = x[:, 2 * N + 6 : 2 * N + 13]
    assert np.abs(np.linalg.norm(poses[:, :4], axis=1) - 1.0).max() < 1e-12
    np.testing.assert_allclose((poses[:, 4:] - STATE.object_pose[4:]).std(axis=0), 0.002, rtol=share)
    np.testing.assert_allclose(2.0 * poses[:, 1:4].std(axis=0), 0.01, rtol=share)
    again, other = (asked(noise_stream(noisy, k), [0.0, 1e-3]) for k in (0, 1))
    assert (again == x[:2, -N:]).all()
    assert (other != again).all()


LAW = hf.ControlLaw(joints)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "sample_time: expected a number"),
        ({"sample_time": 0.0}, "sample_time: expected > 0"),
        ({"sample_time": 1e12}, "sample_time: expected at most"),
        ({"delay": -1e-3}, "delay: expected >= 0"),
        ({"delay": 1.0}, "delay: expected at most 100 samples"),
        ({"noise": {"q": 1e-3}}, "seed: expected an integer >= 0 for the noise, got none; try seed=0"),
        ({"noise": {"q": 1e-3}, "seed": -1}, "seed: expected an integer >= 0, got -1"),
        ({"noise": {"Q": 1e-3}, "seed": 1}, "noise: no 'Q'. Did you mean 'q'"),
        ({"noise": {"q": [1e-3, 1e-3]}, "seed": 1}, r"noise: q: expected a number from 1e-09 to 1e\+09, or \(14,\) of"),
        ({"noise": {"q": 0.0}, "seed": 1}, "noise: q: expected a number from"),
        ({"noise": 1e-3, "seed": 1}, "noise: expected"),
        ({"resolution": {"object_pose": 1e-3}}, "resolution: no 'object_pose'"),
        ({"resolution": {"q": -1e-3}}, "resolution: q: expected a number from"),
        ({"saturation": 0.0}, "saturation: expected a number from"),
        ({"rate_limit": "fast"}, "rate_limit: expected"),
    ],
    ids=str,
)
def test_impossible_arguments(options, message):
    """Refused with the name of the argument and what to do."""
    given = ({"sample_time": None} if not options else EVERY) | options
    with pytest.raises(ModelError, match=f"sampled: {message}"):
        sampled(LAW, CHAIN, **given)


def test_impossible_laws():
    """What cannot be traced, what has values already, what is sampled, joints without limits, laws without noise."""
    law = sampled(LAW, CHAIN, **EVERY)
    free = replace(
        CHAIN, arms={k: a.of(joints=[replace(j, effort_limit=np.inf) for j in a.joints]) for k, a in CHAIN.arms.items()}
    )
    for bad, chain, message in (
        (lambda t, now, memory: (now.q, memory), CHAIN, "got function; try ControlLaw"),
        (LAW.given({}), CHAIN, "got GivenLaw"),
        (law, CHAIN, "not sampled yet"),
    ):
        with pytest.raises(ModelError, match=message):
            sampled(bad, chain, **EVERY)
    with pytest.raises(ModelError, match="saturation: expected joints with effort limits, got none"):
        sampled(LAW, free, **EVERY, saturation=True)
    with pytest.raises(ModelError, match="noise_stream: law: expected a law with noise"):
        noise_stream(law, 3)
    noisy = sampled(GravityCompensation(CHAIN), CHAIN, **EVERY, noise={"tau": 1.0}, seed=0)
    with pytest.raises(ModelError, match="noise_stream: stream: expected an integer >= 0, got -1"):
        noise_stream(noisy, -1)


def test_as_machine_code():
    """Compiled, a law with all imperfections returns the torques and the memory of its function, sample by sample."""
    options = {"noise": {"q": 1e-3, "object_pose": 1e-3, "tau": 0.1}, "seed": 3, "resolution": {"q": 1e-4, "tau": 1e-3}}
    law = sampled(GravityCompensation(CHAIN), CHAIN, sample_time=2e-3, delay=1e-3, **options, rate_limit=1e4)
    fast, memory, others = compile_law(law, CHAIN), None, None
    for k in range(8):
        tau, memory = law(1e-3 * k, STATE, memory)
        expected, others = fast(1e-3 * k, STATE, others)
        np.testing.assert_allclose(tau, expected, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(memory, others, rtol=1e-12, atol=1e-9)


def test_what_is_no_function():
    """A law that depends on more than its arguments is refused before it is wrapped."""
    random = hf.ControlLaw(lambda t, now, memory, given: (np.random.normal(size=N) - now.qd, memory))
    with pytest.raises(ModelError, match="expected a function of its arguments alone"):
        sampled(random, CHAIN, **EVERY)
