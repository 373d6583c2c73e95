"""Dips of a margin at full size: a thousand of any width from a quarter of a step on, and narrow ones between knots."""

from __future__ import annotations

import time

import numpy as np
import pytest

from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.simulation.simulate import simulate
from tests.simulation.dips import Dips, found_dips
from tests.simulation.gantries import PUSHED, pressed

STEP = 0.01

pytestmark = pytest.mark.long


@pytest.mark.parametrize("scheme", ["midpoint", "rk4"])
def test_a_thousand_dips(scheme):
    """Dips of h/4 to 10 h, at random phase, of five shapes (two of which jump): all found, nothing else."""
    dips = Dips.random(1000, STEP, 0.25, 10.0, seed=11)
    begin = time.perf_counter()
    run = found_dips(dips, STEP, scheme=scheme)
    starts = np.array([one.t for one in run.occurrences[::2]])
    print(
        f"\n{scheme}: {len(dips.begins)} dips of {dips.widths.min() / STEP:.3f} to {dips.widths.max() / STEP:.2f} steps"
        f" in {len(run) - 1} steps, all found; begins off by at most {np.abs(starts - dips.begins).max():.1e} s;"
        f" {time.perf_counter() - begin:.0f} s",
        end="",
    )


def test_a_thousand_narrow_dips_between_knots():
    """Triangles of 1e-5 h to h/4 at random phase, knots at their corners: all found, depths to rounding."""
    chain, state = pressed()
    rng = np.random.default_rng(12)
    widths = STEP * 10 ** rng.uniform(-5, np.log10(0.25), 1000)
    begins = np.cumsum(STEP * rng.uniform(0.3, 2.0, 1000))
    peaks = begins + rng.uniform(0.2, 0.8, 1000) * widths
    depths = rng.uniform(0.01, 3.0, 1000)
    times = np.column_stack([begins, peaks, begins + widths]).ravel()
    torques = np.column_stack([np.ones(1000), -depths, np.ones(1000)]).ravel()
    schedule = TorqueSchedule.linear(np.r_[0.0, times], np.r_[1.0, torques][:, None])
    run = simulate(chain, state, schedule, float(times[-1] + STEP), STEP, on_slip="record", scheme="midpoint")
    assert [one.kind for one in run.occurrences] == 1000 * ["violation", "recovery"]
    lowest = np.array([one.lowest for one in run.occurrences[1::2]])
    enter = np.array([one.t for one in run.occurrences[::2]])
    expected = begins + (peaks - begins) / (1 + depths)
    off = np.abs(lowest + depths * PUSHED).max(), np.abs(enter - expected).max()
    print(f"\n1000 dips of {widths.min() / STEP:.1e} to {widths.max() / STEP:.2f} steps: depth off by {off[0]:.1e} N,"
          f" begin by {off[1]:.1e} s", end="")  # fmt: skip
    assert off[0] <= 1e-12
    assert off[1] <= 1e-12
