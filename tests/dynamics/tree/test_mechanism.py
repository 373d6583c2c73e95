"""Chains with branches, loops, couplings and several objects: forward dynamics in their own terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.tree.forest_dynamics import forest_dynamics
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.model.forest import BodyJoint, Forest, ForestBody
from tests.dynamics.tree.as_branched import STRAY, gap, serial_problems, with_stray
from tests.oracles.forest_equations import ForestEquations
from tests.systems.branched import FINGERS, two_arms_with_grippers
from tests.systems.bricard import AXES, POINTS, bricard
from tests.systems.n_four_bar import LENGTH, n_four_bar
from tests.systems.random_parts import rotation as random_rotation
from tests.systems.squeezer import ACCELERATIONS, FIRST_LOOP, squeezer


@pytest.mark.parametrize("name", serial_problems())
def test_an_object_that_nothing_holds(name):
    """Another object makes the chain a forest, changes nothing else, and falls under its own wrench."""
    p = serial_problems()[name]
    wrench = np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0])
    chain, state, tau, inputs = with_stray(p, wrench)
    found = hf.forward_dynamics(chain, state, tau, inputs=inputs, check=False)
    wanted = hf.forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs, check=False)
    held = [list(chain.arms).index(name) for name in chain.grasps]
    assert gap(found.qdd, wanted.qdd) < 1e-10
    assert gap(found.grasp_wrench, wanted.grasp_wrench[held]) < 1e-10
    assert gap(found.accelerations["object"], wanted.object_acceleration) < 1e-10
    if chain.floats:
        assert gap(found.base_acceleration, wanted.base_acceleration) < 1e-10
    fall = np.concatenate([wrench[:3] / np.diag(STRAY.inertia), wrench[3:] / STRAY.mass + chain.gravity])
    assert gap(found["stray"], fall) < 1e-13


@pytest.mark.parametrize("method", ["sequential", "kkt"])
def test_two_arms_with_grippers(method):
    """Fingers with mimic joints, one of which touches the box: as the dense equations of every body in fifty digits."""
    chain, state, tau = two_arms_with_grippers()
    found = hf.forward_dynamics(chain, state, tau, method=method)
    forest = chain.forest
    q, none = np.concatenate([state.q, state.object_pose]), np.zeros(forest.velocity_count)
    truth = ForestEquations(forest, q, none, np.append(tau, np.zeros(6)), np.zeros((17, 6)), digits=50).solved()
    pairs = [
        (np.append(found.qdd, found.object_acceleration), truth.qdd),
        (found.grasp_wrench, truth.closure_wrench),
        (found.coupling_force, truth.coupling_force),
    ]
    assert max(gap(*pair) for pair in pairs) < 1e-10
    assert (found.rank, found.mobility) == (truth.rank, 22 - truth.rank)
    np.testing.assert_allclose(found["arm1"][6], found["arm1"][7], atol=1e-10)  # both fingers
    np.testing.assert_array_equal(found["arm1", "pad1"], found.grasp_wrench[1])


def test_andrews_squeezer():
    """Seven bodies and three loops: the published accelerations, and the force in the first loop."""
    chain, state, tau, inputs = squeezer()
    found = hf.forward_dynamics(chain, state, tau, inputs=inputs)
    order = [list(ACCELERATIONS).index(name.partition("/")[2]) for name in chain.joint_names()]
    published = np.array([*ACCELERATIONS.values()])[order]
    np.testing.assert_allclose(found.qdd, published, rtol=1e-12, atol=1e-8)
    assert (found.rank, found.mobility) == (6, 1)
    np.testing.assert_allclose(found["m/ground"][3:5], FIRST_LOOP, rtol=1e-9)


def test_bricard():
    """Five bars in a row and a hinge to the ground, without an object: as two arms that hold the middle bar."""
    held, at = bricard()
    joints, links, before = [], [], np.zeros(3)
    every = [*held.arms["left"].links, held.held_object, *held.arms["right"].links[::-1]]
    for k, link in enumerate(every):
        joints.append(hf.Joint("revolute", AXES[k], hf.Pose(np.eye(3), POINTS[k] - before), f"bar{k}"))
        links.append(hf.Link(link.mass, 0.5 * (POINTS[k + 1] - POINTS[k]), link.inertia, f"bar{k}"))
        before = POINTS[k]
    turn = np.column_stack([AXES[5], AXES[0], np.cross(AXES[5], AXES[0])])  # a frame whose x axis is the last hinge's
    end, ground = hf.Pose(turn, POINTS[5] - POINTS[4]), hf.Pose(turn, POINTS[5])
    loop = hf.Closure(None, "bar4", hf.Grasp("hinge", end), ground)
    chain = hf.ClosedChain({"bars": hf.Arm(joints, links, loops={"last": loop})}, gravity=held.gravity)
    found = hf.forward_dynamics(chain, hf.State(np.zeros(5), np.zeros(5)), np.zeros(5))
    wanted = hf.forward_dynamics(held, at, np.zeros(4))
    assert gap(found.qdd[:2], wanted.qdd[held.joints["left"]]) < 1e-12
    assert (found.rank, found.mobility) == (4, 1)


@pytest.mark.parametrize("cranks", [2, 3, 5])
def test_n_four_bar(cranks):
    """The rod as a branch of the first crank, and loops to the others: as cranks that hold it as an object."""
    held, at = n_four_bar(cranks)
    arms, rod, loops = {}, held.held_object, {}
    for k, (name, arm) in enumerate(held.arms.items()):
        crank = replace(arm.links[0], name="crank")
        if k == 0:
            hinge = hf.Joint("revolute", (0, 0, 1), hf.Pose.translation(LENGTH, 0.0, 0.0), "rod")
            length = 0.5 * (cranks - 1) * LENGTH
            body = hf.Link(rod.mass, [length, 0.0, 0.0], rod.inertia, "rod")
            arms[name] = hf.Arm([*arm.joints, hinge], [crank, body])
            continue
        arms[name] = hf.Arm(arm.joints, [crank], tip=arm.tip, base=arm.base)
        place = hf.Pose(arm.tip.R, [k * LENGTH, 0.0, 0.0])
        loops[name + "'"] = hf.Closure(f"{name}/crank", "crank0/rod", hf.Grasp("hinge", place), arm.tip)
    chain = hf.ClosedChain(arms, loops=loops, gravity=held.gravity)
    q, qd = np.insert(at.q, 1, -np.pi / 2), np.insert(at.qd, 1, -at.qd[0])
    found = hf.forward_dynamics(chain, hf.State(q, qd), np.zeros(cranks + 1))
    wanted = hf.forward_dynamics(held, at, np.zeros(cranks))
    assert gap(np.delete(found.qdd, 1), wanted.qdd) < 1e-12
    assert found.mobility == 1


def test_a_spherical_joint():
    """A link on a spherical joint moves as an object in the ball of an anchor, with the same force in the ball."""
    random = np.random.default_rng(3)
    at, frame = hf.Pose(random_rotation(random), random.normal(size=3)), hf.Pose.translation(0.3, 0.1, -0.2)
    body = hf.HeldObject(2.0, np.diag([0.1, 0.2, 0.25]), random.normal(scale=0.1, size=3))
    held = hf.ClosedChain({"pin": hf.Anchor(at)}, body, {"pin": hf.Grasp("ball", frame)})
    turn, spin = random_rotation(random), random.normal(size=3)
    of_object = hf.Pose(turn, at.p - turn @ frame.p)
    twist = np.concatenate([spin, np.cross(spin, of_object.p - at.p)])
    wanted = hf.forward_dynamics(held, hf.State([], [], of_object, twist), [])
    link = hf.Link(body.mass, body.com - frame.p, body.inertia, "pendulum")
    arm = hf.Arm([hf.Joint("spherical", placement=hf.Pose.translation(0.1, 0.0, 0.0))], [link])
    arm = arm.at(at @ hf.Pose.translation(-0.1, 0.0, 0.0))
    q = hf.Pose(at.R.T @ turn, np.zeros(3)).wxyz_xyz[:4]
    found = hf.forward_dynamics(hf.ClosedChain({"arm": arm}), hf.State(q, at.R.T @ spin), np.zeros(3))
    assert gap(at.R @ found.qdd, wanted.object_acceleration[:3]) < 1e-13
    assert gap(hf.dynamics.link_poses(arm, q)[0].R, turn) < 1e-15


def test_a_planar_joint():
    """Its three parts are the planar joint of a forest, whose rotation comes first."""
    random = np.random.default_rng(4)
    at, axis = hf.Pose(random_rotation(random), random.normal(size=3)), random_rotation(random)[0]
    joint, link = hf.Joint("planar", axis, at), hf.Link(2.0, [0.1, 0.2, 0.3], np.diag([0.1, 0.2, 0.25]), "slider")
    arm = hf.Arm([joint, hf.Joint(placement=at)], [link, link])
    q, qd, tau = random.normal(size=(3, 4))
    found = hf.forward_dynamics(hf.ClosedChain({"arm": arm}), hf.State(q, qd), tau)
    across = arm.joints[0].axis
    bodies = [
        ForestBody(link, BodyJoint("planar", at, axis, across)),
        ForestBody(link, BodyJoint("revolute", at), 0),
    ]
    order = [2, 0, 1, 3]
    same = forest_dynamics(Forest(bodies), q[order], qd[order], tau[order])
    assert gap(found.qdd[order], same.qdd) < 1e-12


def test_springs_and_dampers_of_joints():
    """A spring in a joint is its torque, and so is a damper."""
    chain, state, tau = two_arms_with_grippers()
    arm = chain.arms["arm1"]
    joints = [replace(joint, stiffness=3.0, rest=0.2, damping=0.0) for joint in arm.joints]
    sprung = replace(chain, arms={**chain.arms, "arm1": arm.of(joints)})
    loose = replace(chain, arms={**chain.arms, "arm1": arm.of([replace(joint, damping=0.0) for joint in arm.joints])})
    moved = tau.copy()
    moved[:8] -= 3.0 * (state.q[:8] - 0.2)
    found, wanted = hf.forward_dynamics(sprung, state, tau), hf.forward_dynamics(loose, state, moved)
    assert gap(found.qdd, wanted.qdd) < 1e-12


def test_closing():
    """An open state is closed nearby, with rates that keep grasps and couplings; limits and unused arguments refuse."""
    p, random = two_arms_with_grippers(), np.random.default_rng(1)
    opened = replace(p.state, q=p.state.q + 1e-2 * random.normal(size=16), qd=random.normal(size=16))
    state = hf.close(p.chain, opened)
    assert np.abs(state.q - p.state.q).max() < 0.05
    assert hf.forward_dynamics(p.chain, state, p.tau).mobility == 22 - 13  # checks the state to 1e-6
    assert abs(state.q[6] - state.q[7]) < 1e-9 and abs(state.qd[6] - state.qd[7]) < 1e-9
    np.testing.assert_array_equal(hf.close(p.chain, opened, hold_object=True).object_pose, opened.object_pose)
    with pytest.raises(MethodNotApplicable, match="posture"):
        hf.close(p.chain, opened, posture=hf.dynamics.Posture(opened.q))
    arm = p.chain.arms["arm1"]
    short = arm.of([replace(joint, position_limits=(5.0, 6.0)) for joint in arm.joints])
    with pytest.raises(hf.errors.ClosureError, match="'arm1/joint1': closed only at"):
        hf.close(replace(p.chain, arms={**p.chain.arms, "arm1": short}), opened)


def test_states_are_checked():
    """Open grasps and couplings, torques of passive joints, wrong shapes and methods are refused with what to try."""
    chain, state, tau = two_arms_with_grippers()
    opened = state.q.copy()
    opened[15] += 1e-3
    with pytest.raises(
        StateError, match=r"coupling of 'arm2/finger1' and 'arm2/finger2': position gap -0\.001, rate 0"
    ):
        hf.forward_dynamics(chain, replace(state, q=opened), tau)
    with pytest.raises(StateError, match=r"grasp 'arm1/link6': position gap"):
        hf.forward_dynamics(chain, replace(state, object_pose=hf.Pose.identity()), tau)
    with pytest.raises(StateError, match=r"q: expected 16 joint positions"):
        hf.forward_dynamics(chain, hf.State(np.zeros(7), np.zeros(7), state.object_pose), tau)
    with pytest.raises(MethodNotApplicable, match="rccfd1: for serial arms that hold one object"):
        hf.forward_dynamics(chain, state, tau, method="rccfd1")
    with pytest.raises(MethodNotApplicable, match="generic_rank"):
        hf.forward_dynamics(chain, state, tau, generic_rank=3)
    arm = chain.arms["arm1"]
    idle = [replace(joint, actuated=joint.name not in FINGERS) for joint in arm.joints]
    passive = replace(chain, arms={**chain.arms, "arm1": arm.of(idle)})
    with pytest.raises(StateError, match="'arm1/finger1' is passive; expected 0"):
        hf.forward_dynamics(passive, state, tau)
    with pytest.raises(StateError, match="object_pose: expected shape"):
        hf.forward_dynamics(replace(chain, objects={"lid": STRAY}), state, tau)
