"""What users ask of one arm, and of the joints of all: poses, Jacobian, mass matrix; where the object is (2.8)."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import state_from_joints
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.robots import iiwa14, panda
from holdfast.spatial import rotation
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain
from tests.systems.problems import CASES, random_problem, stored

PUSHED = as_chain(well_conditioned_system(3, arms=1, joints=6, grasps="rigid", extras=True)).chain.arms["arm1"]
ARMS = {"panda": panda(), "iiwa14": iiwa14(), "random, with strokes": PUSHED}
arms = pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)


@arms
def test_jacobian_is_the_slope_of_the_pose(arm):
    """Central differences of the tip's pose are the Jacobian's columns."""
    q, h = np.random.default_rng(0).uniform(-1, 1, arm.joint_count), 1e-5
    J = hf.dynamics.tip_jacobian(arm, q)
    for k, step in enumerate(h * np.eye(arm.joint_count)):
        ahead, behind = hf.dynamics.tip_pose(arm, q + step), hf.dynamics.tip_pose(arm, q - step)
        turn = rotation.log(ahead.R @ behind.R.T)
        assert np.concatenate([turn, ahead.p - behind.p]) / (2 * h) == pytest.approx(J[:, k], abs=1e-8)


@arms
def test_links_lead_to_the_tip(arm):
    """Each link hangs on the one before by its joint, the tip on the last link."""
    q = np.random.default_rng(1).uniform(-1, 1, arm.joint_count)
    before = arm.base
    for joint, qk, link in zip(arm.joints, q, hf.dynamics.link_poses(arm, q), strict=True):
        hung = (before @ joint.placement).inverse() @ link
        moved = [rotation.log(hung.R), hung.p] if joint.kind == "revolute" else [hung.p, rotation.log(hung.R)]
        assert moved[0] == pytest.approx(qk * joint.axis, abs=1e-12)
        assert moved[1] == pytest.approx(np.zeros(3), abs=1e-12)
        before = link
    assert (before @ arm.tip).wxyz_xyz == pytest.approx(hf.dynamics.tip_pose(arm, q).wxyz_xyz, abs=1e-12)


@arms
def test_mass_matrix_is_the_kinetic_energy(arm):
    """1/2 qd^T M qd is the energy of links and rotors, summed body by body."""
    rng = np.random.default_rng(2)
    q, qd = rng.uniform(-1, 1, (2, arm.joint_count))
    M = hf.dynamics.joint_mass_matrix(arm, q)
    chain = hf.ClosedChain({"arm": arm}, hf.HeldObject.box(1.0, 0.1, 0.1, 0.1), {})
    energy = hf.dynamics.kinetic_energy(chain, hf.State(q, qd, [1, 0, 0, 0, 0, 0, 0]))
    assert 0.5 * qd @ M @ qd == pytest.approx(energy, rel=1e-13)
    assert np.array_equal(M, M.T)
    assert np.linalg.eigvalsh(M)[0] > 0


@pytest.mark.parametrize(
    "ask", [hf.dynamics.tip_pose, hf.dynamics.link_poses, hf.dynamics.tip_jacobian, hf.dynamics.joint_mass_matrix]
)
@pytest.mark.parametrize(("q", "message"), [([0.1], r"q: expected shape \(7,\)"), ([np.nan] * 7, "q: expected finite")])
def test_refusals(ask, q, message):
    """Positions of a wrong number, or none."""
    with pytest.raises(hf.errors.StateError, match=message):
        ask(panda(), q)


RIGID = [name for name, case in CASES.items() if case["tags"]["all_rigid"]]


@pytest.mark.parametrize("name", RIGID)
def test_stored_states(name):
    """Pose and twist of the object in every stored case with rigid grasps."""
    p = stored(name)
    found = state_from_joints(p.chain, p.state.q, p.state.qd, inputs=p.inputs)
    np.testing.assert_allclose(found.object_frame.R, p.state.object_frame.R, atol=1e-11)
    np.testing.assert_allclose(found.object_pose[4:], p.state.object_pose[4:], atol=1e-11)
    np.testing.assert_allclose(found.object_twist, p.state.object_twist, atol=1e-10)
    np.testing.assert_array_equal(found.q, p.state.q)
    np.testing.assert_array_equal(found.qd, p.state.qd)


def test_other_arms_do_not_count():
    """Only arms that hold count; the first one's tip gives the pose."""
    p = random_problem(2, grasps="rigid", joints=(7, 6, 8))
    opened = p.chain.without_grasp("arm1")
    q = p.state.q + 0.7 * (np.arange(21) < 7)
    found = state_from_joints(opened, q, p.state.qd, inputs=p.inputs)
    np.testing.assert_allclose(found.object_pose, p.state.object_pose, atol=1e-12)


def test_least_squares_twist():
    """Joint rates that tear at the object: V(C) = (A^T A)^-1 A^T V(0), if the check is waived."""
    p = stored("rigid_2arm_7R_gravity")
    qd = p.state.qd + 0.1 * np.eye(14)[3]
    with pytest.raises(StateError, match="arm 'arm1'"):
        state_from_joints(p.chain, p.state.q, qd)
    found = state_from_joints(p.chain, p.state.q, qd, check=False)
    shift = found.object_twist - p.state.object_twist
    assert 1e-4 < np.abs(shift).max() < 0.1
    with pytest.raises(StateError, match="arm 'arm2': position gap"):
        state_from_joints(p.chain, p.state.q + 0.1 * np.eye(14)[10], p.state.qd)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hinge_2arm", r"but 'arm1' is a hinge grasp; 'arm2' is a hinge grasp; give the object's pose"),
        ("mixed_4arm_all_types", r"but 'arm2' is a hinge grasp; 'arm3' is a ball grasp; 'arm4' is a softfinger grasp"),
    ],
)
def test_other_grasps(name, message):
    """Grasps with freedom leave the object's pose open: refused by name."""
    p = stored(name)
    with pytest.raises(MethodNotApplicable, match=message):
        state_from_joints(p.chain, p.state.q, p.state.qd)


def test_nobody_holds():
    """Without grasps nothing is known of the object."""
    p = stored("rigid_1arm_6R")
    with pytest.raises(MethodNotApplicable, match="needs rigid grasps, but there is none"):
        state_from_joints(p.chain.without_grasp("arm1"), p.state.q, p.state.qd)


@pytest.mark.parametrize(("q", "qd"), [(5, 6), (6, 5), (7, 7)])
def test_lengths(q, qd):
    """Wrong lengths are refused."""
    with pytest.raises(StateError, match="expected"):
        state_from_joints(stored("rigid_1arm_6R").chain, np.zeros(q), np.zeros(qd))
