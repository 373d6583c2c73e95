"""Paths: from rest to rest, and through poses, smooth on SE(3); the same law on floats and as machine code."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import holdfast as hf
from holdfast import Pose
from holdfast.control.compiled_law import compile_law
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest, quintic
from holdfast.control.pose_spline import PoseSpline
from holdfast.errors import ModelError
from holdfast.spatial import rotation
from holdfast.spatial.rotation import exp_curve
from tests.control.two_pandas import two_pandas

START = Pose(rotation.exp(np.array([0.3, -0.2, 1.0])), np.array([0.1, 0.2, 0.3]))
LINE = RestToRest(START, np.array([0.0, 0.1, 0.2]), np.array([0.4, 0.0, -0.3]), begin=0.2, duration=1.6)
RANDOM = np.random.default_rng(0)
POSES = [Pose(rotation.exp(0.8 * RANDOM.normal(size=3)), RANDOM.normal(size=3)) for _ in range(5)]
TIMES = [0.2, 1.0, 1.7, 3.0, 3.5]
PATH = PoseSpline(POSES, TIMES)


def differenced(path: RestToRest | PoseSpline, t: float, h: float) -> np.ndarray:
    """Return twist and acceleration at t by central differences of pose and twist, (12,)."""
    before, after = path.at(t - h), path.at(t + h)
    turning = rotation.log(after.pose.R @ before.pose.R.T)
    return np.r_[turning, after.pose.p - before.pose.p, after.twist - before.twist] / (2 * h)


def test_quintic_is_exact_at_the_ends():
    """s goes from 0 to 1 with both derivatives zero, and stays."""
    for x in (-3.0, 0.0):
        assert quintic(x) == (0.0, 0.0, 0.0)
    for x in (1.0, 7.0):
        assert quintic(x) == (1.0, 0.0, 0.0)
    assert quintic(0.5) == pytest.approx((0.5, 1.875, 0.0))


@pytest.mark.parametrize("t", [0.0, 0.2, 0.21, 0.7, 1.5, 1.79, 2.5])
def test_derivatives_from_rest_to_rest(t):
    """Central differences of pose and twist."""
    found, now = differenced(LINE, t, 1e-5), LINE.at(t)
    assert found[:6] == pytest.approx(now.twist, abs=1e-9)
    assert found[6:] == pytest.approx(now.acceleration, abs=2e-4)


def test_ends_of_rest_to_rest():
    """It begins at the start pose and ends displaced and turned."""
    assert pytest.approx(START.R) == LINE.at(0.1).pose.R
    end = LINE.at(1.8).pose
    assert end.p == pytest.approx(START.p + LINE.displacement)
    assert rotation.log(end.R @ START.R.T) == pytest.approx(LINE.turn)


def test_passes_its_poses_and_rests_at_both_ends():
    """Each pose at its time; twist and acceleration exactly zero before, at the ends, and after."""
    for pose, t in zip(POSES, TIMES, strict=True):
        found = PATH.at(t).pose
        assert pytest.approx(pose.R, abs=1e-14) == found.R
        assert found.p == pytest.approx(pose.p, abs=1e-14)
    for t in (-1.0, 0.2, 3.5, 9.0):
        assert not PATH.at(t).twist.any()
        assert not PATH.at(t).acceleration.any()


@pytest.mark.parametrize("t", [0.4, 0.9, 1.2, 2.0, 2.9, 3.3])
def test_twist_and_acceleration_are_derivatives(t):
    """Central differences, extrapolated (Richardson), inside the pieces."""
    coarse, fine = differenced(PATH, t, 2e-3), differenced(PATH, t, 1e-3)
    found = PATH.at(t)
    assert (4 * fine - coarse) / 3 == pytest.approx(np.r_[found.twist, found.acceleration], abs=2e-8)


@pytest.mark.parametrize("t", TIMES)
def test_nothing_jumps(t):
    """Pose, twist and acceleration are the same on both sides of a pose; their limits are taken by quadratics."""
    sides = []
    for sign in (-1.0, 1.0):
        near = [PATH.at(t + sign * k * 1e-4) for k in (1, 2, 3)]
        states = [np.r_[x.pose.R.ravel(), x.pose.p, x.twist, x.acceleration] for x in near]
        sides.append(3 * states[0] - 3 * states[1] + states[2])
    assert sides[0] == pytest.approx(sides[1], abs=1e-7)


def test_acceleration_has_no_corners_more_than_bounded():
    """The acceleration changes by no more than a bounded jerk allows, everywhere."""
    every = np.linspace(0.0, 4.0, 4001)
    found = np.array([PATH.at(t).acceleration for t in every])
    change = np.abs(np.diff(found, axis=0)).max(axis=1)
    assert change.max() < 20 * np.median(change[200:3500])


def test_two_poses_are_rest_to_rest():
    """The same motion as the quintic from rest to rest."""
    quintic = RestToRest(POSES[0], displacement=[0.1, 0.2, 0.3], turn=[0.3, 0.2, 1.0], begin=0.2, duration=1.3)
    spline = PoseSpline([POSES[0], quintic.at(9.0).pose], [0.2, 1.5])
    for t in (0.0, 0.3, 0.9, 1.45, 2.0):
        for a, b in zip(quintic.at(t)[1:], spline.at(t)[1:], strict=True):
            assert a == pytest.approx(b, abs=1e-13)
        assert pytest.approx(spline.at(t).pose.R, abs=1e-14) == quintic.at(t).pose.R


def test_turns_about_one_axis_are_a_spline_of_the_angle():
    """Angles about one axis, over more than a full turn, follow SciPy's quintic spline with ends at rest."""
    from scipy.interpolate import make_interp_spline

    axis, angles, times = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.5, 4.0, 6.5, 8.0]), np.array([0.0, 1, 2, 3, 4.5])
    path = PoseSpline([Pose(rotation.exp(a * axis), [a, 0, 0]) for a in angles], times)
    zero = [(1, 0.0), (2, 0.0)]
    expected = make_interp_spline(times, angles, k=5, bc_type=(zero, zero))
    for t in (0.3, 1.0, 1.6, 2.5, 4.2):
        found = path.at(t)
        assert found.pose.p[0] == pytest.approx(expected(t), abs=1e-12)
        assert pytest.approx(rotation.exp(expected(t) * axis), abs=1e-12) == found.pose.R
        assert found.twist == pytest.approx(np.r_[axis, 1, 0, 0] * expected(t, 1), abs=1e-11)
        assert found.acceleration == pytest.approx(np.r_[axis, 1, 0, 0] * expected(t, 2), abs=1e-10)


