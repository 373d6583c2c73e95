"""Laws within limits: torques, friction and joints stay within them, and where they are far, the law is the law."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.force_bars import nearly_straight
from scipy.linalg import expm

import holdfast as hf
from holdfast.control import (
    HybridForce,
    InternalForce,
    LoadShare,
    ObjectImpedance,
    PostureControl,
    RestToRest,
    compile_law,
    cooperative_law,
    sampled,
)
from holdfast.dynamics.constraint import length_scale
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.forces import ForceCost, ForceLimits, distribute, distribution_parameters, split
from holdfast.spatial import rotation
from tests.control.kit import CHAIN, DAMPER, HERE, MASS, SPRING, STATE, STIFF, N, moving
from tests.control.two_pandas import pushes, rubber_pandas, two_pandas
from tests.longer import mostly_slow
from tests.planning.examples import mobile

EFFORT = np.array([joint.effort_limit for joint in CHAIN.all_joints])
FOLLOWING = ForceCost(wrench=1.0)  # wishes outweigh effort
FAR = ForceLimits(effort=None)
NOTHING: dict[str, Any] = {"external_wrench": np.zeros(6)}


def lift(state, height=0.1, duration=0.5):
    """Return an impedance whose path lifts the box."""
    return ObjectImpedance(
        RestToRest(state.object_frame, displacement=[0, 0, height], duration=duration), SPRING, DAMPER
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "kinds",
    [
        pytest.param(("rigid", "rigid"), marks=pytest.mark.slow),
        ("softfinger", "ball"),
        pytest.param(("hinge", "softfinger"), marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("sample_time", mostly_slow([None, 1e-3], (None,)))
def test_the_same_as_compiled_distribute(kinds, sample_time):
    """Asked for the same acceleration, wrenches and posture, `distribute` gives the same, to 1e-8 of the limits.

    The iterate is kept from a residual of 1e-9 on, so rounding may decide which iterate that is.
    """
    chain, state = two_pandas(*kinds)
    wish = np.random.default_rng(2).normal(scale=20.0, size=(2, 6))
    limits = ForceLimits(0.3, least_margin={"left": 1.0}, most_normal=50.0, sample_time=sample_time)
    motion = ObjectImpedance(HERE, SPRING, DAMPER, MASS)
    law = cooperative_law(
        chain, motion, InternalForce(wish), PostureControl(state.q + 0.1, 4.0), limits=limits, cost=FOLLOWING
    )
    compiled = compile_law(law, chain)
    fast = hf.compile(chain, parameters=["acceleration_limits"] if sample_time else [])
    for seed in range(3):
        now = moving(seed, chain, state)
        turn = rotation.log(HERE.at(0.0).pose.R @ now.object_frame.R.T)
        error = np.r_[turn, HERE.at(0.0).pose.p - now.object_frame.p]
        command = (SPRING * error - DAMPER * now.object_twist) / MASS
        arrays = now.q, now.qd, now.object_pose, now.object_twist
        given: dict[str, Any] = distribution_parameters(chain, now, limits, FOLLOWING)
        given |= {"wish": wish, "wished_qdd": 16.0 * (state.q + 0.1 - now.q) - 8.0 * now.qd}
        expected = fast.distribute(*arrays, command, **given)
        found = compiled.torques(0.0, *arrays, **NOTHING)
        assert found.tau / EFFORT == pytest.approx(expected.tau / EFFORT, rel=0.0, abs=1e-8)
        assert found.memory[0] == pytest.approx(float(expected.violation), abs=1e-8)


@pytest.mark.parametrize("weight", [None, 100.0])
def test_trunk(weight):
    """On a platform too, a law says what `distribute` says: arms and platform share the motion."""
    chain, state = mobile()
    cost = replace(FOLLOWING, task=weight)
    law = cooperative_law(
        chain, ObjectImpedance(HERE, SPRING, DAMPER, MASS), posture=PostureControl(state.q), limits=FAR, cost=cost
    )
    speeds = 0.3 * np.random.default_rng(1).normal(size=len(state.q))
    now = hf.dynamics.project_velocity(chain, replace(state, qd=speeds))
    turn = rotation.log(HERE.at(0.0).pose.R @ now.object_frame.R.T)
    command = (SPRING * np.r_[turn, HERE.at(0.0).pose.p - now.object_frame.p] - DAMPER * now.object_twist) / MASS
    tau, memory = law.given(NOTHING)(0.0, now, None)
    wished = replace(cost, joint_acceleration=25.0 * (state.q - now.q) - 10.0 * now.qd)
    expected = distribute(chain, now, command, limits=FAR, cost=wished)
    assert expected.status == "optimal"
    assert tau == pytest.approx(expected.tau, abs=1e-6 * np.abs(expected.tau).max())
    assert len(memory) == (1 if weight is None else 2)
    assert memory[0] < 1e-8
    if weight is not None:
        assert memory[1] == pytest.approx(np.abs(expected.object_acceleration - command).max(), abs=1e-8)


@pytest.mark.parametrize("bend", [1e-3, 1e-5, 1e-7])
def test_near_singular_postures(bend):
    """However little elbows are bent, torques keep their limits; the memory says what the object's motion lacks."""
    chain, state = nearly_straight(bend)
    law = cooperative_law(chain, lift(state), limits=ForceLimits(), cost=ForceCost(task=100.0))
    tau, (gave_way, missed) = law(0.05, state, None)
    efforts = np.array([joint.effort_limit for joint in chain.all_joints])
    assert (np.abs(tau) / efforts).max() <= 1.0 + 1e-9
    assert gave_way < 1e-9
    exact, _ = cooperative_law(chain, lift(state), limits=ForceLimits())(0.05, state, None)
    assert (np.abs(exact) / efforts).max() > 1.0
    found = hf.forward_dynamics(chain, state, tau).object_acceleration
    asked = hf.forward_dynamics(chain, state, exact).object_acceleration
    assert missed == pytest.approx(np.abs(found - asked).max(), rel=1e-4)
    assert missed > 0.1


