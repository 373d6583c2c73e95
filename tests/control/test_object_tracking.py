"""Gravity compensation holds every chain still; computed torque gives the object the acceleration that is commanded."""

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast import Pose, State, close, follow, forward_dynamics
from holdfast.control.grasp_forces import commanded_wrenches
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest, Target
from holdfast.control.posture_control import PostureControl
from holdfast.dynamics import project_velocity
from holdfast.errors import ModelError, StateError
from holdfast.forces.force_split import split
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.forces.margins import grasp_margins
from holdfast.simulation.simulate import simulate
from holdfast.spatial import rotation
from tests.control.two_pandas import pushes, rubber_pandas, two_pandas
from tests.planning.examples import carried, mobile
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain

pairs = pytest.mark.parametrize("kinds", [("rigid", "rigid"), ("rigid", "ball"), ("hinge", "softfinger")])


@pairs
def test_nothing_moves(kinds):
    """Gravity compensation: forward dynamics under its torques gives no acceleration, whatever the internal force."""
    chain, state = two_pandas(*kinds)
    tau, memory = GravityCompensation(chain, internal_force=30.0)(0.0, state, "kept")
    found = forward_dynamics(chain, state, tau)
    assert memory == "kept"
    assert np.abs(found.qdd).max() < 1e-10
    assert np.abs(found.object_acceleration).max() < 1e-10


def test_random_chains_stay_still():
    """So it is for arms of any shape, one of them without a grasp, gravity along any direction."""
    for seed in range(4):
        options = {"grasps": ["rigid", "hinge", None], "joints": [6, 7, 5], "extras": False, "moving_base": False}
        p = as_chain(well_conditioned_system(seed, **options))
        tau, _ = GravityCompensation(p.chain)(0.0, p.state.at_rest(), None)
        assert np.abs(forward_dynamics(p.chain, p.state.at_rest(), tau).qdd).max() < 1e-9


def test_squeeze_is_internal_and_of_its_size():
    """What 20 N more internal force adds moves nothing, and is 20 N along each normal."""
    chain, state = two_pandas()
    torques = (GravityCompensation(chain, force)(0.0, state, None)[0] for force in (0.0, 20.0))
    loose, tight = (forward_dynamics(chain, state, tau).grasp_wrench for tau in torques)
    added = tight - loose
    assert split(chain, state, added).motion == pytest.approx(np.zeros((2, 6)), abs=1e-9)
    assert np.linalg.norm(added[:, 3:], axis=1) == pytest.approx([20.0, 20.0], abs=1e-9)
    assert pushes(chain, state, added) == pytest.approx([20.0, 20.0], abs=1e-9)
    assert split(chain, state, loose).internal == pytest.approx(np.zeros((2, 6)), abs=1e-9)


def test_one_grasp_cannot_squeeze():
    """A single arm has no internal forces: the command is taken off again."""
    chain, state = two_pandas()
    alone = replace(chain, grasps={"left": chain.grasps["left"]})
    squeezed = commanded_wrenches(alone, state, np.zeros(6), 20.0)
    assert squeezed == pytest.approx(commanded_wrenches(alone, state, np.zeros(6)), abs=1e-12)
    assert squeezed[0, 5] == pytest.approx(3 * 9.81)


def test_joint_damping_slows_down():
    """Damping takes power from every moving joint."""
    chain, state = two_pandas()
    moving = State(state.q, np.ones(14), state.object_pose)
    damped, free = (GravityCompensation(chain, joint_damping=d)(0.0, moving, None)[0] for d in (2.0, 0.0))
    assert damped - free == pytest.approx(-2.0 * np.ones(14))


def moving_state(kinds):
    chain, state = two_pandas(*kinds)
    twist = np.array([0.1, -0.2, 0.3, 0.05, 0.1, -0.1])
    guess = State(state.q, 0.1 * np.cos(np.arange(14.0)), state.object_pose, twist)
    return chain, project_velocity(chain, guess, hold_object=True)


@pairs
def test_object_accelerates_as_commanded(kinds):
    """Forward dynamics under its torques returns the commanded acceleration, in full motion."""
    chain, state = moving_state(kinds)
    path = RestToRest(Pose.translation(0.02, 0.0, 0.7), np.array([0.0, 0.1, 0.2]), np.array([0.0, 0.0, 0.3]))
    controller = ObjectTracking(chain, path.at, internal_force=20.0)
    tau, _ = controller(0.4, state, None)
    found = forward_dynamics(chain, state, tau)
    assert found.object_acceleration == pytest.approx(controller.commanded_acceleration(0.4, state), abs=1e-9)
    internal = split(chain, state, found.grasp_wrench).internal
    assert pushes(chain, state, internal) == pytest.approx([20, 20], abs=1e-8)