def test_same_wherever_the_world_is():
    """Poses seen from another frame give the motion seen from there."""
    world = Pose(rotation.exp(np.array([0.4, -1.0, 2.0])), [1.0, 2.0, 3.0])
    moved = PoseSpline([world @ pose for pose in POSES], TIMES)
    for t in (0.5, 1.7, 2.4):
        here, there = PATH.at(t), moved.at(t)
        assert pytest.approx(world.R @ here.pose.R, abs=1e-12) == there.pose.R
        assert there.acceleration.reshape(2, 3) == pytest.approx(here.acceleration.reshape(2, 3) @ world.R.T, abs=1e-10)


def test_rests_where_a_pose_is_given_twice():
    """Between two equal poses nothing moves; on both sides of it the motion is one from rest to rest."""
    path = PoseSpline([POSES[0], POSES[1], POSES[1], POSES[2]], [0.0, 1.0, 2.0, 3.0])
    for t in (1.0, 1.3, 2.0):
        assert path.at(t).twist == pytest.approx(np.zeros(6), abs=1e-12)
        assert path.at(t).pose.p == pytest.approx(POSES[1].p, abs=1e-14)
    alone = PoseSpline(POSES[1:3], [2.0, 3.0])
    assert path.at(2.4).acceleration == pytest.approx(alone.at(2.4).acceleration, abs=1e-11)


def test_at_speed():
    """The limits are kept to a thousandth, and one of them is reached."""
    path = PoseSpline.at_speed(POSES, 0.5, 1.0, begin=0.3)
    assert path.times[0] == 0.3
    twists = np.array([path.at(t).twist for t in np.linspace(*path.times[[0, -1]], 2001)]).reshape(-1, 2, 3)
    turning, speed = np.linalg.norm(twists, axis=2).max(axis=0)
    assert max(speed / 0.5, turning / 1.0) == pytest.approx(1.0, abs=1e-3)