@pytest.mark.slow
def test_a_mobile_manipulator_moves_its_tray():
    """Machine code takes most of the way with the platform, and keeps efforts, rates and ranges of joints."""
    chain, state = mobile()
    trunk, T = chain.trunk, 0.01
    assert trunk is not None
    wheels = [replace(joint, effort_limit=500.0, rate_limit=0.5) for joint in trunk.joints]
    chain = replace(chain, trunk=replace(trunk, joints=wheels))
    path = RestToRest(state.object_frame, [0.3, 0, 0], duration=3.0)
    motion = ObjectImpedance(path, 100.0 * np.ones(6), 20.0 * np.ones(6))
    limits, cost = ForceLimits(sample_time=T), ForceCost(acceleration=10.0)
    law = cooperative_law(chain, motion, posture=PostureControl(state.q, 5.0), limits=limits, cost=cost)
    run = hf.simulate(chain, state, sampled(law, chain, sample_time=T), 3.0, T)
    efforts, rates = np.array([(joint.effort_limit, joint.rate_limit) for joint in chain.all_joints]).T
    assert run.stopped is None
    assert run.q[-1, 0] - run.q[0, 0] > 0.2
    assert run.object_pose[-1, 4] - run.object_pose[0, 4] == pytest.approx(0.3, abs=1e-3)
    assert (np.abs(run.tau) <= efforts * (1.0 + 1e-9)).all() and (np.abs(run.qd) <= rates).all()


@pytest.mark.slow
def test_drives_stay_within_their_effort():
    """A squeeze that takes 3.5 times what the drives have is held as far as they go; the box follows its path alike."""
    motion, squeeze = lift(STATE), InternalForce(500.0)
    free = hf.simulate(CHAIN, STATE, cooperative_law(CHAIN, motion, squeeze), 0.5, 5e-3)
    law = cooperative_law(CHAIN, motion, squeeze, limits=ForceLimits(), cost=FOLLOWING)
    run = hf.simulate(CHAIN, STATE, law, 0.5, 5e-3)
    assert (np.abs(free.tau) / EFFORT).max() > 3.0
    used = (np.abs(run.tau) / EFFORT).max(axis=1)
    assert (used > 0.999).all() and (used <= 1.0 + 1e-9).all()
    assert run.object_pose == pytest.approx(free.object_pose, abs=1e-8)


@pytest.mark.long
def test_least_force_by_friction():
    """Margins are as demanded all along, with less effort than the smallest constant squeeze that keeps them."""
    chain, state = rubber_pandas(0.8)
    motion = lift(state)
    law = cooperative_law(chain, motion, limits=ForceLimits(0.8, least_margin=2.0))
    run = hf.simulate(chain, state, law, 0.5, 5e-3)
    assert run.stopped is None
    assert run.margin.min() == pytest.approx(2.0, abs=1e-6)
    for squeeze, enough in ((25.3, True), (25.2, False)):
        constant = hf.simulate(chain, state, cooperative_law(chain, motion, InternalForce(squeeze)), 0.5, 5e-3)
        assert (constant.margin.min() >= 2.0) == enough
        effort, more = (((x.tau / EFFORT) ** 2).sum(axis=1) for x in (run, constant))
        assert (effort < 0.99 * more).all() and effort.mean() < 0.92 * more.mean()
        assert constant.object_pose == pytest.approx(run.object_pose, abs=1e-8)


