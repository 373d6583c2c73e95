"""Grasp forces as wished: shares of the load, ramps, springs between the arms, and the integral of their error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import (
    HybridForce,
    InternalForce,
    InternalImpedance,
    LoadShare,
    RampedForces,
    cooperative_law,
    unloaded,
)
from holdfast.errors import ModelError
from holdfast.forces import split
from tests.control.kit import CHAIN, HERE, STATE, STIFF, moving
from tests.control.two_pandas import pushes, rubber_pandas


def wrenches(forces, state=STATE, t=0.0, chain=CHAIN, **given):
    """Return the grasp wrenches and the object's acceleration under a law with these forces."""
    law = cooperative_law(chain, STIFF, forces)
    found = hf.forward_dynamics(chain, state, law.given(given)(t, state, None)[0])
    return found.grasp_wrench, found.object_acceleration


def test_chosen_pushes_and_wrenches():
    """A push of all, of each, and wrenches along contact axes are the same internal force where they say the same."""
    every, _ = wrenches(InternalForce(20.0))
    rows = np.zeros((2, 6))
    rows[:, 5] = 20.0
    for same in ([20.0, 20.0], rows):
        assert wrenches(InternalForce(same))[0] == pytest.approx(every, abs=1e-9)
    uneven = pushes(CHAIN, STATE, split(CHAIN, STATE, wrenches(InternalForce([30.0, 10.0]))[0]).internal)
    assert uneven == pytest.approx([20.0, 20.0], abs=1e-9)  # what does not cancel is no internal force


@pytest.mark.parametrize("left", [0.0, 0.3, 0.5, 1.0])
def test_shares_are_as_asked(left):
    """Each arm carries its part of what moves the box, forces and moments about C, to 1e-9; the motion is the same."""
    for state in (STATE, moving(2)):
        found, alpha = wrenches(LoadShare({"left": left, "right": 1.0 - left}), state)
        assert alpha == pytest.approx(wrenches(InternalForce(), state)[1], abs=1e-9)
        offsets = state.object_frame.R @ np.array([CHAIN.grasps[name].frame.p for name in ("left", "right")]).T
        about_C = found + np.c_[np.cross(offsets.T, found[:, 3:]), np.zeros((2, 3))]
        net = about_C.sum(axis=0)
        assert np.linalg.norm(net) > 20.0
        assert about_C[0] == pytest.approx(left * net, abs=1e-9 * np.linalg.norm(net))


def test_shares_follow_the_reserve():
    """They minimise the squares of used reserve: no other shares use less; weaker drives get less."""
    limits = np.array([joint.effort_limit for joint in CHAIN.all_joints])
    bare = replace(CHAIN, held_object=replace(CHAIN.held_object, mass=1e-9, inertia=1e-9 * np.eye(3)))
    alone = hf.inverse_dynamics(bare, STATE, np.zeros(14), np.zeros((2, 6)))
    reserve = np.maximum(limits - np.abs(alone), 0.1 * limits)

    def used(forces):
        tau = cooperative_law(CHAIN, STIFF, forces)(0.0, STATE, None)[0]
        return (((tau - alone) / reserve) ** 2).sum()

    best = used(LoadShare())
    for left in np.linspace(0.0, 1.0, 21):
        assert best <= used(LoadShare({"left": left, "right": 1.0 - left})) * (1 + 1e-6)
    weak = CHAIN.arms["left"]
    weak = replace(weak, joints=[replace(j, effort_limit=0.6 * j.effort_limit) for j in weak.joints])
    weaker = replace(CHAIN, arms={"left": weak, "right": CHAIN.arms["right"]})
    carried = [wrenches(LoadShare(), chain=chain)[0][0, 5] for chain in (CHAIN, weaker)]
    assert carried[1] < 0.8 * carried[0]


def test_shares_without_effort_limits_are_equal():
    """Where no drive has a limit, nobody is stronger."""
    arms = {
        name: replace(a, joints=[replace(j, effort_limit=np.inf) for j in a.joints]) for name, a in CHAIN.arms.items()
    }
    found, _ = wrenches(LoadShare(), chain=replace(CHAIN, arms=arms))
    assert found[:, 5] == pytest.approx([3.0 * 9.81 / 2] * 2, abs=1e-9)


