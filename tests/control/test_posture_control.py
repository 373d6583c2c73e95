"""Posture: redundant joints go where they are wished, and neither object nor grasp forces notice."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space

import holdfast as hf
from holdfast.control import InternalForce, ObjectImpedance, PostureControl, cooperative_law
from holdfast.control.law_parts import LawInput
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.errors import ModelError
from tests.control.kit import CHAIN, HERE, STATE, STIFF, N, moving
from tests.control.two_pandas import two_pandas


@pytest.mark.parametrize("kinds", [("rigid", "rigid"), ("rigid", "ball"), ("hinge", "softfinger")])
def test_object_and_forces_do_not_notice(kinds):
    """The same acceleration of the object and the same wrenches to 1e-10, with other joint accelerations."""
    chain, state = two_pandas(*kinds)
    posture = PostureControl(state.q + np.linspace(-0.5, 0.5, N), 6.0, clearance=0.3)
    for seed in range(3):
        now, found = moving(seed, chain, state), []
        for null in (PostureControl(), posture):
            tau, _ = cooperative_law(chain, STIFF, InternalForce(25.0), null)(0.2, now, None)
            found.append(hf.forward_dynamics(chain, now, tau))
        plain, posed = found
        assert posed.object_acceleration == pytest.approx(plain.object_acceleration, abs=1e-10)
        assert posed.grasp_wrench == pytest.approx(plain.grasp_wrench, abs=1e-10 * np.abs(plain.grasp_wrench).max())
        assert np.abs(posed.qdd - plain.qdd).max() > 0.5


@pytest.mark.slow
def test_goes_to_the_rest_posture():
    """A swing of both elbows returns as (1 + w t) exp(-w t), critically damped, with the box at rest."""
    swing = hf.dynamics.project_velocity(
        CHAIN, hf.State(STATE.q, np.tile(np.eye(7)[2], 2), STATE.object_pose), hold_object=True
    )
    direction = swing.qd / np.linalg.norm(swing.qd)
    away = hf.close(CHAIN, hf.State(STATE.q + 0.02 * direction, np.zeros(N), STATE.object_pose), hold_object=True)
    law = cooperative_law(CHAIN, ObjectImpedance(HERE, 100.0, 20.0, 1.0), posture=PostureControl(STATE.q, 6.0))
    run = hf.simulate(CHAIN, away, law, 0.5, 2e-3, parameters={"external_wrench": np.zeros(6)})
    left = (run.q - STATE.q) @ direction
    assert left / left[0] == pytest.approx((1 + 6.0 * run.t) * np.exp(-6.0 * run.t), abs=5e-3)
    assert np.abs(run.object_pose - STATE.object_pose).max() < 1e-9


def test_follows_a_path_of_joints():
    """The difference from the path decays as (1 + w t) exp(-w t): its acceleration is -2 w e' - w^2 e."""
    w, later = 4.0, np.linspace(-1.0, 1.0, N)

    def swing(t):
        return STATE.q + t**3 * later, 3.0 * t**2 * later, 6.0 * t * later

    null = PostureControl(swing, w)
    for t in (0.0, 0.3):
        q, qd, qdd = swing(t)
        off, rate = 0.1 * np.cos(np.arange(N)), 0.2 * np.sin(np.arange(N))
        state = hf.State(q + off, qd + rate, STATE.object_pose)
        motion = chain_motion(CHAIN, state, np.zeros(N), hf.Inputs().shaped(CHAIN))
        found = null.joint_acceleration(LawInput(t, state, motion, np.zeros(0), {}))
        assert found == pytest.approx(qdd - 2.0 * w * rate - w * w * off, abs=1e-12)


def test_repulsion_begins_softly():
    """Zero beyond the clearance, inwards within it, as steep as the text says; joints without limits feel nothing."""
    joint = CHAIN.all_joints[3]
    low, high = joint.position_limits
    width = 0.1 * (high - low)
    law = PostureControl(frequency=2.0, clearance=0.1)

    def of_joint(q):
        at = np.array(STATE.q)
        at[3] = q
        state = hf.State(at, np.zeros(N), STATE.object_pose)
        motion = chain_motion(CHAIN, state, np.zeros(N), hf.Inputs().shaped(CHAIN))
        return law.joint_acceleration(LawInput(0.0, state, motion, np.zeros(0), {}))[3]

    for q in (0.5 * (low + high), low + 1.001 * width, high - 1.001 * width):
        assert of_joint(q) == 0.0
    assert of_joint(low) == pytest.approx(4.0 * width) and of_joint(high) == pytest.approx(-4.0 * width)
    assert of_joint(low + 0.5 * width) == pytest.approx(4.0 * width / 4)
    assert abs(of_joint(high - 0.999 * width)) < 1e-5 * width


@pytest.mark.slow
def test_limits_repel_as_far_as_the_object_allows():
    """The arms come to rest where no motion that leaves the box alone takes joints further from their limits."""
    law = cooperative_law(CHAIN, STIFF, posture=PostureControl(None, 6.0, clearance=0.45))
    run = hf.simulate(CHAIN, STATE, law, 6.0, 0.01)
    low, high = np.array([joint.position_limits for joint in CHAIN.all_joints]).T
    left = []
    for q, state in ((STATE.q, STATE), (run.q[-1], run.state(-1))):
        width = 0.45 * (high - low)
        near = [np.clip(1.0 - (q - low) / width, 0.0, None), np.clip(1.0 - (high - q) / width, 0.0, None)]
        basis = hf.dynamics.motion_basis(CHAIN, state)
        alone = basis[:N] @ null_space(basis[N:])  # joint rates with the box at rest
        left.append((np.linalg.norm(alone.T @ (width * (near[0] ** 2 - near[1] ** 2))), (width**2 * near[0] ** 3).sum()
                     + (width**2 * near[1] ** 3).sum()))  # fmt: skip
    (pull, potential), (pull_at_rest, least) = left
    assert pull_at_rest < 0.02 * pull and least < potential
    assert np.abs(run.object_pose - STATE.object_pose).max() < 1e-6


def test_refused():
    """Numbers out of range, and postures of another chain."""
    with pytest.raises(ModelError, match=r"clearance: expected at most 0\.5"):
        PostureControl(clearance=0.6)
    with pytest.raises(ModelError, match=r"posture: rest: expected shape \(14,\), got \(3,\)"):
        cooperative_law(CHAIN, STIFF, posture=PostureControl([0.0, 0.0, 0.0]))
