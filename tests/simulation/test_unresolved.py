"""Steps that do not follow a controller's gain are named, whether the run ends or goes on; smooth runs say nothing."""

import re

import numpy as np
import pytest
from benchmarks.unresolved_steps import RANGES, case

import holdfast as hf
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.simulation.stability import fastest_decay
from tests.control.two_pandas import two_pandas
from tests.longer import mostly_slow
from tests.simulation.gantries import squeezed

CHAIN, STATE = two_pandas()
N = CHAIN.joint_count
HOLD = hf.holding_torques(CHAIN, STATE)
H = 1e-3
BALLS, SQUEEZE = ("ball", "ball"), 30.0


def damped(factor: float, scheme: str = "rk4"):
    """Return a controller that sways the box, damping a multiple of what the scheme follows; its joint and gain."""
    decay = fastest_decay(CHAIN, STATE, np.eye(N, N + 6))
    gain = factor * scheme_of(scheme).stability_interval / (H * decay.rate)

    def law(t, state, memory):
        return HOLD + 2.0 * np.sin(7.0 * t) - gain * state.qd, memory

    return law, decay.joint, gain


def named(run) -> str:
    """Return what the run says of its steps."""
    return " ".join([run.stopped or "", *(one.text for one in run.occurrences if one.kind == "unresolved")])


@pytest.mark.slow
@pytest.mark.parametrize("scheme", mostly_slow(["rk4", "midpoint"], ["midpoint"]))
@pytest.mark.parametrize("factor", mostly_slow([1.04, 1.3, 3.0], [1.04]))
def test_too_high_a_gain(factor, scheme):
    """Whatever the growth, with the joint that is slowed down, its gain, and a step that would do."""
    law, joint, gain = damped(factor, scheme)
    said = named(hf.simulate(CHAIN, STATE, law, 700 * H, H, scheme=scheme))
    slowed = rf"too long for joint '(left|right)/{joint.partition('/')[2]}', slowed down at (\S+) 1/s by its"
    found = re.search(slowed + r" controller's gain of (\S+) N m s/rad: .* try a step of (\S+) s", said)
    assert found, said
    assert float(found[3]) == pytest.approx(gain, rel=5e-3)
    assert float(found[4]) * float(found[2]) < scheme_of(scheme).stability_interval < H * float(found[2])


@pytest.mark.slow
def test_a_gain_on_the_object():
    """A law that feeds back the object's motion has no gain of a joint; rounding is none."""
    rest = hf.control.RestToRest(STATE.object_frame, [0.0, 0.0, 0.05], duration=0.5)
    law = hf.control.ObjectTracking(CHAIN, rest, 20.0, stiffness=4e6, damping=4e3)
    said = named(hf.simulate(CHAIN, STATE, law, 20 * H, H))
    assert re.search(r"slowed down at (\S+) 1/s by its controller: ", said), said


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["rk4", "midpoint"])
def test_a_gain_that_steps_follow(scheme):
    """Nothing is said, and the velocities are right to a part in a thousand."""
    law, *_ = damped(0.1, scheme)
    run = hf.simulate(CHAIN, STATE, law, 60 * H, H, scheme=scheme)
    fine = hf.simulate(CHAIN, STATE, law, 60 * H, H / 5)
    assert named(run).strip() == ""
    assert np.abs(run.qd - fine.qd[::5]).max() <= 1e-3 * np.abs(fine.qd).max()


@pytest.mark.slow
def test_what_was_noticed_travels_with_a_checkpoint():
    """A run that goes on from a checkpoint says at its end what the whole run says, to the letter."""
    law, *_ = damped(0.75)
    pushed = hf.State(STATE.q, STATE.qd, STATE.object_pose, STATE.object_twist)
    kept: list[Checkpoint] = []
    jump = lambda t, state, memory: (law(t, state, memory)[0] + 20.0 * (t > 0.0105), memory)  # noqa: E731
    whole = hf.simulate(CHAIN, pushed, jump, 20 * H, H, on_checkpoint=kept.append)
    rest = hf.simulate(CHAIN, pushed, jump, 20 * H, H, start=Checkpoint.from_data(*kept[15].to_data()))
    assert "name the time in `breakpoints`" in named(whole)
    assert "complete, but a step was too long" in repr(whole) and "complete, but a step was too long" in repr(
        whole.summary()
    )
    assert named(rest) == named(whole)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"damping": 12e3}, r"slowed down at 7.2e\+03 1/s by its damping of 1.2e\+04 N s/m"),
        ({"stiffness": 2e7}, r"swinging at \S+ rad/s by its spring of 2e\+07 N/m"),
    ],
)
def test_a_damper_or_spring_is_named(part, words, monkeypatch):
    """They make steps implicit; where they become too fast between two looks at them, the run says which one it was."""
    monkeypatch.setattr("holdfast.simulation.segment.too_fast", lambda *_: None)
    chain, state = squeezed(BALLS, **part)
    pushed = lambda t, x, memory: (np.array([SQUEEZE, 0.0, 5.0, -SQUEEZE, 0.0, 5.0]), memory)  # noqa: E731
    run = hf.simulate(chain, state, pushed, 0.2, H)
    assert re.search(rf"joint '(left|right)/[xyz]', {words}", run.stopped or ""), run.stopped


@pytest.mark.parametrize("seed", mostly_slow([527, 571], (571,)))
def test_a_recorded_limit_ends_no_run(seed):
    """A midpoint step passes a limit that its halves pass elsewhere: it is recorded, as in a run of shorter steps."""
    chain, state, controller, step, scheme, _ = case(seed, *RANGES["low"])
    run, fine = (hf.simulate(chain, state, controller, 20 * step, h, scheme=scheme) for h in (step, step / 8))
    assert run.stopped is None

    def passed(one):
        return {(found.text, found.quantity) for found in one.occurrences if found.kind == "violation"}

    assert passed(run) == passed(fine)


@pytest.mark.parametrize("seed", mostly_slow([128, 135, 274], (128, 274)))
def test_a_limit_passed_just_before_a_step(seed):
    """Its margin is lowest at the edge of what the step knows, and still is no reason to call the step too long."""
    chain, state, controller, step, scheme, _ = case(seed, *RANGES["low"])
    run = hf.simulate(chain, state, controller, 12 * step, step, scheme=scheme)
    assert run.stopped is None and any(one.quantity == "effort" for one in run.occurrences)