def test_exponential_curve():
    """Of a curve of rotation vectors: NumPy's matrix, and central differences, also near zero and a full turn."""
    random = np.random.default_rng(3)
    for size in (0.0, 1e-9, 1e-3, 0.5, 3.0, 6.2, 9.0):
        direction, rate, second = random.normal(size=(3, 3))
        theta = size * direction / np.linalg.norm(direction)

        def at(t, theta=theta, rate=rate, second=second):
            return exp_curve(theta + rate * t + 0.5 * second * t * t, rate + second * t, second)

        R, omega, omega_dot = at(0.0)
        assert pytest.approx(rotation.exp(theta), abs=1e-14) == R
        h = 1e-4
        after, before = at(h), at(-h)
        assert rotation.log(after[0] @ before[0].T) / (2 * h) == pytest.approx(omega, abs=1e-6)
        assert (after[1] - before[1]) / (2 * h) == pytest.approx(omega_dot, abs=1e-6)


def tracked() -> tuple[ObjectTracking, hf.State]:
    """Return two Pandas that lead a box through three poses."""
    chain, state = two_pandas()
    up, aside = Pose.translation(0, 0, 0.1), Pose.from_rpy(0.2, 0.0, 0.3, [0.05, 0.0, 0.05])
    start = state.object_frame
    path = PoseSpline([start, up @ start, start @ aside, start], [0.0, 0.2, 0.5, 0.7])
    return ObjectTracking(chain, path), state


def test_as_machine_code():
    """A tracked spline is machine code, the same torques to rounding in every piece; pickled too."""
    law, state = tracked()
    fast = compile_law(law)
    assert fast.law.key  # kept on disk
    for t in (-0.1, 0.0, 0.1, 0.2, 0.35, 0.6, 0.7, 2.0):
        expected = law(t, state, None)[0]
        assert fast(t, state, None)[0] == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())
        assert np.array_equal(pickle.loads(pickle.dumps(law))(t, state, None)[0], expected)


@pytest.mark.slow
def test_a_run_and_a_rollout_follow_it():
    """The object goes where the path says, in a run and in a rollout alike."""
    law, state = tracked()
    run = hf.simulate(law.chain, state, law, 0.6, 0.002)
    record = hf.compile_rollout(law.chain, law)
    found = record.run(record.start(state.q, state.qd, state.object_pose, state.object_twist), 0.6, 0.002)
    goal = law.path(0.6).pose  # pyright: ignore[reportCallIssue]
    assert run.object_pose[-1, 4:] == pytest.approx(goal.p, abs=1e-6)
    assert found["object_pose"][-1, 0] == pytest.approx(run.object_pose[-1], abs=1e-9)


HALF, TWICE = [Pose.identity(), Pose.from_rpy(np.pi, 0, 0)], [0.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PoseSpline(POSES[:1], [0.0]), "path: poses: expected two or more, got 1"),
        (lambda: PoseSpline(POSES[0], [0.0]), "path: poses: expected a list of poses, got Pose"),
        (lambda: PoseSpline("poses", [0.0]), "path: poses: expected a list of poses, got str"),
        (lambda: PoseSpline(POSES, [0.0, 1.0]), "path: times: expected one for each of 5 poses, got 2"),
        (
            lambda: PoseSpline(POSES[:3], TWICE),
            "path: times: expected them to increase, got times[1] = 1 s and times[2] = 1 s; to",
        ),
        (lambda: PoseSpline(POSES[:2], [0.0, np.nan]), "path: times: expected finite"),
        (
            lambda: PoseSpline(HALF, [0.0, 1.0]),
            "poses[1] is turned against poses[0] by 180 degrees, and either way round is as short",
        ),
        (lambda: PoseSpline([POSES[0], [1.0, 0, 0, 0]], [0.0, 1.0]), "path: poses[1] (wxyz_xyz): expected shape (7,)"),
        (lambda: PoseSpline([*POSES[:2], Pose.from_rpy(0, 0, 3.0)], [0.0, 1.0, 1.001]), "a smooth path would swing by"),
        (lambda: PoseSpline.at_speed(POSES, 0.0, 1.0), "path: speed: expected > 0"),
        (lambda: PoseSpline.at_speed([POSES[0], *[POSES[1]] * 2], 1.0, 1.0), "poses[1] and poses[2] are equal"),
        (lambda: RestToRest(START, duration=0.0), "path: duration: expected > 0"),
        (lambda: RestToRest(START, begin=-0.1), "path: begin: expected >= 0"),
        (lambda: RestToRest(START, turn=np.zeros(2)), "path: turn: expected shape (3,)"),
        (lambda: RestToRest(START, displacement=np.full(3, np.inf)), "path: displacement: expected finite"),
    ],
)
def test_refused(make, message):
    """What no path is made of, and how to mend it."""
    with pytest.raises(ModelError) as caught:
        make()
    assert message in str(caught.value)
