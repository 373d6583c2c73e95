"""The singularity meter: orange 50 ms before a run explodes at a singular configuration, then red; else green."""

from __future__ import annotations

import re

import numpy as np
import pytest

from holdfast import ClosedChain, State, simulate
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.simulation.trajectory import Trajectory
from holdfast.view.live import readout
from holdfast.view.page import meter
from holdfast.view.playback import playback_of_run
from tests.control.two_pandas import two_pandas
from tests.systems import planar_parallelogram
from tests.systems.as_chain import as_chain

GREEN, RED = 1 / 3, 2 / 3


def tracked(displacement, step: float, duration: float) -> tuple[ClosedChain, Trajectory]:
    """Return two Pandas whose box follows a path from rest to rest in a second."""
    chain, state = two_pandas()
    path = RestToRest(state.object_frame, np.array(displacement), np.zeros(3), begin=0.0, duration=1.0)
    return chain, simulate(chain, state, ObjectTracking(chain, path.at, internal_force=20.0), duration, step)


def values_before_the_end(chain, run: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return how long before the run's end each sample is [s], and the meter's values."""
    playback = playback_of_run(chain, run, "to the end", rate=1e4)
    assert len(playback) == len(run.t)
    return run.t[-1] - run.t, np.array(meter(playback)["values"])


def assert_reddens(before: np.ndarray, values: np.ndarray) -> None:
    """Green at the start, orange from 50 ms before the end at the latest, red from 8 ms."""
    assert values[0] < GREEN
    assert (values[before <= 0.05] > GREEN).all()
    assert (values[before <= 0.008] > RED).all()


@pytest.mark.long
def test_arms_that_are_led_beyond_their_reach():
    """The grasps are as regular as ever while joint rates reach hundreds of rad/s: the arms are singular, and named."""
    chain, run = tracked([0.0, 0.0, 0.6], 0.001, 0.65)
    rates = np.abs(run.qd).max(axis=1)
    before, values = values_before_the_end(chain, run)
    assert rates[-1] > 100.0
    assert rates[before >= 0.05].max() < 15.0
    assert run.condition.max() < 100.0
    assert_reddens(before, values)
    assert run.stopped is not None
    for arm in ("left", "right"):
        assert f"arm '{arm}' can hardly (relative strength" in run.stopped
    assert "try a smaller time step" not in run.stopped
    playback = playback_of_run(chain, run, "to the end")
    assert "nearest: left" in readout(playback, len(playback) - 1) or "nearest: right" in readout(
        playback, len(playback) - 1
    )


@pytest.mark.slow
def test_the_singular_arms_come_first():
    """Arms led beyond their reach by long steps, whose last sample is not quite there: no shorter step is advised."""
    _, run = tracked([0.0, 0.0, 0.6], 0.01, 0.65)
    said = str(run.stopped)
    assert said.startswith("stopped after t = 0.55 s: nearly singular, where joint rates and forces grow without bound")
    assert said.index("arm 'left'") < said.index("leaves a grasp open")
    assert not re.search("try a|step of|smaller", said)


@pytest.mark.slow
def test_a_parallelogram_that_flattens():
    """The grasp constraint itself gets singular; the meter says so, and the run's end names force and arms."""
    p = as_chain(planar_parallelogram(0.6, crank_rate=-1.5))
    run = simulate(p.chain, p.state, lambda t, state, memory: (np.zeros(4), memory), 0.45, 1e-3)
    before, values = values_before_the_end(p.chain, run)
    force = np.abs(run.grasp_wrench).max(axis=(1, 2))
    assert force[-1] > 30 * force[before >= 0.05].max()
    assert_reddens(before, values)
    assert run.stopped is not None
    assert "at 'arm1' (rigid) against force" in run.stopped
    assert "causes no joint torque" in run.stopped
    shown = meter(playback_of_run(p.chain, run, "flat"))
    near = [nearest for nearest, value in zip(shown["nearest"], shown["values"], strict=True) if value > GREEN]
    assert near
    assert set(near) == {0}  # the grasps, not an arm


@pytest.mark.slow
@pytest.mark.parametrize("displacement", [[0.0, 0.1, 0.2], pytest.param([0.0, 0.0, -0.15], marks=pytest.mark.long)])
def test_an_ordinary_run_is_green(displacement):
    """Two Pandas lift a box, as in the demo."""
    chain, run = tracked(displacement, 0.01, 1.0)
    assert run.stopped is None
    _, values = values_before_the_end(chain, run)
    assert values.max() < GREEN


def test_a_run_that_ends_elsewhere_is_not_called_singular():
    """A step that is far too long, in a regular configuration: the cause is told as it is."""
    chain, state = two_pandas()
    wild = State(state.q, state.qd, state.object_pose)
    run = simulate(chain, wild, lambda t, s, memory: (np.full(14, 4e4), memory), 0.2, 0.1)
    assert run.stopped is not None
    assert "nearly singular" not in run.stopped
    assert "try a smaller time step" in run.stopped
