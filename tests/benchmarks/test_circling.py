"""The motion to step for long: periodic, closed, never at rest; and the page on drift that is made of it."""

import numpy as np
import pytest
from benchmarks.circling import DAMPING, PERIOD, STIFFNESS, circling, rate_of, waves

from holdfast import forward_dynamics
from holdfast.dynamics import closure
from tests.systems.problems import largest_gaps


def test_never_at_rest():
    """The fastest joint turns at 0.5 to 3 rad/s at every phase, under torques that Pandas have."""
    motion = circling()
    phases = np.array([waves(t) for t in np.linspace(0.0, PERIOD, 97)])
    rates = np.abs(phases @ rate_of(motion.configuration)).max(axis=1)
    assert rates.min() >= 0.5 and rates.max() <= 3.0
    torques = phases @ (motion.drive - STIFFNESS * motion.configuration - DAMPING * rate_of(motion.configuration))
    assert np.abs(torques).max() <= 87.0


def test_rates_are_slopes():
    """Of the configurations, by central differences."""
    motion, h = circling(), 1e-4
    slope = (waves(0.3 + h) - waves(0.3 - h)) @ motion.configuration / (2 * h)
    assert np.abs(slope - waves(0.3) @ rate_of(motion.configuration)).max() <= 1e-5


@pytest.mark.parametrize("t", [0.0, 0.4, 1.1])
def test_states_are_closed_and_kept(t):
    """The states keep the grasps, and the law accelerates them as the motion goes on."""
    motion = circling()
    state = motion.state(t)
    assert largest_gaps(closure(motion.chain, state)).max() <= 1e-13
    assert np.abs(state.q - waves(t) @ motion.configuration).max() <= 5e-3
    found = forward_dynamics(motion.chain, state, motion.torque(t, state.q, state.qd)).qdd
    wanted = waves(t) @ rate_of(rate_of(motion.configuration))
    assert np.abs(found - wanted).max() <= 0.1 * np.abs(wanted).max()


def test_page_on_drift():
    """Figures in caption and table are the runs'; ours is the first, the best of the others is named."""
    pytest.importorskip("matplotlib", reason="needs matplotlib: pip install 'holdfast[plot]'")
    from benchmarks import drift_figure
    from benchmarks.drift_figure import Run

    gaps = (np.full(400, 2e-16), np.full(400, 3e-6), np.r_[np.full(399, 4e-9), 5e-9])
    runs = [Run(f"lib{k} 1.0", f"way {k}", f"set {k}", 1e-3, gap) for k, gap in enumerate(gaps)]
    caption, table = drift_figure.caption(runs), drift_figure.table(runs)
    assert "2.0e-16" in caption and "lib2 1.0 (way 2, 1 ms)" in caption and "4.0e-09" in caption
    assert "| lib2 1.0: way 2 | 1 ms | 4.0e-09 | 5.0e-09 | set 2 |" in table
    (panel,) = drift_figure.figure(runs).axes
    assert panel.get_yscale() == "log" and panel.lines[0].get_label() == "lib0, way 0, 1 ms"
    assert drift_figure.caption(runs[:1]).endswith("at 1 ms steps.")