@pytest.mark.parametrize("kinds", [("rigid", "rigid"), ("rigid", "ball"), ("hinge", "softfinger")])
def test_far_limits_do_not_touch_the_motion(kinds):
    """M_d (alpha - alpha_d) + D (V - V_d) = K e + w to 1e-8, and limits do not give way."""
    chain, state = two_pandas(*kinds)
    push = np.array([0.4, -0.3, 0.2, 6.0, -4.0, 8.0])
    law = cooperative_law(chain, ObjectImpedance(HERE, SPRING, DAMPER, MASS), limits=ForceLimits())
    for seed in range(3):
        now = moving(seed, chain, state)
        tau, memory = law.given({"external_wrench": push})(0.0, now, None)
        found = hf.forward_dynamics(chain, now, tau, inputs=hf.Inputs(object_wrench=push))
        turn = rotation.log(state.object_frame.R @ now.object_frame.R.T)
        pulled = SPRING * np.r_[turn, HERE.at(0.0).pose.p - now.object_frame.p] - DAMPER * now.object_twist
        assert MASS * found.object_acceleration == pytest.approx(pulled + push, abs=1e-8)
        assert 0.0 <= memory[0] < 1e-8


@pytest.mark.slow
def test_error_is_that_of_a_linear_system():
    """From 2 cm off, M_d e'' + D e' + K e = 0: the run has the exponential's values, to 1e-8."""
    offset = np.array([0.01, -0.02, 0.015])
    goal = RestToRest(hf.Pose(STATE.object_frame.R, STATE.object_frame.p + offset))
    law = cooperative_law(CHAIN, ObjectImpedance(goal, SPRING, DAMPER, MASS), limits=ForceLimits())
    run = hf.simulate(CHAIN, STATE, law, 0.2, 1e-3, parameters=NOTHING)
    stiffness, damping = SPRING[3] / MASS[3], DAMPER[3] / MASS[3]
    A = np.array([[0.0, 1.0], [-stiffness, -damping]])
    for k in (50, 100, 200):
        e = expm(A * run.t[k])[0, 0] * offset
        assert goal.at(0.0).pose.p - run.object_pose[k, 4:] == pytest.approx(e, abs=1e-8)


@pytest.mark.slow
def test_joints_keep_their_limits():
    """A posture that drives wrists over their limits at too high a rate: a sampled law within limits stops in time."""
    null = hf.dynamics.project_velocity(
        CHAIN, hf.State(STATE.q, np.tile(np.eye(7)[2], 2), STATE.object_pose), hold_object=True
    ).qd
    posture = PostureControl(STATE.q + 0.6 * null / np.abs(null).max(), 8.0)
    j, T = 4, 2e-3
    narrow = {"position_limits": (STATE.q[j] - 0.2, STATE.q[j] + 0.2), "rate_limit": 0.6}
    left = CHAIN.arms["left"]
    joints = [replace(joint, **narrow) if k == j else joint for k, joint in enumerate(left.joints)]
    chain = replace(CHAIN, arms={**CHAIN.arms, "left": replace(left, joints=joints)})
    runs = []
    for sample_time in (None, T):
        limits = ForceLimits(sample_time=sample_time, braking=5.0)
        law = sampled(cooperative_law(chain, STIFF, posture=posture, limits=limits), chain, sample_time=T)
        runs.append(hf.simulate(chain, STATE, law, 0.8, T))
    (q, qd), (kept_q, kept_qd) = ((run.q[:, j] - STATE.q[j], run.qd[:, j]) for run in runs)
    assert q.max() > 0.4 and qd.max() > 1.5
    assert 0.19 < kept_q.max() < 0.2 + 1e-5 and 0.59 < kept_qd.max() < 0.6 + 1e-3
    assert runs[1].object_pose == pytest.approx(runs[0].object_pose, abs=2e-4)  # torques are held for 2 ms


