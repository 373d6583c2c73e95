"""Filtered recordings: against formulas of what was sampled, and what does not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import StateError
from holdfast.identification import Recording, prepared

F = 2.0 * np.pi * 0.8


def sampled(noise: float = 0.0, uneven: float = 0.0, duration: float = 6.0) -> Recording:
    """Return a sine of one joint with a torque in proportion, 250 samples a second."""
    random = np.random.default_rng(0)
    t = np.arange(0.0, duration, 0.004)
    t = t + uneven * 0.004 * random.uniform(-0.5, 0.5, len(t))
    q = np.sin(F * t) + noise * random.normal(size=len(t))
    return Recording(t=t, q=q[:, None], tau=3.0 * np.sin(F * t)[:, None])


def test_rates_and_accelerations_have_no_lag():
    """They are those of the formula, also for uneven stamps, and positions with noise."""
    found, report = prepared(sampled(noise=1e-4, uneven=0.6), cutoff=10.0)
    assert found.qd is not None and found.qdd is not None and found.tau is not None
    assert np.allclose(found.qd[:, 0], F * np.cos(F * found.t), atol=0.02)
    assert np.allclose(found.qdd[:, 0], -(F**2) * np.sin(F * found.t), atol=0.6)
    assert np.allclose(found.tau[:, 0], 3.0 * np.sin(F * found.t), atol=2e-3)
    assert report.samples[1] < report.samples[0] / 5 and 1.0 < report.uneven < 3.0
    assert np.diff(found.t).min() > 0.0 and "filtered at 10 Hz" in str(report)


def test_saturated_and_standing_samples_and_gaps_do_not_count():
    """They are marked or dropped, and the report has their shares."""
    given = sampled()
    assert given.tau is not None
    clipped = replace(given, tau=np.clip(given.tau, -2.5, 2.5))
    found, report = prepared(clipped, 40.0, limits=[2.5], standstill=0.5)
    assert found.used is not None and 0.2 < report.saturated[0] < 0.9 and 0.02 < report.standing[0] < 0.2
    assert (found.used[np.abs(found.tau) > 2.49] == 0.0).all()  # pyright: ignore[reportOptionalOperand]
    assert "saturated" in str(report) and "standing still" in str(report)
    keep = (given.t < 2.0) | (given.t > 3.0)
    broken = Recording(t=given.t[keep], q=given.q[keep], tau=given.tau[keep])
    found, report = prepared(broken)
    assert not ((found.t > 1.95) & (found.t < 3.05)).any() and report.in_gaps > 0.1
    chain = hf.ClosedChain({"arm": hf.Arm([hf.Joint()], [hf.Link(1.0, [0.3, 0, 0], 0.1 * np.eye(3))])})
    assert hf.identify(chain, found, by="tau", unknowns=["armature"]).values.shape == (1,)


def test_what_cannot_be_filtered_is_refused():
    """Cut-offs above the samples, short recordings, motions of objects."""
    with pytest.raises(StateError, match="lower cut-off"):
        prepared(sampled(), cutoff=200.0)
    with pytest.raises(StateError, match="or more for"):
        prepared(sampled(duration=0.1))
    with pytest.raises(StateError, match="object_pose"):
        prepared(replace(sampled(), object_pose=np.tile([1.0, 0, 0, 0, 0, 0, 0], (1500, 1))))
    with pytest.raises(StateError, match="torques or currents"):
        prepared(replace(sampled(), tau=None), limits=[1.0])
