"""The regressor: it gives the torques and wrenches of the dynamics, and its zeros are where the structure says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import inertial_parameters
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.inverse import TrunkTorques, trunk_torques
from holdfast.model.link import Link
from tests.systems import random_system
from tests.systems.as_chain import Problem, as_chain
from tests.systems.sprung import with_springs
from tests.systems.trunk_problems import random_body, random_on_trunk


def problems() -> list[Problem]:
    """Return chains with moving bases, armature, damping and wrenches; one with an arm that holds nothing."""
    every = [as_chain(random_system(seed, arms=2, moving_base=True)) for seed in range(3)]
    return [*every, as_chain(random_system(7, arms=3, joints=[4, 7, 6], grasps=["rigid", "hinge", None]))]


@pytest.mark.parametrize("k", range(4))
def test_the_equations(k):
    """Y pi is what forward and inverse dynamics say: object wrenches, and torques less those of the grasp forces."""
    p = problems()[k]
    found = p.solved()
    Y = hf.regressor(p.chain, p.state, found.qdd, found.object_acceleration, inputs=p.inputs)
    A = [hf.dynamics.tip_pose(p.chain.arms[name], p.state.q[p.chain.joints[name]]) for name in p.chain.names]
    net = Y.object_wrench.copy()
    for at, f in zip(A, found.grasp_wrench, strict=True):
        net += np.concatenate([f[:3] + np.cross(at.p - p.state.object_frame.p, f[3:]), f[3:]])
    size = np.abs(found.grasp_wrench).max()
    assert np.abs(Y.object @ inertial_parameters(p.chain.held_object) - net).max() < 1e-9 * size
    no_forces = np.zeros_like(found.grasp_wrench)
    torques = hf.inverse_dynamics(p.chain, p.state, found.qdd, no_forces, p.inputs)
    assert np.abs(Y.joint_torques(p.chain) - torques).max() < 1e-12 * np.abs(torques).max()


def test_other_bodies():
    """The same matrices hold for other links and another object: none of their inertias is in them."""
    p = problems()[3]
    rng = np.random.default_rng(0)

    def another(link: Link) -> Link:
        root = rng.normal(size=(3, 3))
        return Link(rng.uniform(1, 3), rng.normal(size=3), np.trace(root @ root.T) * np.eye(3) - root @ root.T)

    def replaced(arm: hf.Arm) -> hf.Arm:
        return hf.Arm(arm.joints, [another(link) for link in arm.links], arm.tip, arm.base)

    arms = {name: replaced(arm) for name, arm in p.chain.arms.items()}
    other = hf.ClosedChain(arms, p.chain.held_object, p.chain.grasps, p.chain.gravity)
    qdd, alpha = rng.normal(size=p.chain.joint_count), rng.normal(size=6)
    Y, same = (hf.regressor(chain, p.state, qdd, alpha, inputs=p.inputs) for chain in (p.chain, other))
    torques = hf.inverse_dynamics(other, p.state, qdd, np.zeros((3, 6)), p.inputs)
    assert np.abs(Y.joint_torques(other) - torques).max() < 1e-12 * np.abs(torques).max()
    assert all(np.array_equal(Y.links[name], same.links[name]) for name in Y.links)


def test_zeros_inward():
    """What is outside a joint loads it; what is inside does not."""
    p = problems()[0]
    Y = hf.regressor(p.chain, p.state, np.ones(p.chain.joint_count), np.ones(6))
    for of_arm in Y.links.values():
        for j, k in np.ndindex(of_arm.shape[:2]):
            assert j <= k or not of_arm[j, k].any()
        assert all(of_arm[k, k].any() for k in range(len(of_arm)))


def test_change_of_solution():
    """dz/dpi = -K^-1 Y: the accelerations' derivative by the object's mass, taken by forward dynamics' own gradient."""
    p = problems()[3]
    found = p.solved()
    body = p.chain.held_object
    Y = hf.regressor(p.chain, p.state, found.qdd, found.object_acceleration, inputs=p.inputs)
    c = body.com  # by the mass, mass centre and inertia about it held: h and I_O change too
    by_mass = np.concatenate([[1.0], c, (c @ c * np.eye(3) - np.outer(c, c))[np.triu_indices(3)]])
    P = hf.dynamics.object_mobility(p.chain, p.state)
    wanted = hf.forward_dynamics_vjp(
        p.chain, p.state, p.tau, object_acceleration=np.eye(6)[4], by=["object_mass"], inputs=p.inputs
    ).object_mass
    assert -(P @ (Y.object @ by_mass))[4] == pytest.approx(float(wanted), rel=1e-9)


