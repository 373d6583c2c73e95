"""Admittance: arms commanded by rates follow a path, give way to a push by their stiffness, and share a squeeze."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import PostureControl, admittance_law, compile_law
from holdfast.errors import MethodNotApplicable, ModelError
from holdfast.forces import split
from tests.control.kit import CHAIN, HERE, MASS, PATH, SPRING, STATE, N
from tests.control.two_pandas import pushes

T = 5e-3
DAMPER = np.repeat([10.0, 60.0], 3)


def law(path=HERE, **other):
    """Return the law, with a squeeze of 20 N."""
    own = {"internal_damping": 1000.0, "contact_stiffness": 1e5, "sample_time": T, "force": 20.0} | other
    return admittance_law(CHAIN, path, stiffness=SPRING, damping=DAMPER, inertia=MASS, **own)


def statics(state, push):
    """Return what sensors measure at rest: 20 N of squeeze, weight, and less what pushes from outside."""
    tau = hf.holding_torques(CHAIN, state, internal_force=20.0)
    held = hf.forward_dynamics(CHAIN, state, tau).grasp_wrench
    f = np.array(held)
    for row, grasp in zip(f, CHAIN.grasps.values(), strict=True):  # half of it each, seen from C
        row -= 0.5 * np.r_[push[:3] - np.cross(state.object_frame.R @ grasp.frame.p, push[3:]), push[3:]]
    return split(CHAIN, state, f).motion + split(CHAIN, state, held).internal


def carried(state, joints, way):
    """Return the closed state after small displacements of the joints and of the box."""
    at = state.object_frame
    there = hf.Pose(hf.spatial.rotation.exp(way[:3]) @ at.R, at.p + way[3:])
    return hf.close(CHAIN, hf.State(state.q + joints, np.zeros(N), there.wxyz_xyz))


@pytest.mark.slow
def test_gives_way_by_its_stiffness():
    """A rate-controlled box under a steady push comes to rest displaced by K^-1 w, to a micrometre."""
    push = np.array([0.0, 0.0, 0.0, 4.0, -2.0, -6.0])
    fast, state, memory = compile_law(law().given({"measured_wrenches": statics(STATE, push)}), CHAIN), STATE, None
    for _ in range(500):
        rates, memory = fast(0.0, state, memory)
        state = carried(state, T * rates, T * memory[:6])
    assert state.object_pose[4:] - STATE.object_pose[4:] == pytest.approx(push[3:] / SPRING[3:], abs=1e-6)
    assert np.abs(memory[:6]).max() < 1e-4


def test_follows_its_path():
    """Without a push, rates move the box along the path, as fast as the path asks."""
    t = 0.6
    target = PATH.at(t)
    q = hf.close(CHAIN, hf.State(STATE.q, np.zeros(N), target.pose.wxyz_xyz), hold_object=True)
    given = {"measured_wrenches": statics(q, np.zeros(6))}
    kept = np.r_[np.zeros(6), np.zeros(6)]
    rates, memory = law(PATH, posture=PostureControl(STATE.q, 1.0)).given(given)(t, q, kept)
    moving = hf.dynamics.state_from_joints(CHAIN, q.q, rates)
    assert moving.object_twist == pytest.approx(target.twist, abs=1e-6)
    assert memory[6:] == pytest.approx(target.acceleration, abs=1e-6)


@pytest.mark.parametrize("late", [False, True])
def test_the_squeeze_converges_as_predicted(late):
    """Contacts of stiffness k: the error obeys e_k+1 = e_k - k T / D e_k, or e_k-1 if it is measured a sample late."""
    stiffness, damper = 8e4, 1000.0
    made = law(internal_damping=damper, contact_stiffness=stiffness)
    tips = [hf.dynamics.tip_jacobian(arm, STATE.q[7 * i : 7 * i + 7]) for i, arm in enumerate(CHAIN.arms.values())]
    base, errors, seen = statics(STATE, np.zeros(6)), [12.0], [12.0, 12.0]
    normals = [STATE.object_frame.R @ grasp.frame.R[:, 2] for grasp in CHAIN.grasps.values()]
    for _ in range(15):
        measured = base + np.array([np.r_[np.zeros(3), seen[-2 if late else -1] * n] for n in normals])
        rates, _ = made.given({"measured_wrenches": measured})(0.0, STATE, None)
        into = [n @ (J @ rates[7 * i : 7 * i + 7])[3:] for i, (n, J) in enumerate(zip(normals, tips, strict=True))]
        assert into[0] == pytest.approx(into[1])
        errors.append(errors[-1] + stiffness * T * into[0])
        seen.append(errors[-1])
    before = [12.0, *errors[:-2]] if late else errors[:-1]
    assert errors[1:] == pytest.approx(np.array(errors[:-1]) - 0.4 * np.array(before), abs=1e-9)
    assert pushes(CHAIN, STATE, split(CHAIN, STATE, base).internal) == pytest.approx([20.0, 20.0], abs=1e-9)


def test_refused():
    """What is not stable with one sample of delay, and chains whose bases move."""
    with pytest.raises(ModelError, match=r"contact_stiffness \* sample_time / internal_damping < 1, the limit of"):
        law(contact_stiffness=5e5)
    alone, gains = (
        CHAIN.without_grasp("left").without_grasp("right"),
        {"stiffness": 1.0, "damping": 1.0, "inertia": 1.0},
    )
    with pytest.raises(MethodNotApplicable, match="got no grasp"):
        admittance_law(alone, HERE, **gains, internal_damping=1.0, contact_stiffness=1.0, sample_time=T)
