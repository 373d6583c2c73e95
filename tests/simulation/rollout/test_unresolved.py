"""Systems whose steps do not follow the motion go on, and say so; a slide that pushes a block is a scalar equation."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from holdfast import ControlLaw, compile_rollout
from holdfast.control.sampled import sampled
from holdfast.simulation import Rollout, RolloutStatus
from holdfast.simulation.rollout.arguments import NO_STOPS
from holdfast.spatial.scalar import where
from tests.compiler.programs import same_bits
from tests.simulation.gantries import BLOCK, LINK, pressed
from tests.simulation.rollout.problems import tiled

H, MASS, SPEED = 1e-3, BLOCK + LINK, 1.0
AMPLIFIED = {
    "rk4": np.polynomial.Polynomial([1.0, -1.0, 1 / 2, -1 / 6, 1 / 24]),
    "midpoint": np.polynomial.Polynomial([1.0, -1.0, 1 / 2]),
}
LARGEST = {"rk4": 2.7852935634, "midpoint": 2.0}


@cache
def slide(scheme: str = "rk4") -> Rollout:
    """Return the rollout of a slide with a damping gain and a force that may jump at a time."""
    chain, _ = pressed()

    def force(t, state, memory, given):
        kick = where(t > given["at"][()], given["kick"][()], 0.0)
        return np.array([given["force"][()] + kick - given["gain"][()] * state.qd[0]]), memory

    parameters: dict[str, tuple[int, ...]] = {"gain": (), "force": (), "kick": (), "at": ()}
    return compile_rollout(chain, ControlLaw(force, parameters=parameters), scheme=scheme)


def moving(rollout: Rollout, z: np.ndarray, speed: float = SPEED, **given: Any):
    """Return systems at a speed, whose velocities decay by z = h lambda in a step."""
    state = tiled(pressed()[1], len(z))
    state["qd"][:], state["object_twist"][:, 5] = speed, speed
    given = {"force": 0.0, "kick": 0.0, "at": 0.0} | given
    return rollout.start(**state, gain=z * MASS / H, **given)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["rk4", "midpoint"])
def test_decays(scheme):
    """The error of the first step, R(z) - R(z/2)^2, is the largest; a system with more than 1 % of it is unresolved."""
    z = np.array([0.0, 0.1, 0.3, 0.55, 0.75, 0.9, 0.95]) * LARGEST[scheme]
    R = AMPLIFIED[scheme]
    expected = np.abs(R(z) - R(z / 2) ** 2) * SPEED
    record = slide(scheme).run(moving(slide(scheme), z), 40 * H, H, record=("qd", "status"))
    counts = expected > 0.01 * SPEED + 1e-4
    assert counts.any() and not counts.all()
    assert record.systems.step_error == pytest.approx(np.where(counts, expected, 0.0), rel=1e-9)
    unresolved = record.systems.status == RolloutStatus.UNRESOLVED
    assert np.array_equal(unresolved, counts) and record.systems.running.all()
    assert record["qd"][-1, :, 0] == pytest.approx(SPEED * R(z) ** 40, rel=1e-9, abs=1e-300)
    assert np.array_equal(record["status"][-1], record.systems.status)
    assert f"{counts.sum()} unresolved" in repr(record)
    one = record.trajectory(int(np.argmax(expected)))
    (said,) = one.occurrences
    assert one.stopped is None and said.kind == "unresolved" and "try a smaller step" in said.text
    assert "a step was too long" in repr(one)
    assert not record.trajectory(0).occurrences


@pytest.mark.parametrize("scheme", ["rk4", "midpoint"])
def test_growth(scheme):
    """Beyond the scheme's limit: unresolved while it grows, and too long, not broken, where it overflows."""
    z = np.array([0.2, 1.01, 1.04, 10.0, 1e3]) * LARGEST[scheme]
    record = slide(scheme).run(moving(slide(scheme), z, speed=1e-9, force=3.0), 120 * H, H)
    names = [status.name for status in record.systems.status]
    assert names == ["RUNNING", *["UNRESOLVED"] * 2, *["TOO_LONG"] * 2]
    assert np.isinf(record.stopped[:3]).all() and np.array_equal(record.stopped[3:], record.systems.t[3:])


