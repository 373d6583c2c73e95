"""Back onto the constraint: closed from nearby, within limits, or refused by name; projected by the smallest change."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Arm, ClosedChain, Grasp, Pose, State, close, project
from holdfast.dynamics import closure, project_velocity
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.stacked import Stacked, block_diagonal
from holdfast.dynamics.constraint import constraint_rows, coordinate_sizes
from holdfast.dynamics.object_level import motion_basis
from holdfast.dynamics.projection import moved, project_velocities
from holdfast.errors import ClosureError
from holdfast.spatial import rotation
from tests.model.parts import BOX, arm
from tests.systems.problems import STATE, largest_gaps, random_problem, stored

KINDS = {
    "rigid": {"grasps": "rigid", "joints": (7, 6, 8)},
    "mixed": {"grasps": ("rigid", "hinge", "softfinger", "ball"), "joints": (7, 6, 7, 6)},
    "fingers": {"grasps": ("softfinger", "hinge"), "joints": (7, 7)},
}
systems = pytest.mark.parametrize(("kind", "seed"), [(kind, seed) for kind in KINDS for seed in range(3)])


def perturbed(p, seed: int, size: float = 0.3) -> State:
    """Return the state with joints and object displaced, 0.3 rad and m by default."""
    d = np.random.default_rng(seed).uniform(-size, size, p.chain.joint_count + 6)
    return moved(p.state, d)


@systems
def test_closes_from_nearby(kind, seed):
    """From 0.3 rad off the chains close to 1e-12, not far from the guess, velocities included."""
    p = random_problem(seed, moving_base=True, **KINDS[kind])
    guess = perturbed(p, seed)
    before = largest_gaps(closure(p.chain, guess, p.inputs))
    found = close(p.chain, guess, inputs=p.inputs)
    assert before[0] > 0.1
    assert max(largest_gaps(closure(p.chain, found, p.inputs))) < 1e-12
    assert np.linalg.norm(found.q - guess.q) < 3 * 0.3 * np.sqrt(p.chain.joint_count)


@systems
def test_object_is_held(kind, seed):
    """With hold_object the arms come to the object: pose and twist stay to the last bit."""
    p = random_problem(seed, **KINDS[kind])
    off = np.random.default_rng(seed).uniform(-0.05, 0.05, p.chain.joint_count)
    guess = State(p.state.q + off, p.state.qd, p.state.object_pose, p.state.object_twist)
    found = close(p.chain, guess, hold_object=True, inputs=p.inputs)
    np.testing.assert_array_equal(found.object_pose, guess.object_pose)
    np.testing.assert_array_equal(found.object_twist, guess.object_twist)
    assert max(largest_gaps(closure(p.chain, found, p.inputs))) < 1e-12


def test_a_closed_state_stays():
    """Closing a closed state changes nothing beyond rounding."""
    p = stored("mixed_4arm_all_types")
    found = close(p.chain, p.state)
    for key in STATE:
        np.testing.assert_allclose(getattr(found, key), getattr(p.state, key), atol=1e-12)


def limited(chain: ClosedChain, q, room: float) -> ClosedChain:
    """Return the chain with position limits about q."""
    arms = {}
    for name, old in chain.arms.items():
        around = q[chain.joints[name]]
        joints = [replace(j, position_limits=(x - room, x + room)) for j, x in zip(old.joints, around, strict=True)]
        arms[name] = replace(old, joints=joints)
    return replace(chain, arms=arms)


@pytest.mark.parametrize("room", [0.02, 0.1])
@systems
def test_narrow_limits(kind, seed, room):
    """Joints stay within their limits; those that stand at one are left out of the step: the others still close."""
    p = random_problem(seed, **KINDS[kind])
    off = 0.9 * room * np.random.default_rng(seed).uniform(-1, 1, p.chain.joint_count)
    chain = limited(p.chain, p.state.q + off, room)  # a closed state lies within, near some limits
    guess = perturbed(p, seed)
    found, free = (close(chain, guess, limits=limits, inputs=p.inputs) for limits in (True, False))
    low, high = np.concatenate([a.position_limits for a in chain.arms.values()]).T
    assert ((guess.q < low) | (guess.q > high)).any()  # starts outside for some joints
    assert ((low <= found.q) & (found.q <= high)).all()
    assert ((free.q < low) | (free.q > high)).any()
    for state in (found, free):
        assert max(largest_gaps(closure(chain, state, p.inputs))) < 1e-12


def test_limits_can_forbid():
    """Where no position within the limits closes the chains, that is an error."""
    p = stored("rigid_2arm_7R_gravity")
    chain = limited(p.chain, p.state.q + 0.5, 0.1)
    with pytest.raises(ClosureError, match=r"cannot close the chains: .* misses its grasp by .* wider joint limits"):
        close(chain, p.state, hold_object=True)
    close(chain, p.state, limits=False)


@pytest.mark.parametrize("distance", [1.5, 3.0, 20.0])
def test_who_cannot_reach(distance):
    """Two planar arms of 1 m reach for a ball grasp each: only the one too far is named, and by how much."""
    bases = {"near": [1, 0, 0, 0, 0.6, 0, 0], "far": [1, 0, 0, 0, distance, 0, 0]}
    arms = {name: arm().at(base).with_tip(Pose.translation(0.5, 0, 0)) for name, base in bases.items()}
    chain = ClosedChain(arms, BOX, {"near": Grasp("ball"), "far": Grasp("ball")})
    guess = State([2.5, 0.5, 2.5, 0.5], np.zeros(4), Pose.identity())
    with pytest.raises(ClosureError, match=r"arm 'far' misses its grasp by [\d.]+ \(m or rad\)") as caught:
        close(chain, guess, hold_object=True)
    message = str(caught.value)
    assert "near" not in message
    missed = float(message.split("misses its grasp by ")[1].split()[0])
    assert missed == pytest.approx(distance - 1.0, rel=2e-2)


def test_nobody_holds():
    """Without grasps any state is closed."""
    chain = ClosedChain({"left": Arm(arm().joints, arm().links)}, BOX, {})
    guess = State([0.3, 0.4], [1.0, 2.0], Pose.translation(5, 5, 5), np.arange(6.0))
    found = close(chain, guess)
    for key in STATE:
        np.testing.assert_array_equal(getattr(found, key), getattr(guess, key))


@systems
def test_nearest_velocity(kind, seed):
    """Projected velocities keep the grasps; what was taken off is orthogonal to what is allowed."""
    p = random_problem(seed, moving_base=True, **KINDS[kind])
    rng = np.random.default_rng(seed)
    rough = State(p.state.q, rng.normal(size=p.chain.joint_count), p.state.object_pose, rng.normal(size=6))
    found = project_velocity(p.chain, rough, inputs=p.inputs)
    assert largest_gaps(closure(p.chain, found, p.inputs))[1] < 1e-12
    # nearest with lengths in units of the arms' reach
    sizes = coordinate_sizes(chain_motion(p.chain, p.state, p.tau, p.inputs.shaped(p.chain)))
    change = np.r_[found.qd - rough.qd, found.object_twist - rough.object_twist]
    assert np.abs((change / sizes**2) @ motion_basis(p.chain, p.state)).max() < 1e-12
    np.testing.assert_array_equal(found.q, rough.q)
    held = project_velocity(p.chain, rough, hold_object=True, inputs=p.inputs)
    np.testing.assert_array_equal(held.object_twist, rough.object_twist)
    assert largest_gaps(closure(p.chain, held, p.inputs))[1] < 1e-12


MOVING = {"grasps": ("rigid", "hinge", "softfinger", "ball"), "joints": (7, 6, 7, 6), "moving_base": True}
seeds = pytest.mark.parametrize("seed", range(3))


def nudged(p, seed: int, size: float) -> State:
    """Return the state with positions and velocities off by about `size`."""
    rng, n = np.random.default_rng(seed), p.chain.joint_count
    there = moved(p.state, np.r_[size * rng.normal(size=n), size * rng.normal(size=6)])
    qd, twist = p.state.qd + size * rng.normal(size=n), p.state.object_twist + size * rng.normal(size=6)
    return State(there.q, qd, there.object_pose, twist)


def kinetic_metric(motion) -> np.ndarray:
    """Return diag(M, M(C)) over (qd, V(C))."""
    s = Stacked(motion)
    return block_diagonal([s.M, s.M_C])


@seeds
@pytest.mark.parametrize("size", [0.0, 1e-8, 1e-3])
def test_project_closes(seed, size):
    """A state off by a step's error comes back: positions to 1e-13, velocities to 1e-12."""
    p = random_problem(seed, **MOVING)
    off = nudged(p, seed, size)
    found, motion = project(p.chain, off, p.inputs)
    position, velocity = largest_gaps(closure(p.chain, found, p.inputs))
    assert position < 1e-13 and velocity < 1e-12
    for key in ("q",) if size else STATE:  # a closed state comes back to rounding
        assert np.abs(getattr(found, key) - getattr(off, key)).max() < max(100 * size, 1e-12)
    again = chain_motion(p.chain, found, np.zeros(p.chain.joint_count), p.inputs.shaped(p.chain))
    np.testing.assert_array_equal(motion.arms["arm1"].tip_twist, again.arms["arm1"].tip_twist)