def test_a_path_as_it_is():
    """A path object is as good as its `at`, also pickled and for another chain; what has none is refused."""
    chain, state = moving_state(("rigid", "ball"))
    path = RestToRest(Pose.translation(0.02, 0.0, 0.7), np.array([0.0, 0.1, 0.2]))
    expected, _ = ObjectTracking(chain, path.at, internal_force=20.0)(0.4, state, None)
    given = ObjectTracking(chain, path, internal_force=20.0)
    for controller in (given, given.for_chain(chain), pickle.loads(pickle.dumps(given))):
        assert np.array_equal(controller(0.4, state, None)[0], expected)
    for wrong in (None, 3.0, "path", Pose.identity()):
        with pytest.raises(ModelError, match="expected a path such as RestToRest"):
            ObjectTracking(chain, wrong)  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_tracking_converges_critically_damped():
    """From 2 cm and 0.1 rad off, the error is e_0 (1 + w t) exp(-w t) with w = 10 rad/s."""
    chain, state = two_pandas()
    offset, turn = np.array([0.01, -0.02, 0.015]), np.array([0.0, 0.0, 0.1])
    goal = Pose(rotation.exp(turn) @ state.object_frame.R, state.object_frame.p + offset)
    controller = ObjectTracking(chain, lambda t: Target(goal, np.zeros(6), np.zeros(6)))
    run = simulate(chain, state, controller, 0.3, 0.01)
    assert run.stopped is None
    left = (1 + 10 * run.t) * np.exp(-10 * run.t)
    assert goal.p - run.object_pose[:, 4:] == pytest.approx(left[:, None] * offset, abs=1e-6)
    turns = [rotation.log(goal.R @ run.state(k).object_frame.R.T) for k in range(len(run))]
    assert np.array(turns) == pytest.approx(left[:, None] * turn, abs=1e-5)


@pytest.mark.slow
def test_path_is_followed_from_its_start():
    """A path that starts at the object is followed to the integrator's accuracy, internal force held."""
    chain, state = two_pandas("rigid", "hinge")
    path = RestToRest(state.object_frame, np.array([0.0, 0.02, 0.03]), np.array([0.0, 0.0, 0.1]), 0.0, 0.2)
    run = simulate(chain, state, ObjectTracking(chain, path.at, internal_force=15.0), 0.2, 0.01)
    for k in (5, 10, 20):
        target = path.at(run.t[k])
        assert run.object_pose[k, 4:] == pytest.approx(target.pose.p, abs=1e-6)
        assert run.object_twist[k] == pytest.approx(target.twist, abs=1e-4)
        internal = split(chain, run.state(k), run.grasp_wrench[k]).internal
        assert np.linalg.norm(internal[:, 3:], axis=1) == pytest.approx([15, 15], abs=1e-6)


@pytest.mark.slow
def test_null_motion_is_damped():
    """Elbows that swing without moving the object come to rest at the joint damping's rate."""
    chain, state = two_pandas()
    swing = project_velocity(chain, State(state.q, np.tile(np.eye(7)[2], 2), state.object_pose), hold_object=True)
    goal = Target(state.object_frame, np.zeros(6), np.zeros(6))
    run = simulate(chain, swing, ObjectTracking(chain, lambda t: goal, joint_damping=10.0), 0.1, 0.01)
    rates = np.linalg.norm(run.qd, axis=1)
    assert rates[0] > 0.05
    assert rates[-1] / rates[0] == pytest.approx(np.exp(-1), rel=0.02)


def test_an_arm_without_a_grasp_is_damped():
    """An arm that holds nothing is held up and slowed down."""
    chain, state = two_pandas()
    loose = chain.without_grasp("right")
    moving = close(loose, State(state.q, np.r_[np.zeros(7), np.ones(7)], state.object_pose), hold_object=True)
    goal = Target(state.object_frame, np.zeros(6), np.zeros(6))
    tau, _ = ObjectTracking(loose, lambda t: goal, joint_damping=5.0)(0.0, moving, None)
    assert forward_dynamics(loose, moving, tau).qdd[7:] == pytest.approx(-5.0 * np.ones(7), abs=1e-8)


@pytest.mark.parametrize("velocity", [1e200, 1e307])
def test_velocities_that_overflow(velocity):
    """Torques and the commanded acceleration are refused where they overflow; neither is NaN or infinite."""
    chain, state = two_pandas()
    law = ObjectTracking(chain, RestToRest(state.object_frame))
    wild = State(state.q, np.full(14, velocity), state.object_pose, np.full(6, velocity))
    with pytest.raises(StateError, match="object tracking"):
        law(0.0, wild, None)
    if velocity == 1e307:
        with pytest.raises(StateError, match="object tracking: acceleration: expected finite numbers"):
            law.commanded_acceleration(0.0, wild)


