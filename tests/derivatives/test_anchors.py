"""Anchors, arms without joints, in derivatives: what is pinned to a place that may move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from tests.derivatives.blocks import NAMES, Reference, compiled, worst_of_products
from tests.longer import mostly_long, mostly_slow
from tests.oracles.chain_derivatives import chain_derivatives
from tests.systems.anchored import pinned
from tests.systems.problems import random_problem

TOLERANCE = 1e-10
KINDS = ("rigid", "hinge", "softfinger", "ball", "universal", "slider", "cylinder", "screw", "planar")
FEW = ("q", "tau", "object_pose", "grasp_pose", "base_pose", "base_twist")


@pytest.mark.parametrize("kind", mostly_slow(KINDS, ("rigid", "ball", "planar")))
def test_the_reference(kind):
    """Two arms and an anchor, all on bases that move: products by everything, against the oracle."""
    p = pinned(random_problem(KINDS.index(kind), joints=(7, 8), moving_base=True), (kind,), KINDS.index(kind))
    random = np.random.default_rng(0)
    assert worst_of_products(Reference(p), p, chain_derivatives(p, NAMES), random) < TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize("kind", mostly_long(KINDS, ("hinge",)))
def test_machine_code(kind):
    """One arm and an anchor."""
    p = pinned(random_problem(1, arms=1, joints=7, moving_base=True), (kind,), 1)
    random = np.random.default_rng(0)
    assert worst_of_products(compiled(p), p, chain_derivatives(p, FEW), random, FEW) < TOLERANCE


def test_anchors_alone():
    """A pendulum, no joints at all: how its acceleration and the pin's wrench change with its pose and mass."""
    pose = hf.Pose(np.eye(3), np.array([0.3, 0.0, -0.4]))
    body = hf.HeldObject(mass=2.0, com=np.array([0.01, 0.02, 0.0]), inertia=np.diag([0.02, 0.03, 0.04]))
    frame = hf.Pose(np.eye(3), np.array([-0.3, 0.0, 0.4]))
    chain = hf.ClosedChain({"pin": hf.Anchor(pose @ frame)}, body, {"pin": hf.Grasp("ball", frame)})
    state = hf.State(np.zeros(0), np.zeros(0), pose.wxyz_xyz, np.zeros(6))
    step = 1e-6

    def answer(mass: float) -> hf.ForwardResult:
        heavier = hf.HeldObject(mass=mass, com=body.com, inertia=body.inertia)
        return hf.forward_dynamics(hf.ClosedChain(chain.arms, heavier, chain.grasps), state, np.zeros(0))

    there, back = answer(2.0 + step), answer(2.0 - step)
    one = hf.compile(chain).forward_dynamics_jvp(
        state.q, state.qd, np.zeros(0), state.object_pose, state.object_twist, along={"object_mass": np.array(1.0)}
    )
    own = hf.forward_dynamics_jvp(chain, state, np.zeros(0), along={"object_mass": np.array(1.0)})
    for of in ("object_acceleration", "grasp_wrench", "base_wrench"):
        slope = (getattr(there, of) - getattr(back, of)) / (2 * step)
        size = np.abs(slope).max()
        assert np.abs(own[of] - slope).max() < 1e-6 * size
        assert np.abs(one[of] - own[of]).max() < 1e-12 * size


@pytest.mark.parametrize("first", mostly_slow([False, True], (True,)))
@pytest.mark.parametrize("joints", [pytest.param((5, 4), marks=pytest.mark.slow), (5,)])
def test_inverse_dynamics(joints, first):
    """Anchors have no torques: the Jacobian agrees with its products, also as machine code, wherever the anchor is."""
    p = pinned(random_problem(2, arms=len(joints), joints=joints, moving_base=True), ("rigid",), 2)
    p = with_last_arm_first(p) if first else p
    random, chain, s = np.random.default_rng(1), p.chain, p.state
    qdd, wrench, tau = (random.normal(size=shape) for shape in (len(s.q), (len(chain.arms), 6), len(s.q)))
    inputs, by = replace(p.inputs, link_wrenches=None), ("q", "grasp_wrench", "base_pose")
    pulled = hf.inverse_dynamics.vjp(chain, s, qdd, wrench, inputs, tau=tau, by=by)
    own = hf.inverse_dynamics.jacobian(chain, s, qdd, wrench, inputs, by=by)
    moving = {"base_twist": p.inputs.base_twists, "base_acceleration": p.inputs.base_accelerations}
    one = hf.compile(chain).inverse_dynamics.jacobian(s.q, s.qd, qdd, wrench, by=by, **moving)
    for name in by:
        size = np.abs(own["tau", name]).max()
        assert np.abs(np.tensordot(tau, own["tau", name], 1) - pulled[name]).max() < 1e-12 * size
        assert np.abs(one["tau", name] - own["tau", name]).max() < 1e-12 * size


def with_last_arm_first(p):
    """Return the problem with its arms in another order; the last has no joints, so that q stays as it is."""
    chain, inputs = p.chain, p.inputs
    names = [chain.names[-1], *chain.names[:-1]]
    arms, grasps = ({name: of[name] for name in names} for of in (chain.arms, chain.grasps))
    rates = {name: np.roll(getattr(inputs, name), 1, axis=0) for name in ("base_twists", "base_accelerations")}
    return replace(p, chain=replace(chain, arms=arms, grasps=grasps), inputs=replace(inputs, **rates))


def test_inverse_dynamics_of_anchors_alone():
    """Without joints there are no torques, and the Jacobian has no rows; energies have no slopes by joints."""
    p = pinned(random_problem(1, arms=1, joints=3), ("rigid",), 1)
    chain = p.chain.without_grasp(p.chain.names[0])
    chain = hf.ClosedChain(
        {name: a for name, a in chain.arms.items() if name in chain.grasps}, chain.held_object, chain.grasps
    )
    state = hf.State(np.zeros(0), np.zeros(0), p.state.object_pose, p.state.object_twist)
    found = hf.inverse_dynamics.jacobian(chain, state, np.zeros(0), np.zeros((1, 6)), by=("q", "object_pose"))
    assert found["tau", "q"].shape == (0, 0) and found["tau", "object_pose"].shape == (0, 6)
    one = hf.compile(chain).inverse_dynamics.jacobian(*np.zeros((3, 0)), np.zeros((1, 6)), by=("q", "base_pose"))
    assert one["tau", "q"].shape == (0, 0) and one["tau", "base_pose"].shape == (0, 1, 6)
    kinetic = hf.dynamics.kinetic_energy.jacobian(chain, state, by=("q", "object_twist"))
    assert kinetic["kinetic_energy", "q"].shape == (0,) and kinetic["kinetic_energy", "object_twist"].shape == (6,)
