"""Back onto the constraint by the smallest change in the kinetic metric."""

import numpy as np
import pytest

from holdfast import ClosureError, State, closure, project
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.stacked import Stacked, block_diagonal
from holdfast.dynamics.constraint import constraint_rows
from holdfast.dynamics.object_level import motion_basis
from holdfast.dynamics.projection import constraint_impulses, moved, project_velocities
from holdfast.spatial import rotation
from tests.dynamics.problems import motion_of, random_problem, relative_gap, stored

OPTIONS = {"grasps": ("rigid", "hinge", "softfinger", "ball"), "joints": (7, 6, 7, 6), "moving_base": True}
seeds = pytest.mark.parametrize("seed", range(5))


def nudged(p, seed: int, size: float) -> State:
    """Return the state with positions and velocities off by about `size`."""
    rng, n = np.random.default_rng(seed), p.chain.joint_count
    there = moved(p.state, size * rng.normal(size=n), size * rng.normal(size=6))
    qd, twist = p.state.qd + size * rng.normal(size=n), p.state.object_twist + size * rng.normal(size=6)
    return State(there.q, qd, there.object_pose, twist)


def kinetic_metric(motion) -> np.ndarray:
    """Return diag(M, M(C)) over (qd, V(C))."""
    s = Stacked(motion)
    return block_diagonal([s.M, s.M_C])


@seeds
@pytest.mark.parametrize("size", [1e-8, 1e-5, 1e-3])
def test_closes(seed, size):
    """A state off by a step's error comes back: positions to 1e-13, velocities to 1e-12."""
    p = random_problem(seed, **OPTIONS)
    off = nudged(p, seed, size)
    found, motion = project(p.chain, off, p.inputs)
    for gap in closure(p.chain, found, p.inputs).values():
        assert np.abs(gap.position).max() < 1e-13
        assert np.abs(gap.velocity).max() < 1e-12
    assert np.abs(found.q - off.q).max() < 100 * size
    np.testing.assert_array_equal(motion.arms["arm1"].tip_twist, _motion_at(p, found).arms["arm1"].tip_twist)


def _motion_at(p, state):
    return chain_motion(p.chain, state, np.zeros(p.chain.joint_count), p.inputs.shaped(p.chain))


@seeds
def test_a_closed_state_stays(seed):
    """A closed state comes back to rounding."""
    p = random_problem(seed, **OPTIONS)
    found, _ = project(p.chain, p.state, p.inputs)
    for key in ("q", "qd", "object_pose", "object_twist"):
        np.testing.assert_allclose(getattr(found, key), getattr(p.state, key), atol=1e-12)


@seeds
def test_velocity_change_is_smallest(seed):
    """The velocity change is orthogonal, in the kinetic metric, to every allowed velocity: Gauss."""
    p = random_problem(seed, **OPTIONS)
    rough = nudged(p, seed, 0.0)
    rng = np.random.default_rng(seed)
    rough = State(rough.q, rng.normal(size=p.chain.joint_count), rough.object_pose, rng.normal(size=6))
    motion = _motion_at(p, rough)
    found = project_velocities(motion, rough)
    change = np.r_[found.qd - rough.qd, found.object_twist - rough.object_twist]
    along = kinetic_metric(motion) @ motion_basis(p.chain, p.state)
    assert np.abs(change @ along).max() < 1e-11 * np.abs(along).max() * np.abs(change).max()


@seeds
def test_position_change_is_smallest(seed):
    """So is the position change, on the position rows: a soft finger's spin is free to follow."""
    p = random_problem(seed, **OPTIONS)
    n, size = p.chain.joint_count, 1e-7
    rng = np.random.default_rng(seed)
    dq, dx = size * rng.normal(size=n), size * rng.normal(size=6)
    off = moved(p.state, dq, dx)
    found, motion = project(p.chain, off, p.inputs)
    turn = rotation.log(found.object_frame.R @ off.object_frame.R.T)
    change = np.r_[found.q - off.q, turn, found.object_pose[4:] - off.object_pose[4:]]
    rows = constraint_rows(motion)
    spin = rows.slices[2].start
    assert p.chain.grasps["arm3"].kind == "softfinger"
    held = np.delete(np.hstack([rows.joints, rows.object]), spin, axis=0)
    _, sizes, Vt = np.linalg.svd(held)
    along = kinetic_metric(motion) @ Vt[int((sizes > 1e-10 * sizes[0]).sum()) :].T
    assert np.abs(change @ along).max() < 1e-4 * np.abs(along).max() * np.abs(change).max()


@seeds
def test_impulses(seed):
    """K Omega K^T p = K v, dqd = -M^-1 J^T p, dV(C) = M(C)^-1 A^T p, solved densely."""
    p = random_problem(seed, **OPTIONS)
    motion = motion_of(p)
    s = Stacked(motion)
    mismatch = list(np.random.default_rng(seed).normal(size=(4, 6)))
    dqd, dV, impulses = constraint_impulses(motion, motion.contacts, mismatch)
    omega = s.J @ s.mass_solve(s.J.T) + s.A @ s.M_C_inverse @ s.A.T
    lam = np.linalg.solve(s.K @ omega @ s.K.T, s.K @ np.concatenate(mismatch))
    expected = s.K.T @ lam
    assert relative_gap(np.concatenate(impulses), expected) < 1e-9
    assert relative_gap(dqd, -s.mass_solve(s.J.T @ expected)) < 1e-9
    assert relative_gap(dV, s.M_C_inverse @ s.A.T @ expected) < 1e-9


@pytest.mark.parametrize("size", [0.011, 0.5])
def test_too_far(size):
    """A state further off than a sound step's error is refused with its gap."""
    p = stored("rigid_2arm_7R_gravity")
    off = moved(p.state, np.zeros(14), np.r_[np.zeros(3), size, 0, 0])
    with pytest.raises(ClosureError, match=r"the grasps are open by 0\.(011|5) \(m or rad\).*smaller time step"):
        project(p.chain, off)


def test_spin_of_a_soft_finger_stays():
    """A soft finger's spin about the normal is no position row: it is kept, not taken back."""
    p = stored("softfinger_2arm")
    tips = {}
    for name, arm in p.chain.arms.items():
        tips[name] = arm.with_tip(type(arm.tip)(arm.tip.R @ rotation.exp(np.array([0.0, 0.0, 0.4])), arm.tip.p))
    chain = type(p.chain)(tips, p.chain.held_object, p.chain.grasps, p.chain.gravity)
    found, _ = project(chain, p.state)
    np.testing.assert_allclose(found.q, p.state.q, atol=1e-12)
    np.testing.assert_allclose(found.object_pose, p.state.object_pose, atol=1e-12)


@seeds
def test_moved(seed):
    """Displacements add up: turns compose on the left about C, the quaternion stays of unit length."""
    p = random_problem(seed, **OPTIONS)
    rng = np.random.default_rng(seed)
    dq, dx = rng.normal(size=p.chain.joint_count), rng.normal(size=6)
    there = moved(p.state, dq, dx)
    np.testing.assert_allclose(there.object_frame.R, rotation.exp(dx[:3]) @ p.state.object_frame.R, atol=1e-14)
    np.testing.assert_array_equal(there.object_pose[4:], p.state.object_pose[4:] + dx[3:])
    np.testing.assert_array_equal(there.q, p.state.q + dq)
    back = moved(there, -dq, -dx)
    np.testing.assert_allclose(np.abs(back.object_pose), np.abs(p.state.object_pose), atol=1e-14)