@pytest.mark.parametrize("angle", [np.pi, np.deg2rad(179.9999), 2.0, 1e-6])
@pytest.mark.parametrize("axis", np.eye(3))
def test_commands_half_a_turn(axis, angle):
    """Half a turn off is an error of pi, about either sense of its axis; truth: SciPy's rotation vector."""
    chain, state = two_pandas()
    turn = Rotation.from_rotvec(angle * axis)
    R = np.round(turn.as_matrix()) if angle == np.pi else turn.as_matrix()
    goal = Pose(R @ state.object_frame.R, state.object_frame.p)
    still = State(state.q, np.zeros(14), state.object_pose, np.zeros(6))
    controller = ObjectTracking(chain, lambda t: Target(goal, np.zeros(6), np.zeros(6)), stiffness=2.0)
    found = controller.commanded_acceleration(0.0, still)[:3] / 2.0
    assert np.linalg.norm(found) == pytest.approx(Rotation.from_matrix(R).magnitude(), abs=1e-9)
    assert np.linalg.norm(Rotation.from_rotvec(found).as_matrix() - R) < 1e-9


@pairs
def test_within_limits(kinds):
    """The acceleration is the commanded one, and torques are within what is allowed; wishes are followed within it."""
    chain, state = two_pandas(*kinds)
    path = RestToRest(state.object_frame, displacement=[0.0, 0.0, 0.1], duration=0.6)
    most = 0.5 * np.array([joint.effort_limit for joint in chain.all_joints])
    free = ObjectTracking(chain, path, internal_force=5.0)
    bound = ObjectTracking(chain, path, internal_force=5.0, limits=ForceLimits(effort=0.5))
    wished = ObjectTracking(
        chain, path, 5.0, limits=ForceLimits(effort=0.8), cost=ForceCost(wrench=100.0, acceleration=100.0, price=1e7)
    )
    for t in (0.0, 0.2):
        tau, memory = bound(t, state, "kept")
        assert memory == "kept" and (np.abs(tau) <= most * (1 + 1e-9)).all()
        found = forward_dynamics(chain, state, tau)
        assert found.object_acceleration == pytest.approx(free.commanded_acceleration(t, state), abs=1e-9)
    fine, near = (one(0.2, state, None)[0] for one in (free, wished))
    assert (np.abs(fine) < 1.6 * most).all()
    assert near == pytest.approx(fine, abs=2e-3 * np.abs(fine).max())
    loose = bound.for_chain(replace(chain, grasps={"left": chain.grasps["left"]}))
    assert loose.limits is not None and [*loose.chain.grasps] == ["left"]


def test_friction_holds_within_limits():
    """A box between fingers is lifted with the margin that is demanded."""
    chain, state = rubber_pandas(0.8)
    path = RestToRest(state.object_frame, displacement=[0.0, 0.0, 0.1], duration=0.5)
    track = ObjectTracking(chain, path, limits=ForceLimits(effort=0.8, least_margin=40.0))
    for t in (0.1, 0.3):
        found = forward_dynamics(chain, state, track(t, state, None)[0])
        assert min(grasp_margins(chain, state, found.grasp_wrench)) == pytest.approx(40.0, abs=1e-6)


@pytest.mark.slow
def test_a_mobile_base_drives():
    """A tray is carried 0.3 m; the base, which is only damped without a posture, goes most of the way with a plan."""
    chain, start = mobile()
    path = carried(start, [0.3, 0.0, 0.0], duration=3.0)
    plan = follow(chain, start, path, 3.0, 0.1)
    track = ObjectTracking(chain, path, posture=PostureControl(plan, 5.0))
    run = simulate(chain, plan.state_at(0.0), track, 3.0, 0.01)
    assert run.stopped is None
    assert run.object_pose[-1, 4] - run.object_pose[0, 4] == pytest.approx(0.3, abs=1e-5)
    assert run.q[-1, 0] - run.q[0, 0] > 0.2
    assert run.q[-1] == pytest.approx(plan.q[-1], abs=1e-5)
    damped = simulate(chain, plan.state_at(0.0), replace(track, posture=None), 3.0, 0.01)
    assert "nearly singular" in str(damped.stopped)  # of arms that reach for the tray
    assert np.abs(damped.q[-1, 0] - damped.q[0, 0]) < 0.02


def test_refused_parts():
    """A posture of another chain, a cost without limits, and what is no limit are named."""
    chain, state = two_pandas()
    path = RestToRest(state.object_frame)
    cases: list[tuple[dict[str, Any], str]] = [
        ({"posture": PostureControl(np.zeros(3))}, "posture: rest: expected shape"),
        ({"posture": 1.0}, "object tracking: posture"),
        ({"cost": ForceCost()}, "object tracking: expected limits with a cost"),
        ({"limits": 0.8}, "object tracking: limits"),
    ]
    for wrong, said in cases:
        with pytest.raises(ModelError, match=said):
            ObjectTracking(chain, path, **wrong)
