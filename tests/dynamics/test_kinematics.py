"""What users ask of one arm: where it is, its Jacobian, its mass matrix."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.robots import iiwa14, panda
from holdfast.spatial import rotation
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain

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
    with pytest.raises(hf.StateError, match=message):
        ask(panda(), q)
