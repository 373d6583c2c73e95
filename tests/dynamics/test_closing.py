"""Closing the chains from nearby, within limits, or saying which arm cannot reach and by how much."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Arm, ClosedChain, ClosureError, Grasp, Pose, State, close, closure, project_velocity
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.object_level import motion_basis
from holdfast.dynamics.projection import moved
from tests.dynamics.problems import random_problem, stored
from tests.model.parts import BOX, arm

KINDS = {
    "rigid": {"grasps": "rigid", "joints": (7, 6, 8)},
    "mixed": {"grasps": ("rigid", "hinge", "softfinger", "ball"), "joints": (7, 6, 7, 6)},
    "fingers": {"grasps": ("softfinger", "hinge"), "joints": (7, 7)},
}
systems = pytest.mark.parametrize(("kind", "seed"), [(kind, seed) for kind in KINDS for seed in range(6)])


def largest_gap(chain: ClosedChain, state: State, inputs=None) -> tuple[float, float]:
    """Return the largest position and velocity residuals."""
    gaps = closure(chain, state, inputs).values()
    return tuple(max(np.abs(getattr(gap, part)).max() for gap in gaps) for part in ("position", "velocity"))


def perturbed(p, seed: int, size: float = 0.3) -> State:
    """Return the state with joints and object displaced, 0.3 rad and m by default."""
    d = np.random.default_rng(seed).uniform(-size, size, p.chain.joint_count + 6)
    return moved(p.state, *np.split(d, [p.chain.joint_count]))


@systems
def test_closes_from_nearby(kind, seed):
    """From 0.3 rad off the chains close to 1e-12, not far from the guess, velocities included."""
    p = random_problem(seed, moving_base=True, **KINDS[kind])
    guess = perturbed(p, seed)
    before = largest_gap(p.chain, guess, p.inputs)
    found = close(p.chain, guess, inputs=p.inputs)
    assert before[0] > 0.1
    assert max(largest_gap(p.chain, found, p.inputs)) < 1e-12
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
    assert max(largest_gap(p.chain, found, p.inputs)) < 1e-12


def test_a_closed_state_stays():
    """Closing a closed state changes nothing beyond rounding."""
    p = stored("mixed_4arm_all_types")
    found = close(p.chain, p.state)
    for key in ("q", "qd", "object_pose", "object_twist"):
        np.testing.assert_allclose(getattr(found, key), getattr(p.state, key), atol=1e-12)


def limited(chain: ClosedChain, q, room: float) -> ClosedChain:
    """Return the chain with position limits about q."""
    arms = {}
    for name, old in chain.arms.items():
        around = q[chain.joints[name]]
        joints = [replace(j, position_limits=(x - room, x + room)) for j, x in zip(old.joints, around, strict=True)]
        arms[name] = replace(old, joints=joints)
    return replace(chain, arms=arms)


@pytest.mark.parametrize("seed", range(6))
def test_limits(seed):
    """Joints stay within their limits, found states included; limits=False lets them out."""
    p = random_problem(seed, **KINDS["rigid"])
    chain = limited(p.chain, p.state.q, 0.2)
    guess = perturbed(p, seed, 0.3)  # starts outside for some joints
    low, high = np.concatenate([a.position_limits for a in chain.arms.values()]).T
    assert ((guess.q < low) | (guess.q > high)).any()
    found = close(chain, guess, inputs=p.inputs)
    assert (low <= found.q).all()
    assert (found.q <= high).all()
    assert max(largest_gap(chain, found, p.inputs)) < 1e-12
    free = close(chain, guess, limits=False, inputs=p.inputs)
    assert max(largest_gap(chain, free, p.inputs)) < 1e-12
    assert np.abs(free.q - found.q).max() > 1e-3


@pytest.mark.parametrize("room", [0.02, 0.1])
@systems
def test_narrow_limits(kind, seed, room):
    """Joints that stand at a limit are left out of the step: the others still close the chains."""
    p = random_problem(seed, **KINDS[kind])
    off = 0.9 * room * np.random.default_rng(seed).uniform(-1, 1, p.chain.joint_count)
    chain = limited(p.chain, p.state.q + off, room)  # a closed state lies within, near some limits
    found = close(chain, perturbed(p, seed), inputs=p.inputs)
    low, high = np.concatenate([a.position_limits for a in chain.arms.values()]).T
    assert ((low <= found.q) & (found.q <= high)).all()
    assert max(largest_gap(chain, found, p.inputs)) < 1e-12


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
    for key in ("q", "qd", "object_pose", "object_twist"):
        np.testing.assert_array_equal(getattr(found, key), getattr(guess, key))


@systems
def test_nearest_velocity(kind, seed):
    """Projected velocities keep the grasps; what was taken off is orthogonal to what is allowed."""
    p = random_problem(seed, moving_base=True, **KINDS[kind])
    rng = np.random.default_rng(seed)
    rough = State(p.state.q, rng.normal(size=p.chain.joint_count), p.state.object_pose, rng.normal(size=6))
    found = project_velocity(p.chain, rough, inputs=p.inputs)
    assert largest_gap(p.chain, found, p.inputs)[1] < 1e-12
    # nearest with lengths in units of the arms' reach
    sizes = coordinate_sizes(chain_motion(p.chain, p.state, p.tau, p.inputs.shaped(p.chain)))
    change = np.r_[found.qd - rough.qd, found.object_twist - rough.object_twist]
    assert np.abs((change / sizes**2) @ motion_basis(p.chain, p.state)).max() < 1e-12
    np.testing.assert_array_equal(found.q, rough.q)
    held = project_velocity(p.chain, rough, hold_object=True, inputs=p.inputs)
    np.testing.assert_array_equal(held.object_twist, rough.object_twist)
    assert largest_gap(p.chain, held, p.inputs)[1] < 1e-12