@pytest.mark.slow
def test_the_integral_does_not_wind_up():
    """Where the normal force is at its limit, the memory of the integral is what was achieved."""
    forces = HybridForce(500.0, 1e-3, InternalForce(20.0))
    law = cooperative_law(
        CHAIN, STIFF, forces, limits=ForceLimits(most_normal=30.0), cost=ForceCost(wrench=100.0, price=1e7)
    )
    wished = cooperative_law(CHAIN, STIFF, InternalForce(20.0))(0.0, STATE, None)[0]
    wished = measured = hf.forward_dynamics(CHAIN, STATE, wished).grasp_wrench
    off, memory, errors = np.array([[0.0, 0, 0, 50, 0, 0], [0.0, 0, 0, -50, 0, 0]]), None, []
    for k in range(30):
        tau, memory = law.given({"measured_wrenches": measured})(0.0, STATE, memory)
        acts = hf.forward_dynamics(CHAIN, STATE, tau).grasp_wrench
        assert max(pushes(CHAIN, STATE, acts)) < 30.0 + 1e-6
        achieved = split(CHAIN, STATE, acts - wished).internal @ np.kron(np.eye(2), STATE.object_frame.R)
        assert memory[:12].reshape(2, 6) == pytest.approx(achieved, abs=1e-6)
        measured = acts - off * (k < 15)
        errors.append(pushes(CHAIN, STATE, split(CHAIN, STATE, measured - wished).internal)[0])
    assert errors[2:15] == pytest.approx(-40.0 * np.ones(13), abs=1e-2)  # 10 N of the 50
    assert errors[15:] == pytest.approx(10.0 * 0.5 ** np.arange(15), abs=1e-2)


def test_what_the_acceleration_needs_is_reported():
    """A path too fast for the drives: the box follows, and torques pass their limits by v L, as the memory says."""
    law = cooperative_law(CHAIN, lift(STATE, 0.2, 0.15), limits=ForceLimits(0.2))
    tau, (gave_way,) = law(0.03, STATE, None)
    length = length_scale([grasp.frame.p for grasp in CHAIN.grasps.values()])
    assert gave_way > 100.0
    assert (np.abs(tau) - 0.2 * EFFORT).max() == pytest.approx(gave_way * length, rel=1e-6)


@pytest.mark.long
def test_hand_over():
    """A grasp with limits of its own opens, and its limits go with it."""
    limits = ForceLimits(0.8, least_normal={"right": 1.0, "left": -200.0})
    law = cooperative_law(CHAIN, STIFF, LoadShare({"left": 1.0}), limits=limits, cost=ForceCost(wrench=10.0))
    run = hf.simulate(CHAIN, STATE, law, 0.03, 1e-3, events=[hf.Release(0.01, "right")])
    assert run.stopped is None
    assert pushes(CHAIN, STATE, run.grasp_wrench[5])[1] > 1.0 - 1e-6
    assert run.grasp_wrench[-1, 0, 5] == pytest.approx(3.0 * 9.81, abs=0.1)
    assert (np.abs(run.tau) <= 0.8 * EFFORT * (1.0 + 1e-9)).all()


@pytest.mark.long
def test_no_gradients_without_a_barrier():
    """A rollout of a law within limits says what is missing; with a barrier it has them (`test_force_bars`)."""
    chain, state = two_pandas("ball", "rigid")
    law = cooperative_law(chain, ObjectImpedance(HERE, SPRING, DAMPER), limits=ForceLimits())
    rollout = hf.compile_rollout(chain, law)
    taken = rollout.tape(rollout.start(state.q, state.qd, state.object_pose, 0.1 * np.ones((2, 6))), 1e-3, steps=2)
    with pytest.raises(StateError, match=r"tape: vjp: .* not numbers.*try .*cost=ForceCost\(barrier=1e-5\)"):
        taken.vjp({"q": np.ones((2, chain.joint_count))}, by=["qd"])


def test_refused():
    """Limits of changes, wishes that belong to parts, and a cost without limits."""
    law = cooperative_law
    with pytest.raises(MethodNotApplicable, match="no limit on the change of wrenches"):
        law(CHAIN, STIFF, limits=ForceLimits(last_wrench=np.zeros((2, 6)), wrench_change=1.0))
    with pytest.raises(ModelError, match="cost: expected no wish, got one; it is that of `forces`"):
        law(CHAIN, STIFF, limits=ForceLimits(), cost=ForceCost(wish=np.zeros((2, 6))))
    with pytest.raises(ModelError, match="expected no joint_acceleration, got one; it is that of `posture`"):
        law(CHAIN, STIFF, limits=ForceLimits(), cost=ForceCost(joint_acceleration=np.zeros(N)))
    with pytest.raises(ModelError, match="expected limits with a cost, got none"):
        law(CHAIN, STIFF, cost=ForceCost())
    with pytest.raises(ModelError, match=r"no grasp 'lft'\. Did you mean 'left'"):
        law(CHAIN, STIFF, limits=ForceLimits(least_margin={"lft": 1.0}))
    with pytest.raises(ModelError, match="cooperative law: limits: expected ForceLimits"):
        law(CHAIN, STIFF, limits=0.8)  # pyright: ignore[reportArgumentType]
