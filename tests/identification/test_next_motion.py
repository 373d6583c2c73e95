"""Planned motions for identification: closed, smooth, within limits, at rest at their ends, and the most telling."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest

import holdfast as hf
from holdfast.identification import Prior, Recording, measurement_errors, next_motion
from holdfast.identification.exciting_motion import Series
from holdfast.identification.next_motion import most_telling

KINDS = ("payload", "armature", "damping", "friction", "friction_offset")


def planar_arm(x: float, limit: float = 3.0) -> hf.Arm:
    """Return an arm of three joints about y, and its base."""
    limits = {"position_limits": (-2.5, 2.5), "rate_limit": limit, "effort_limit": 80.0}
    lengths = [hf.Pose.translation(0.0, 0.0, z) for z in (0.0, 0.4, 0.4, 0.4)]
    joints = [hf.Joint(axis=[0, 1, 0], placement=at, **limits) for at in lengths[:3]]
    links = [hf.Link(2.0, [0.01, 0.0, 0.2], np.diag([0.03, 0.03, 0.005])) for _ in joints]
    return hf.Arm(joints, links, lengths[3], hf.Pose.translation(x, 0.0, 0.0))


@pytest.fixture(scope="module")
def held() -> tuple[hf.ClosedChain, hf.State]:
    """Return two planar arms that hold a box, and a closed state."""
    arms = {"left": planar_arm(-0.5), "right": planar_arm(0.5)}
    box = hf.HeldObject(2.0, np.diag([0.02, 0.05, 0.04]), [0.02, 0.0, 0.03])
    grasps = {
        "left": hf.Grasp("rigid", hf.Pose.from_rpy(0, 0.5 * np.pi, 0, [-0.2, 0, 0])),
        "right": hf.Grasp("rigid", hf.Pose.from_rpy(0, -0.5 * np.pi, 0, [0.2, 0, 0])),
    }
    q = {"left": [-0.6, 1.2, 1.0], "right": [0.6, -1.2, -1.0]}
    return hf.assemble(arms, box, grasps, q=q, object_pose=hf.Pose.translation(0.0, 0.0, 0.7))


@pytest.fixture(scope="module")
def planned(held) -> Recording:
    """Return a motion of the two arms."""
    chain, state = held
    return next_motion(
        chain, state, KINDS, duration=4.0, parts=2, harmonics=3, rate=50.0, tries=8, share=0.8, shift=0.15
    )


@pytest.mark.slow
def test_the_motion_is_closed_and_its_derivatives_are_those_of_its_positions(held, planned):
    chain, _ = held
    h = planned.t[1] - planned.t[0]
    worst = 0.0
    for k in range(len(planned)):
        gaps = hf.dynamics.closure(chain, planned.state(k)).values()
        worst = max(worst, *(float(np.abs([*gap.position, *gap.velocity]).max()) for gap in gaps))
    assert worst < 1e-10
    for part in np.split(np.arange(len(planned)), 2):  # third derivatives jump between parts
        for x, rate in ((planned.q[part], planned.qd[part]), (planned.qd[part], planned.qdd[part])):
            by_differences = (x[:-4] - 8 * x[1:-3] + 8 * x[3:-1] - x[4:]) / (12 * h)
            assert np.abs(by_differences - rate[2:-2]).max() < 2e-3 * np.abs(rate).max()


@pytest.mark.slow
def test_the_motion_uses_its_limits_and_no_more_and_rests_at_the_ends_of_parts(held, planned):
    chain, state = held
    limits = chain.position_limits
    assert (planned.q > limits[:, 0]).all() and (planned.q < limits[:, 1]).all()
    assert np.abs(planned.qd).max() <= 0.8 * 3.0 and np.abs(planned.tau).max() <= 0.8 * 80.0
    shifts = np.linalg.norm(planned.object_pose[:, 4:] - state.object_frame.p, axis=1)
    assert shifts.max() <= 0.15
    assert max(np.abs(planned.qd).max() / 2.4, shifts.max() / 0.15) > 0.5
    for k in (0, len(planned) // 2):
        assert planned.q[k] == pytest.approx(state.q) and np.abs(planned.qd[k]).max() < 1e-9
        assert np.abs(planned.qdd[k]).max() < 1e-9


@pytest.mark.slow
def test_the_torques_are_those_of_the_model_and_identify_it(held, planned):
    chain, _ = held
    assert np.abs(measurement_errors(chain, planned, "tau")).max() < 1e-9
    heavy = hf.HeldObject(3.0, np.diag([0.03, 0.06, 0.05]), [-0.01, 0.0, 0.05])
    tau = -measurement_errors(replace(chain, held_object=heavy), replace(planned, tau=0 * planned.q), "tau")
    found = hf.identify(chain, replace(planned, tau=tau), by="tau", unknowns=["payload"])
    assert found.chain.held_object.mass == pytest.approx(3.0, rel=1e-3)


@pytest.mark.slow
def test_a_chosen_motion_tells_more_than_another_and_what_is_known_counts(held, planned):
    chain, state = held
    few = {"duration": 4.0, "parts": 2, "harmonics": 3, "rate": 20.0, "share": 0.8, "shift": 0.15}

    def told(one: Recording) -> float:
        found = hf.identify(chain, one, by="tau", unknowns=KINDS, noise=0.5)
        return -float(np.linalg.slogdet(found.covariance)[1])

    pools = {tries: next_motion(chain, state, KINDS, tries=tries, noise=0.5, **few) for tries in (1, 3, 8)}
    values = [told(one) for one in pools.values()]
    assert values == sorted(values) and values[-1] > values[0] + 1.0  # each pool has the parts of the one before
    best = pools[8]
    more = next_motion(chain, state, KINDS, tries=2, recorded=best, prior=Prior(payload=0.1), **few)
    assert len(more) == 80


def test_a_bare_arm_moves_along_its_series():
    chain = hf.ClosedChain({"arm": planar_arm(0.0)})
    state = hf.State(np.array([0.1, 0.4, -0.3]), np.zeros(3))
    planned = next_motion(
        chain, state, ["armature", "friction"], duration=2.0, parts=1, harmonics=2, rate=20.0, tries=2
    )
    assert planned.q[0] == pytest.approx(state.q)
    spectrum = np.abs(np.fft.rfft(planned.q - planned.q.mean(axis=0), axis=0))
    assert spectrum[3:].max() < 1e-9 * spectrum.max()  # a period, so that no harmonic above the second is there


def test_series_rest_at_both_ends_and_differentiate():
    series = Series.random(3, 2.0, 5, np.random.default_rng(0))
    for values in series.at(np.array([0.0, 2.0])):
        assert np.abs(values).max() < 1e-9
    h, t = 1e-4, np.array([0.3, 1.1])
    u, v, a = series.at(t)
    assert (series.at(t + h)[0] - series.at(t - h)[0]) / (2 * h) == pytest.approx(v, rel=1e-4)
    assert (series.at(t + h)[0] - 2 * u + series.at(t - h)[0]) / h**2 == pytest.approx(a, rel=1e-4, abs=1e-4)


def test_exchanges_find_the_best_of_all_choices():
    random = np.random.default_rng(4)
    J = random.normal(size=(9, 3, 4)) * random.exponential(size=(9, 1, 4))
    F = np.swapaxes(J, 1, 2) @ J

    def told(choice: list[int]) -> float:
        return float(np.linalg.slogdet(np.eye(4) + F[choice].sum(axis=0))[1])

    best = max(told(list(c)) for c in combinations_with_replacement(range(9), 3))
    assert told(most_telling(F, np.eye(4), 3)) == pytest.approx(best, rel=0.01)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"unknowns": ["sensor_offset"]}, "cannot be told by='tau'"),
        ({"share": 1.5}, "share: expected 0 .. 1"),
        ({"harmonics": 1}, "harmonics"),
        ({"parts": 1.5}, "whole number"),
        ({"noise": -1.0}, "noise: expected standard deviations > 0"),
        ({"state": hf.State(np.array([0.0, 2.49, 0.0]), np.zeros(3))}, "within the share of their ranges"),
        ({"recorded": Recording(np.arange(9.0), np.zeros((9, 3)))}, "recorded: expected torques"),
    ],
)
def test_what_is_refused(changes, said):
    chain = hf.ClosedChain({"arm": planar_arm(0.0)})
    given = {"state": hf.State(np.zeros(3), np.zeros(3)), "unknowns": ["friction"], "tries": 1, "parts": 1, **changes}
    with pytest.raises(hf.HoldfastError, match=said):
        next_motion(chain, given.pop("state"), given.pop("unknowns"), harmonics=given.pop("harmonics", 2), **given)