def test_ramp():
    """The first before its begin, the second after its end, halfway between them in the middle."""
    before, after = InternalForce(5.0), LoadShare({"left": 1.0}, 20.0)
    ramp = RampedForces(before, after, 0.2, 0.4)
    for t, s in ((0.0, 0.0), (0.2, 0.0), (0.4, 0.5), (0.6, 1.0), (2.0, 1.0)):
        expected = (1 - s) * wrenches(before)[0] + s * wrenches(after)[0]
        assert wrenches(ramp, t=t)[0] == pytest.approx(expected, abs=1e-9)
    with pytest.raises(ModelError, match="expected parts without memory, got HybridForce"):
        cooperative_law(CHAIN, STIFF, RampedForces(HybridForce(1.0, 1e-3), after))


@pytest.mark.slow
def test_hand_over():
    """The right arm is unloaded before its grasp opens, and then nothing jumps: the box stays where it is."""
    forces = RampedForces(InternalForce(20.0), LoadShare({"left": 1.0}), 0.05, 0.2)
    law = cooperative_law(CHAIN, STIFF, forces)
    run = hf.simulate(CHAIN, STATE, law, 0.4, 1e-3, events=[hf.Release(0.3, "right")])
    assert run.stopped is None
    before = int(np.searchsorted(run.t, 0.299))
    assert not unloaded(CHAIN, run.grasp_wrench[0])["right"]
    assert unloaded(CHAIN, run.grasp_wrench[before]) == {"left": False, "right": True}
    assert np.abs(run.object_pose - STATE.object_pose).max() < 1e-8
    assert np.abs(np.diff(run.grasp_wrench[before:, 0], axis=0)).max() < 1e-3 * 3.0 * 9.81


def test_springs_between_arms():
    """A model whose left grasp is 5 mm off pulls by K_int times half of it along the line, and is damped by D_int."""
    off = replace(CHAIN.grasps["left"], frame=hf.Pose.translation(0.005, 0.0, 0.0) @ CHAIN.grasps["left"].frame)
    believed = replace(CHAIN, grasps={"left": off, "right": CHAIN.grasps["right"]})
    still = [], []
    for found, forces in zip(
        still, (InternalForce(20.0), InternalImpedance(800.0, 0.0, InternalForce(20.0))), strict=True
    ):
        tau, _ = cooperative_law(believed, STIFF, forces)(0.0, STATE, None)
        found.append(hf.forward_dynamics(CHAIN, STATE, tau).grasp_wrench)
    change = split(CHAIN, STATE, still[1][0] - still[0][0]).internal
    assert change[:, 3] == pytest.approx([800.0 * 0.005 / 2, -800.0 * 0.005 / 2], abs=1e-8)
    assert change[:, 4:] == pytest.approx(np.zeros((2, 2)), abs=1e-8)
    with pytest.raises(ModelError, match="around: expected grasp forces without memory"):
        cooperative_law(CHAIN, STIFF, InternalImpedance(1.0, 1.0, HybridForce(1.0, 1e-3)))


def test_an_exact_model_has_no_springs():
    """Where tips are where the model has them, the springs add nothing."""
    plain, sprung = (
        wrenches(f, moving(1))[0] for f in (InternalForce(20.0), InternalImpedance(900.0, 30.0, InternalForce(20.0)))
    )
    assert sprung == pytest.approx(plain, abs=1e-6)


def loop(forces, disturbance, samples, late=False):
    """Return the error of the left grasp's push [N] at every sample, with forces that are disturbed."""
    law, memory, errors = cooperative_law(CHAIN, STIFF, forces), None, []
    seen = [np.zeros((2, 6))] * 2
    wished = wrenches(InternalForce(20.0))[0]
    for k in range(samples):
        measured = seen[-2] if late else seen[-1]
        given = {"measured_wrenches": measured if k > late else wished}
        tau, memory = law.given(given)(0.0, STATE, memory)
        seen.append(hf.forward_dynamics(CHAIN, STATE, tau).grasp_wrench + disturbance(k))
        errors.append(pushes(CHAIN, STATE, split(CHAIN, STATE, seen[-1] - wished).internal)[0])
    return np.array(errors)


SQUEEZED = np.array([[0.0, 0, 0, 7.0, 0, 0], [0.0, 0, 0, -7.0, 0, 0]])


@pytest.mark.parametrize("gain", [100.0, 700.0, 1500.0])
def test_the_integral_converges_as_predicted(gain):
    """Forces off by 7 N are brought to the wish as (1 - K_i T)^k, to 1e-9, up to the limit of stability."""
    errors = loop(HybridForce(gain, 1e-3, InternalForce(20.0)), lambda k: SQUEEZED, 20)
    assert errors == pytest.approx(7.0 * (1.0 - gain * 1e-3) ** np.arange(20), abs=1e-9)


