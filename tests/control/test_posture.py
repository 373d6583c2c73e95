"""Posture: redundant joints go where they are wished, and neither object nor grasp forces notice."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import InternalForce, ObjectImpedance, Posture, cooperative_law
from holdfast.control.law_parts import LawInput
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.errors import ModelError
from tests.control.kit import CHAIN, HERE, STATE, STIFF, N, moving
from tests.control.two_pandas import two_pandas


@pytest.mark.parametrize("kinds", [("rigid", "rigid"), ("rigid", "ball"), ("hinge", "softfinger")])
def test_object_and_forces_do_not_notice(kinds):
    """The same acceleration of the object and the same wrenches to 1e-10, with other joint accelerations."""
    chain, state = two_pandas(*kinds)
    posture = Posture(state.q + np.linspace(-0.5, 0.5, N), 6.0, clearance=0.3)
    for seed in range(3):
        now, found = moving(seed, chain, state), []
        for null in (Posture(), posture):
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
    law = cooperative_law(CHAIN, ObjectImpedance(HERE, 100.0, 20.0, 1.0), posture=Posture(STATE.q, 6.0))
    run = hf.simulate(CHAIN, away, law, 0.5, 2e-3, parameters={"external_wrench": np.zeros(6)})
    left = (run.q - STATE.q) @ direction
    assert left / left[0] == pytest.approx((1 + 6.0 * run.t) * np.exp(-6.0 * run.t), abs=5e-3)
    assert np.abs(run.object_pose - STATE.object_pose).max() < 1e-9


def test_repulsion_begins_softly():
    """Zero beyond the clearance, inwards within it, as steep as the text says; joints without limits feel nothing."""
    joint = CHAIN.all_joints[3]
    low, high = joint.position_limits
    width = 0.1 * (high - low)
    law = Posture(frequency=2.0, clearance=0.1)

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
def test_a_limit_holds_a_posture_back():
    """A rest posture beyond a limit is not approached as far if the limits repel, and the box stays."""
    rest, high = np.array(STATE.q), CHAIN.all_joints[2].position_limits[1]
    rest[2] = high + 0.5
    ends = []
    for clearance in (0.0, 0.45):
        law = cooperative_law(CHAIN, STIFF, posture=Posture(rest, 5.0, clearance))
        run = hf.simulate(CHAIN, STATE, law, 1.5, 5e-3)
        ends.append(run.q[-1, 2])
        assert np.abs(run.object_pose - STATE.object_pose).max() < 1e-6
    assert 0.1 < ends[0] < high and ends[1] < ends[0] - 0.05


def test_refused():
    """Numbers out of range, and postures of another chain."""
    with pytest.raises(ModelError, match=r"clearance: expected at most 0\.5"):
        Posture(clearance=0.6)
    with pytest.raises(ModelError, match=r"posture: rest: expected shape \(14,\), got \(3,\)"):
        cooperative_law(CHAIN, STIFF, posture=Posture([0.0, 0.0, 0.0]))
