"""Events in runs of chains with branches: grasps that open and close at given times."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelError
from tests.dynamics.tree.as_branched import gap
from tests.systems.branched import branched_problems

PAD, PALM = ("arm1", "pad1"), ("arm2", "link6")


def constant(tau):
    """Return a controller with constant torques."""
    return lambda t, state, memory: (tau, memory)


def events(ball):
    """Return events that open a pad, close it, and open a palm."""
    return [hf.Release(4e-3, PAD), hf.Attach(0.013, PAD, ball, here=True), hf.Release(0.016, PALM)]


@pytest.mark.slow
def test_attach_and_release():
    """Both sides of events are samples; impulse and energy are those of `dynamics.attach`, and the account holds."""
    p = branched_problems()["grippers"]
    ball = p.chain.grasps[PAD]
    run = hf.simulate(p.chain, p.state, constant(p.tau), 0.02, 2e-3, events=events(ball))
    assert run.stopped is None
    assert [(one.kind, one.name) for one in run.occurrences] == [
        ("release", "arm1/pad1"), ("attach", "arm1/pad1"), ("release", "arm2/link6"),
    ]  # fmt: skip
    pad, palm = run.rows.index("arm1/pad1"), run.rows.index("arm2/link6")
    times = np.searchsorted(run.t, [4e-3, 0.013, 0.016])
    for k, i in zip(times, (pad, pad, palm), strict=True):
        assert run.holding[k, i] != run.holding[k - 1, i]
        assert run.t[k] - run.t[k - 1] < 1e-14
        assert gap(run.q[k], run.q[k - 1]) < 1e-9
    a, b, _ = times
    assert not run.grasp_wrench[a:b, pad].any() and run.grasp_wrench[b:, pad].any()
    loose = hf.dynamics.release(p.chain, PAD)
    made = hf.dynamics.attach(loose, run.state(b - 1), PAD, ball, here=True)
    logged = run.occurrences[1]
    assert logged.energy_change == pytest.approx(made.energy_change, rel=1e-9)
    assert gap(logged.impulses, made.impulses) < 1e-9
    assert run.impact[b] == logged.energy_change and not run.impact[:b].any()
    assert gap(run.qd[b], made.state.qd) < 1e-9
    assert made.energy_change < -1e-6
    assert np.abs(run.imbalance).max() < 1e-8
    assert run.position_gap[:, 1].max() < 1e-12


@pytest.mark.slow
def test_a_grasp_that_was_open_at_the_start():
    """A grasp that an event closes has a row from the start, which is zero until then."""
    p = branched_problems()["grippers"]
    loose = hf.dynamics.release(p.chain, PAD)
    ball = hf.Grasp("ball")
    run = hf.simulate(loose, p.state, constant(p.tau), 0.01, 2e-3, events=[hf.Attach(5e-3, PAD, ball, here=True)])
    assert run.rows == ["arm1/link6", "arm2/link6", "arm1/pad1"]
    k = int(np.searchsorted(run.t, 5e-3))
    assert not run.grasp_wrench[:k, 2].any() and run.grasp_wrench[k:, 2].any()
    assert run.holding[:, 2].tolist() == [False] * k + [True] * (len(run) - k)


def test_impossible_events():
    """Unknown frames, and grasps that are closed or open already, are refused by name."""
    p = branched_problems()["grippers"]
    ball = hf.Grasp("ball")
    for event, message in (
        (hf.Release(1e-3, ("arm1", "pad3")), "no link or frame 'pad3'"),
        (hf.Release(1e-3, ("arm3", "pad1")), "no such arm"),
        (hf.Release(1e-3, "arm1"), "has no grasp"),
        (hf.Attach(1e-3, PAD, ball), "has a grasp already"),
        (hf.Release(1.0, PAD), "within the run"),
    ):
        with pytest.raises(ModelError, match=message):
            hf.simulate(p.chain, p.state, constant(p.tau), 0.01, 2e-3, events=[event])
