"""Identification of random payloads on random arms, against motions and loads by textbook equations (`by_hand`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

import holdfast as hf
from holdfast.identification import Recording
from holdfast.robots import iiwa14
from tests.identification.by_hand import NOISES, Case, loads, random_case
from tests.longer import mostly_long

BY = ("wrist_wrench", "tau")
RIGID = hf.Grasp("rigid", hf.Pose.identity())


def found_of(case: Case) -> hf.identification.Identification:
    return hf.identify(case.chain, case.recording, by=case.by)


def deviations_off(case: Case, found: hf.identification.Identification) -> np.ndarray:
    """Return the errors of what is determined, in standard deviations."""
    deviations = np.array([found.deviations[name] for name in found.names])
    told = np.isfinite(deviations)
    assert {name for name, one in zip(found.names, told, strict=True) if not one} == {*found.kept, *found.partly}
    return ((found.values - case.truth) / deviations)[told]


def is_bounded(found: hf.identification.Identification) -> bool:
    return any("feasible body" in note for note in found.notes)


@pytest.mark.parametrize("by", BY)
@pytest.mark.parametrize("seeds", [range(2), *mostly_long([range(2, 12)], ())])
def test_exact_data_give_the_payload(by, seeds):
    """To 1e-9 of its size for guesses within a factor of ten, or the value is named as kept."""
    for seed in seeds:
        case = random_case(seed, "exact", by)
        found = found_of(case)
        named = np.isin(found.names, (*found.kept, *found.partly))
        assert np.abs((found.values - case.truth) / case.sizes)[~named].max() < 1e-9, seed
        assert found.misfit < 1e-9 and not any("correlated" in note for note in found.notes)


@pytest.mark.parametrize(
    "seeds",
    [
        pytest.param(range(100, 106), marks=pytest.mark.slow),
        pytest.param(range(1000, 1167), marks=pytest.mark.long),  # 2,004 cases together
    ],
)
@pytest.mark.parametrize("by", mostly_long(BY, ["wrist_wrench"]))
@pytest.mark.parametrize("noise", mostly_long(NOISES, ["white positions"]))
def test_intervals_hold_the_truth(noise, by, seeds):
    """Of the 90 % intervals, 85 to 95 % do; nothing determined is off by more than five deviations."""
    within, count = 0, 0
    for seed in seeds:
        case = random_case(seed, noise, by)
        found = found_of(case)
        if noise == "exact":
            named = np.isin(found.names, (*found.kept, *found.partly))
            assert np.abs((found.values - case.truth) / case.sizes)[~named].max() < 1e-9, seed
            continue
        off = np.abs(deviations_off(case, found))
        if noise == "coloured":
            assert any("correlated" in note for note in found.notes), seed
            continue
        assert off.max(initial=0.0) < 5.0, (seed, found)
        if not is_bounded(found):
            within, count = within + int((off < 1.645).sum()), count + len(off)
    if count:
        print(f"{noise}, {by}: {within} of {count} values within their 90 % intervals")
        cases = max(count // 10, 1)  # errors of one case are correlated: it counts as one or two
        assert binom.ppf(0.001, cases, 0.85) / cases <= within / count
        assert within / count <= max(0.95, binom.ppf(0.999, cases, 0.95) / cases)


@pytest.mark.slow
@pytest.mark.parametrize("by", BY)
def test_coloured_noise_is_noted(by):
    """Its deviations are wider than for white noise of the same size."""
    rng = np.random.default_rng(5)
    case = random_case(3, "exact", by, samples=400)
    exact = np.asarray(getattr(case.recording, by))
    white = rng.normal(size=exact.shape)
    lasting = white.copy()
    for k in range(1, len(white)):
        lasting[k] = 0.9 * lasting[k - 1] + np.sqrt(1 - 0.81) * white[k]
    found = {
        name: hf.identify(
            case.chain, replace(case.recording, **{by: exact + 0.05 * noise}), by=by, largest_deviation=9.0
        )
        for name, noise in (("white", white), ("coloured", lasting))
    }
    assert not any("correlated" in note for note in found["white"].notes)
    assert any("correlated" in note for note in found["coloured"].notes)
    for name in found["white"].names:
        assert found["coloured"].deviations[name] >= found["white"].deviations[name]


def lifted(rate: float = 100.0, step: float = 1e-4, white: float = 0.0) -> tuple[hf.ClosedChain, Recording]:
    """Return a slider that lifts 2 kg along a sine, its encoder with steps or noise, its wrist sensor exact."""
    joints, links = [hf.Joint("prismatic", axis=[0, 0, 1])], [hf.Link(5.0, inertia=0.05 * np.eye(3))]
    chain = hf.ClosedChain({"lift": hf.Arm(joints, links)}, hf.HeldObject.box(1.0, 0.1, 0.1, 0.1), {"lift": RIGID})
    t, w = np.arange(0.0, 5.0, 1.0 / rate), 1.6 * np.pi
    z = 0.1 * np.sin(w * t)
    wrench = np.zeros((len(t), 1, 6))
    wrench[:, 0, 5] = 2.0 * (9.81 - w * w * z)
    z = step * np.round(z / step) if step else z
    return chain, Recording(t, (z + white * np.random.default_rng(0).normal(size=len(t)))[:, None], wrist_wrench=wrench)


@pytest.mark.slow
@pytest.mark.parametrize(("step", "white"), [(1e-4, 0.0), (0.0, 1e-4)])
def test_noisy_positions(step, white):
    """Twice differentiated without smoothing, they gave 1.26 +- 0.02 kg for 2; dropping samples changes nothing."""
    chain, whole = lifted(step=step, white=white)
    every = hf.identify(chain, whole)
    assert abs(every.values[0] - 2.0) < 5 * every.deviations["mass"] < 0.01
    assert any("positions have noise" in note for note in every.notes)
    half = hf.identify(chain, Recording(whole.t[::2], whole.q[::2], wrist_wrench=np.asarray(whole.wrist_wrench)[::2]))
    apart = abs(every.values[0] - half.values[0])
    assert apart < 4 * np.hypot(every.deviations["mass"], half.deviations["mass"])


@pytest.mark.slow
def test_accelerations_that_are_noisy_are_named():
    """Given with noise, they draw the mass towards zero, and a note says so."""
    chain, exact = lifted(step=0.0)
    t, w = np.asarray(exact.t), 1.6 * np.pi
    qd, qdd = (0.1 * w * np.cos(w * t))[:, None], (-0.1 * w * w * np.sin(w * t))[:, None]
    noisy = qdd + 0.5 * np.random.default_rng(0).normal(size=qdd.shape)
    assert hf.identify(chain, replace(exact, qd=qd, qdd=qdd)).notes == ()
    assert "qdd has noise" in hf.identify(chain, replace(exact, qd=qd, qdd=noisy)).notes[-1]


def carried(mass: float, guess: float, samples: int = 20) -> tuple[hf.ClosedChain, hf.HeldObject, Recording]:
    """Return exact torques of an iiwa14 that carries a box slowly; the guess has another mass and size."""
    rng, arm, t = np.random.default_rng(1), iiwa14(), np.linspace(0.0, 4.0, samples)
    f, phase = 2 * np.pi * rng.uniform(0.05, 0.2, 7), rng.uniform(0.0, 6.0, 7)
    x = t[:, None] * f + phase
    middle = np.array([0.0, 0.6, 0.0, -1.8, 0.0, 1.2, 0.0])
    q, qd, qdd = middle + 0.15 * np.sin(x), 0.15 * f * np.cos(x), -0.15 * f**2 * np.sin(x)
    box = hf.HeldObject.box(mass, 0.12, 0.1, 0.08)
    payload = hf.HeldObject(mass, box.inertia, [0.02, -0.01, 0.05])
    chain = hf.ClosedChain({"arm": arm}, hf.HeldObject.box(guess, 0.15, 0.14, 0.12), {"arm": RIGID})
    tau = [loads(arm, payload, hf.Pose.identity(), *one)[1] for one in zip(q, qd, qdd, strict=True)]
    return chain, payload, Recording(t, q, qd, qdd, tau=np.array(tau))


@pytest.mark.parametrize("guess", [0.2, 2.5, 14.0])
def test_slow_motion(guess):
    """Weights and estimate swung between two states: 2.39 +- 0.21 kg for 1.5, residuals 200 times the noise."""
    chain, payload, recording = carried(1.5, guess)
    found = hf.identify(chain, recording, by="tau")
    assert abs(found.values[0] - 1.5) < 1e-9
    assert np.abs(found.held_object.com - payload.com).max() < 1e-9
    assert found.misfit < 1e-6


@pytest.mark.parametrize("by", BY)
def test_a_reversed_sign(by):
    """A mass below zero is what fits; the error says which, and asks for the sign."""
    case = random_case(4, "white", by)
    turned = replace(case.recording, **{by: -np.asarray(getattr(case.recording, by))})
    with pytest.raises(hf.errors.StateError, match=r"a mass of -[0-9.]+ \+- .* sign is reversed"):
        hf.identify(case.chain, turned, by=by)


@pytest.mark.slow
def test_joint_friction():
    """Dampers and dry friction of the model enter the torques: without the latter the mass is off."""
    case = random_case(1, "exact", "tau")
    arm = case.chain.arms["arm"]
    smooth = replace(arm, joints=[replace(joint, friction=0.0) for joint in arm.joints])
    without = hf.identify(replace(case.chain, arms={"arm": smooth}), case.recording, by="tau")
    assert abs(found_of(case).values[0] - case.payload.mass) < 1e-9
    assert abs(without.values[0] - case.payload.mass) > 1e-4
