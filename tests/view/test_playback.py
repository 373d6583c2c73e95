"""A playback contains the run's own numbers, in frames that are samples."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Pose
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.errors import ModelError
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import evaluate
from holdfast.view import playback as playback_module
from holdfast.view.playback import playback_of_instant, playback_of_run, samples_at
from tests.control.two_pandas import two_pandas
from tests.view.runs import lifted


@pytest.mark.parametrize(
    ("t", "rate", "expected"),
    [
        (np.linspace(0, 1, 1001), 10.0, np.arange(0, 1001, 100)),
        (np.linspace(0, 1, 11), 30.0, np.arange(11)),  # no more than there are
        (np.array([2.0, 2.0 + 2**-52, 2.3, 3.0]), 2.0, [0, 2, 3]),  # a jump: two samples at one time
        (np.array([0.0, 0.4, 0.7, 1.3]), 1.0, [0, 2, 3]),
        (np.zeros(1), 30.0, [0]),
    ],
)
def test_samples_at(t, rate, expected):
    """The nearest samples, in order, each once, first and last among them."""
    assert samples_at(t, rate).tolist() == list(expected)


def test_playback_of_run():
    """What is shown is what the run says; tips touch the object where the grasps are."""
    chain, run = lifted()
    playback = playback_of_run(chain, run, "lifted", rate=2.6)
    k = samples_at(run.t, 2.6)
    assert playback.t == pytest.approx(run.t[k])
    assert playback.internal == pytest.approx(run.internal_wrench[k])
    for pose, tips in zip(playback.object_pose, playback.tip, strict=True):
        for tip, grasp in zip(tips, chain.grasps.values(), strict=True):
            assert tip == pytest.approx((Pose.from_wxyz_xyz(pose) @ grasp.frame).p, abs=1e-9)
    limits = np.array([joint.effort_limit for joint in chain.arms["left"].joints])
    assert playback.torque_use("left") == pytest.approx(np.abs(run.tau[k][:, :7] / limits).max(axis=1))
    # mu f_n - |f_t| over mu f_n, in contact axes: the internal force is along x, half of the weight is across
    internal_force = 40.0 - 30.0 * playback.t
    expected = np.clip(1.0 - 0.5 * 3.0 * 9.81 / (0.8 * internal_force), 0.0, 1.0)
    assert playback.reserve("right") == pytest.approx(expected, abs=1e-6)


def test_arms_that_hold_only_for_a_while():
    """An arm that has let go cannot slip; one that grips later is shown too."""
    chain, run = lifted()
    wrench = run.grasp_wrench.copy()
    wrench[3:, 1] = 0.0
    playback = playback_of_run(chain.without_grasp("left"), replace(run, grasp_wrench=wrench), "released")
    assert playback.reserve("right")[3:] == pytest.approx(1.0)
    assert playback.holding == ["left", "right"]


def test_moving_bases():
    """Bases are where their motion has them, and tips with them."""
    chain, run = lifted()

    def rising(t):
        return Pose(np.eye(3), np.array([-0.55, 0.0, 0.2 * t])), np.zeros(6), np.zeros(6)

    playback, still = (
        playback_of_run(chain, run, "rising", base_motion={"left": rising}),
        playback_of_run(chain, run, "still"),
    )
    assert playback.base_pose[:, 0, 6] == pytest.approx(0.2 * playback.t)
    assert (playback.tip - still.tip)[:, 0, 2] == pytest.approx(0.2 * playback.t)
    assert playback.tip[:, 1] == pytest.approx(still.tip[:, 1])


def test_playback_of_instant():
    """One frame, with margins of one-sided grasps only."""
    chain, state = two_pandas("hinge", "ball")
    playback = playback_of_instant(
        evaluate(Environment(chain), GravityCompensation(chain, 20.0), 0.0, state, None), "start"
    )
    assert len(playback) == 1
    assert np.isinf(playback.margin).all()
    assert np.linalg.norm(playback.internal[0, :, 3:], axis=1) == pytest.approx([20.0, 20.0])


def test_refused(monkeypatch):
    """A rate that is none, and one that would take for ever."""
    chain, run = lifted()
    with pytest.raises(ModelError, match="rate: expected > 0"):
        playback_of_run(chain, run, "none", 0.0)
    monkeypatch.setattr(playback_module, "MOST_FRAMES", 5)
    with pytest.raises(ModelError, match="expected at most 5 frames, got 6; try a lower rate"):
        playback_of_run(chain, run, "long", 1e3)