def test_springs_count_as_known():
    """A spring's pull is in the known wrench of the object, or in what the drives bear."""
    p = problems()[0]
    chain, qdd = with_springs(p.chain), 0 * p.state.q
    Y = hf.regressor(chain, p.state, qdd, np.zeros(6), inputs=p.inputs)
    without = hf.regressor(p.chain, p.state, qdd, np.zeros(6), inputs=p.inputs)
    torques = hf.inverse_dynamics(chain, p.state, qdd, np.zeros((len(chain.arms), 6)), p.inputs)
    assert np.abs(Y.joint_torques(chain) - torques).max() < 1e-12 * np.abs(torques).max()
    assert np.abs(Y.object_wrench - without.object_wrench).max() > 1.0


def needed(chain: hf.ClosedChain, p: Problem, qdd: np.ndarray, base: np.ndarray | None) -> TrunkTorques:
    """Return what a chain on a trunk asks for without grasp forces."""
    motion = chain_motion(chain, p.state, np.zeros(chain.joint_count), p.inputs.shaped(chain))
    return trunk_torques(motion, qdd, np.zeros((len(chain.arms), 6)), base)


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_chains_on_trunks(seed, floating):
    """Torques, and what a floating base needs, are those of inverse dynamics; for other bodies too."""
    p, random = random_on_trunk(seed, 3, floating=floating), np.random.default_rng(seed)
    p = replace(p, chain=with_springs(p.chain)) if seed else p
    chain, n = p.chain, p.chain.joint_count
    qdd, base = random.normal(size=n), random.normal(size=6) if floating else None
    trunk = replace(
        chain.trunk,
        links=[replace(random_body(random), name=link.name) for link in chain.trunk.links],
        floating=random_body(random) if floating else None,
    )
    Y = hf.regressor(chain, p.state, qdd, random.normal(size=6), inputs=p.inputs, base_acceleration=base)
    assert set(Y.under) == set(chain.mounts)
    assert set(Y.base) == ({"trunk", *chain.mounts} if floating else set())
    assert Y.links["trunk"].shape == (3, len(trunk.bodies), 10)
    for one in (chain, replace(chain, trunk=trunk)):
        expected = needed(one, p, qdd, base)
        assert np.abs(Y.joint_torques(one) - expected.tau).max() < 1e-12 * np.abs(expected.tau).max()
        if floating:
            assert np.abs(Y.wrench_under(one) - expected.base).max() < 1e-12 * np.abs(expected.base).max()


def test_a_floating_base_needs_nothing():
    """With the wrenches of the grasps all that it bears adds up to zero, as forward dynamics moves it."""
    p = random_on_trunk(1, 2, floating=True)
    found, chain = p.solved(), p.chain
    own = {"inputs": p.inputs, "base_acceleration": found.base_acceleration}
    Y = hf.regressor(chain, p.state, found.qdd, found.object_acceleration, **own)
    motion = chain_motion(chain, p.state, p.tau, p.inputs.shaped(chain))
    left = Y.wrench_under(chain)
    for name, f in zip(chain.names, found.grasp_wrench, strict=True):
        if name in chain.mounts:
            lever = motion.arms[name].at.tip.p - p.state.base_frame.p
            left = left + np.concatenate([f[:3] + np.cross(lever, f[3:]), f[3:]])
    assert np.abs(left).max() < 1e-10 * np.abs(Y.wrench_under(chain)).max()
    with pytest.raises(hf.errors.StateError, match="base_acceleration: expected the acceleration of the floating base"):
        hf.regressor(chain, p.state, found.qdd, found.object_acceleration)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"qdd": np.zeros(3)}, "qdd: expected shape"),
        ({"object_acceleration": [np.nan] * 6}, "object_acceleration: expected finite"),
        ({"state": None}, "state: expected State"),
        ({"chain": 3}, "chain: expected ClosedChain"),
    ],
)
def test_refusals(changed, said):
    """Each by name."""
    p = problems()[0]
    given = {"chain": p.chain, "state": p.state, "qdd": 0 * p.state.q, "object_acceleration": np.zeros(6)} | changed
    with pytest.raises(hf.HoldfastError, match=said):
        hf.regressor(**given)