@pytest.mark.parametrize("limit", [None, 1e-10])
def test_nothing_else_changes(limit):
    """One call or many, noticed or not: the same bits, and all steps are taken."""
    rollout, z = slide(), np.array([0.1, 0.3, 2.0, 2.7])
    begin = moving(rollout, z, kick=-1200.0, at=0.0102)
    whole = rollout.step(begin.copy(), H, steps=12, largest_drift=limit)
    single = begin.copy()
    for _ in range(12):
        rollout.step(single, H, largest_drift=limit)
    bare = begin.copy()
    rollout.advance_unconfirmed(bare, np.full(4, H), 12, NO_STOPS, 1)
    assert list(whole.status) == [RolloutStatus.UNRESOLVED] * 4
    for name, x in whole.arrays.items():
        assert same_bits(x, single.arrays[name]), name
        assert name == "resolution" or same_bits(x, bare.arrays[name]), name
    assert np.array_equal(whole.t, np.full(4, 12 * H))


def test_jumps():
    """A force that jumps inside a step is noticed, with its impulse; one that jumps between calls is not."""
    rollout, z = slide(), np.full(2, 0.01)
    given = {"kick": np.array([0.0, 600.0]), "at": 10.2 * H}
    systems = rollout.step(moving(rollout, z, **given), H, steps=11)
    assert [status.name for status in systems.status] == ["RUNNING", "UNRESOLVED"]
    # of the force from a fifth of the step on, the whole step takes 5 parts of 6, its halves together 11 of 12
    assert systems.step_error[1] == pytest.approx(600.0 / MASS * H * (11 / 12 - 5 / 6), rel=0.02)
    rollout.step(systems, H, steps=20, force=600.0)
    assert systems.status[0] is RolloutStatus.RUNNING and systems.step_error[0] == 0.0


@pytest.mark.parametrize(("scheme", "sum_of_errors"), [("midpoint", 0.0157), ("rk4", 1.49e-4)])
def test_what_steps_sum_up(scheme, sum_of_errors):
    """At h lambda = 0.43 each step is followed, and by midpoint 1.6 % is lost all the same."""
    z = np.array([0.43])
    record = slide(scheme).run(moving(slide(scheme), z), 20 * H, H, record=("qd",))
    off = np.abs(record["qd"][:, 0, 0] - SPEED * np.exp(-z * np.arange(21))).max()
    assert off == pytest.approx(sum_of_errors, rel=0.02)
    assert record.systems.status[0] is RolloutStatus.RUNNING


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 4])
def test_samples_are_no_error(steps):
    """The torques of a sampled law jump at the ends of steps, which are exact in between: nothing is said."""
    chain, state = pressed()
    back = ControlLaw(lambda t, x, memory, given: (50.0 * np.ones(1) - 400.0 * x.qd, memory))
    rollout = compile_rollout(chain, sampled(back, chain, sample_time=steps * H))
    systems = rollout.step(rollout.start(**tiled(state, 1)), H, steps=40)
    v = 0.0
    for _ in range(40 // steps):
        v += steps * H * (50.0 - 400.0 * v) / MASS
    assert systems.qd[0, 0] == pytest.approx(v, rel=1e-9)
    assert systems.status[0] is RolloutStatus.RUNNING and systems.step_error[0] == 0.0
    assert systems.arrays["resolution"][0, 2] < 1e-12  # nor was a step compared with its halves


def test_small_beside_what_follows():
    """What was an error of the first motion is none of a motion a hundred times as fast."""
    rollout = slide()
    systems = rollout.step(moving(rollout, np.array([1.8]), speed=0.01), H, steps=5)
    assert systems.status[0] is RolloutStatus.UNRESOLVED
    rollout.step(systems, H, steps=200, force=1e3 * MASS, gain=0.0)
    assert systems.status[0] is RolloutStatus.RUNNING and systems.step_error[0] > 1e-4


@pytest.mark.slow
def test_gradients_through_steps_that_are_compared():
    """They are those of the steps taken: of v R(z)^n."""
    rollout, z, n = slide(), np.array([0.2, 2.0]), 6
    gain = z * MASS / H
    systems = moving(rollout, z)
    tape = rollout.tape(systems, H, steps=n)
    assert tape.systems.status[1] is RolloutStatus.UNRESOLVED
    found = tape.vjp(final={"qd": np.ones((2, 1))}, by=("gain",))
    R = AMPLIFIED["rk4"]
    expected = SPEED * n * R(z) ** (n - 1) * R.deriv()(z) * H / MASS
    assert found["gain"] == pytest.approx(expected, rel=1e-9)
    assert gain.shape == found["gain"].shape