def test_a_sample_late():
    """Then the error obeys e_k+1 = e_k - K_i T e_k-1."""
    errors = loop(HybridForce(400.0, 1e-3, InternalForce(20.0), late=True), lambda k: SQUEEZED, 25, late=True)
    assert errors[2:] == pytest.approx(errors[1:-1] - 0.4 * errors[:-2], abs=1e-9)
    assert abs(errors[-1]) < 0.01


def test_no_windup():
    """What a limit cuts off is not remembered: when 50 N too much end, the error is gone as fast as ever."""
    big = lambda k: 50.0 / 7.0 * SQUEEZED if k < 30 else np.zeros((2, 6))  # noqa: E731
    limited = HybridForce(500.0, 1e-3, InternalForce(20.0), limit=10.0 * np.sqrt(2))
    errors = loop(limited, big, 50)
    assert errors[5:30] == pytest.approx(40.0 * np.ones(25), abs=1e-9)  # 10 N of the 50
    assert errors[30:] == pytest.approx(-10.0 * 0.5 ** np.arange(20), abs=1e-9)


@pytest.mark.slow
def test_a_simulated_sensor():
    """A run whose controller believes in another box reaches the wished force by the sensor of the true one."""
    believed = replace(CHAIN, grasps={**CHAIN.grasps, "left": replace(
        CHAIN.grasps["left"], frame=hf.Pose.translation(0.0, 0.02, 0.0) @ CHAIN.grasps["left"].frame)})  # fmt: skip
    gaps = []
    for forces in (InternalForce(20.0), HybridForce(100.0, 1e-3, InternalForce(20.0), sensor=CHAIN)):
        law = cooperative_law(believed, STIFF, forces)
        run = hf.simulate(CHAIN, STATE, law, 0.5, 1e-3)
        assert run.stopped is None
        inside = split(believed, run.state(-1), run.grasp_wrench[-1]).internal
        normals = [run.state(-1).object_frame.R @ grasp.frame.R[:, 2] for grasp in believed.grasps.values()]
        wish = split(believed, run.state(-1), np.c_[np.zeros((2, 3)), 20.0 * np.array(normals)]).internal
        gaps.append(np.abs(inside - wish).max())
    assert gaps[1] < 0.01 < 0.2 < gaps[0]


@pytest.mark.long
def test_a_simulated_sensor_after_a_release():
    """When an arm lets go, its sensor has let go, too: the box stays where it is."""
    law = cooperative_law(CHAIN, STIFF, HybridForce(100.0, 1e-3, LoadShare({"left": 1.0}), sensor=CHAIN))
    run = hf.simulate(CHAIN, STATE, law, 0.03, 1e-3, events=[hf.Release(0.01, "right")])
    assert run.stopped is None and np.abs(run.object_pose - STATE.object_pose).max() < 1e-8
    assert run.grasp_wrench[-1, 0, 5] == pytest.approx(3.0 * 9.81, abs=1e-6)


def test_gains_beyond_stability():
    """Refused with the limit: 2 for an integral, 1 if measurements are a sample late."""
    HybridForce(1999.0, 1e-3)
    with pytest.raises(ModelError, match=r"gain \* sample_time < 2, the limit of stability of an integral, got 2"):
        HybridForce(2000.0, 1e-3)
    with pytest.raises(ModelError, match=r"gain \* sample_time < 1, the limit of stability with measurements a sample"):
        HybridForce(1000.0, 1e-3, late=True)
    with pytest.raises(ModelError, match=r"load share: no arm 'lft' holds the object\. Did you mean 'left'"):
        cooperative_law(CHAIN, STIFF, LoadShare({"lft": 1.0}))
    with pytest.raises(ModelError, match="expected the sum 1, got 0"):
        LoadShare({"left": 0.5})


def test_soft_fingers_share_too():
    """Grasps that transmit no rocking share the force as asked as far as moments allow; the box moves as commanded."""
    chain, state = rubber_pandas(0.8)
    found, alpha = wrenches(LoadShare({"left": 0.6, "right": 0.4}, 40.0), state, chain=chain)
    assert alpha == pytest.approx(np.zeros(6), abs=1e-9)
    assert found[:, 5].sum() == pytest.approx(3.0 * 9.81) and HERE.at(0.0).twist == pytest.approx(np.zeros(6))