@seeds
def test_velocity_change_is_smallest(seed):
    """The velocity change is orthogonal, in the kinetic metric, to every allowed velocity: Gauss."""
    p = random_problem(seed, **MOVING)
    rng, n = np.random.default_rng(seed), p.chain.joint_count
    rough = State(p.state.q, rng.normal(size=n), p.state.object_pose, rng.normal(size=6))
    motion = chain_motion(p.chain, rough, np.zeros(n), p.inputs.shaped(p.chain))
    found = project_velocities(motion, rough)
    change = np.r_[found.qd - rough.qd, found.object_twist - rough.object_twist]
    along = kinetic_metric(motion) @ motion_basis(p.chain, p.state)
    assert np.abs(change @ along).max() < 1e-11 * np.abs(along).max() * np.abs(change).max()


@seeds
def test_position_change_is_smallest(seed):
    """So is the position change, on the position rows: a soft finger's spin is free to follow."""
    p = random_problem(seed, **MOVING)
    n, size = p.chain.joint_count, 1e-7
    rng = np.random.default_rng(seed)
    dq, dx = size * rng.normal(size=n), size * rng.normal(size=6)
    off = moved(p.state, np.r_[dq, dx])
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


@pytest.mark.parametrize("size", [0.011, 0.5])
def test_too_far_to_project(size):
    """A state further off than a sound step's error is refused with its gap."""
    p = stored("rigid_2arm_7R_gravity")
    off = moved(p.state, np.r_[np.zeros(17), size, 0, 0])
    with pytest.raises(ClosureError, match=r"the grasps are open by 0\.(011|5) \(m or rad\).*smaller time step"):
        project(p.chain, off)


def test_spin_of_a_soft_finger_stays():
    """A soft finger's spin about the normal is no position row: it is kept, not taken back."""
    p = stored("softfinger_2arm")
    turn = Pose(rotation.exp(np.array([0.0, 0.0, 0.4])), np.zeros(3))
    arms = {name: one.with_tip(one.tip @ turn) for name, one in p.chain.arms.items()}
    chain = replace(p.chain, arms=arms)
    found, _ = project(chain, p.state)
    np.testing.assert_allclose(found.q, p.state.q, atol=1e-12)
    np.testing.assert_allclose(found.object_pose, p.state.object_pose, atol=1e-12)
