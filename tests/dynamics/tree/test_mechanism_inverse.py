"""Inverse dynamics of chains with branches, loops, couplings and several objects, in their own terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import StateError
from tests.dynamics.tree.as_branched import gap, serial_problems, with_stray
from tests.systems.branched import FINGERS, branched_problems, palletiser, two_arms_with_grippers


def accelerations(result: hf.dynamics.MechanismResult) -> dict:
    """Return what inverse dynamics takes of a result."""
    of_objects = result.object_acceleration if result.chain.free_objects else None
    return {
        "qdd": result.qdd,
        "object_acceleration": of_objects,
        "base_acceleration": result.base_acceleration,
    }


def carried(chain: hf.ClosedChain, found) -> np.ndarray:
    """Return the torques of drives and couplings together."""
    total, names = np.array(found.tau), chain.joint_names()
    at = {name: k + 2 * (names[0] == "trunk/waist" and k > 1) for k, name in enumerate(names)}
    for coupling, force in zip(chain.all_couplings, found.coupling_force, strict=True):
        for name, c in coupling.terms.items():
            total[at[name]] += c * force
    return total


@pytest.mark.parametrize("name", branched_problems())
def test_forward_dynamics_is_its_inverse(name):
    """With the wrenches of forward dynamics its torques come back; without them others of the same motion."""
    p = branched_problems()[name]
    result = hf.forward_dynamics(*p)
    found = hf.inverse_dynamics(p.chain, p.state, grasp_wrench=result.grasp_wrench, **accelerations(result))
    given = replace(found, tau=p.tau, coupling_force=result.coupling_force)
    assert gap(found.grasp_wrench, result.grasp_wrench) < 1e-10
    assert gap(carried(p.chain, found), carried(p.chain, given)) < 1e-10
    loose = hf.inverse_dynamics(p.chain, p.state, **accelerations(result))
    again = hf.forward_dynamics(p.chain, p.state, loose.tau)
    assert gap(again.qdd, result.qdd) < 1e-10
    assert gap(again.object_acceleration, result.object_acceleration) < 1e-10
    assert np.linalg.norm(loose.grasp_wrench) <= np.linalg.norm(result.grasp_wrench) * 2.0


@pytest.mark.parametrize("name", serial_problems())
def test_as_serial_chains(name):
    """An object that falls beside it makes a chain a forest; the torques are those of the serial chain."""
    p = serial_problems()[name]
    result = p.solved(check=False)
    base = result.base_acceleration
    wanted = hf.inverse_dynamics(p.chain, p.state, result.qdd, result.grasp_wrench, p.inputs, base)
    chain, state, tau, inputs = with_stray(p)
    there = hf.forward_dynamics(chain, state, tau, inputs=inputs, check=False)
    found = hf.inverse_dynamics(
        chain, state, result.qdd, there.grasp_wrench, inputs, base, object_acceleration=there.object_acceleration
    )
    assert gap(found.tau, wanted) < 1e-10
    assert gap(wanted, tau) < 1e-10


def test_a_passive_finger():
    """A mimic finger without a drive hangs on the coupling: torques come back as they were."""
    p = branched_problems()["grippers"]
    arms = {
        name: arm.of([replace(joint, actuated=joint.name != FINGERS[1]) for joint in arm.joints])
        for name, arm in p.chain.arms.items()
    }
    chain, tau = replace(p.chain, arms=arms), np.array(p.tau)
    tau[[7, 15]] = 0.0
    result = hf.forward_dynamics(chain, p.state, tau)
    found = hf.inverse_dynamics(chain, p.state, grasp_wrench=result.grasp_wrench, **accelerations(result))
    assert gap(found.tau, tau) < 1e-10
    assert gap(found.coupling_force, result.coupling_force) < 1e-10
    assert found.wrenches["arm1", "pad1"] == pytest.approx(result["arm1", "pad1"], abs=1e-10)


def test_a_palletiser_at_rest():
    """Its torques are the slopes of its potential energy along the motions that the parallelogram allows."""
    chain, state, _ = palletiser()
    found = hf.inverse_dynamics(chain, state.at_rest(), np.zeros(4)).tau

    def energy(shift):
        q = state.q + np.array([0.0, shift, -shift, shift])
        return hf.dynamics.forest_balance(chain.forest, q, np.zeros(4)).potential_energy

    assert found == pytest.approx([0.0, (energy(1e-4) - energy(-1e-4)) / 2e-4, 0.0, 0.0], abs=1e-5)


@pytest.mark.parametrize("rate", [[0.0, 0.0, 0.0, 0.4, -0.2, 0.3], [0.0, 0.0, 0.7, 0.0, 0.0, 0.0]])
def test_a_base_that_moves(rate):
    """A loop within an arm moves with its base: as on a base at rest, but for a turn about the vertical."""
    p = palletiser()
    loop = p.chain.arms["robot"].loops["level"]
    turning = rate[2]
    inputs = hf.Inputs(base_twists=[rate])
    grounded = replace(p.chain.arms["robot"], loops={"level": loop, "stop": free_loop()})
    chain = hf.ClosedChain({"robot": grounded})
    found = hf.forward_dynamics(chain, replace(p.state, qd=p.state.qd - np.eye(4)[0] * turning), p.tau, inputs=inputs)
    shifted = np.array(p.tau)
    shifted[0] += chain.arms["robot"].joints[0].damping * turning
    wanted = hf.forward_dynamics(p.chain, p.state, shifted)
    assert gap(found.qdd, wanted.qdd) < 1e-11


def free_loop() -> hf.Closure:
    """Return a closure between the base and the pillar that lets it turn: a hinge where the joint is."""
    turn = hf.Pose.from_rpy(0.0, -np.pi / 2, 0.0).R
    return hf.Closure(None, "pillar", hf.Grasp("hinge", hf.Pose(turn, np.zeros(3))), hf.Pose(turn, [0.0, 0.0, 0.2]))


def test_refusals():
    """What is missing, what no grasp transmits, and what nothing carries is named."""
    chain, state, _ = two_arms_with_grippers()
    zero = np.zeros(16)
    with pytest.raises(StateError, match=r"object_acceleration: expected numbers of shape \(6,\), got None"):
        hf.inverse_dynamics(chain, state, zero)
    wrench = np.zeros((3, 6))
    wrench[1] = [0.1, 0.0, 0.0, 1.0, 0.0, 0.0]
    with pytest.raises(StateError, match=r"grasp 'arm1/pad1': expected one that a ball grasp transmits"):
        hf.inverse_dynamics(chain, state, zero, wrench, object_acceleration=np.zeros(6))
    with pytest.raises(StateError, match=r"do not satisfy the forest: grasp 'arm1/link6'"):
        hf.inverse_dynamics(chain, state, zero, object_acceleration=np.ones(6))
    with pytest.raises(StateError, match="base_acceleration: expected none"):
        hf.inverse_dynamics(chain, state, zero, base_acceleration=np.ones(6), object_acceleration=np.zeros(6))
    p = serial_problems()["anchors"]
    with pytest.raises(StateError, match="object_acceleration: expected none"):
        hf.inverse_dynamics(p.chain, p.state, 0 * p.tau, object_acceleration=np.ones(6))
