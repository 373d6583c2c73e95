"""Arms on a trunk brought together: the trunk as preferred, or moved where they would not reach, and the report."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.assembly.on_trunk import on_own_bases
from holdfast.robots import panda
from tests.systems.problems import largest_gaps

LIFT = hf.Joint("prismatic", name="lift", position_limits=(0.0, 0.6))
WAIST = hf.Joint("revolute", placement=hf.Pose.translation(0, 0, 0.3), name="waist", position_limits=(-2.0, 2.0))
BODY = hf.Link(12.0, com=[0, 0, 0.2], inertia=np.diag([0.4, 0.3, 0.2]))
TORSO = hf.Trunk([LIFT, WAIST], [BODY, BODY])
ARMS = {"left": panda(hf.Pose.translation(0, 0.3, 0)), "right": panda(hf.Pose.translation(0, -0.3, 0))}
TRAY = hf.HeldObject.box(4.0, 0.3, 0.5, 0.1)
GRASPS = {
    "left": hf.Grasp("rigid", hf.contact_frame([0, 0.2, 0.05], into=[0, 0, -1])),
    "right": hf.Grasp("rigid", hf.contact_frame([0, -0.2, 0.05], into=[0, 0, -1])),
}
ON: dict[str, Any] = {"trunk": TORSO, "mounts": {"left": 1, "right": 1}}
HOME = [0.1, 0.2]


@pytest.mark.parametrize("pose", [None, hf.Pose.translation(0.5, 0.1, 0.9)])
def test_arms_on_a_torso_that_stands(pose):
    """The torso stays where it is preferred, the arms are what they are on bases of their own there."""
    found = hf.assemble(ARMS, TRAY, GRASPS, object_pose=pose, q={"trunk": HOME}, **ON)
    chain, state = found
    assert chain.trunk is not None and state.q[:2].tolist() == HOME and not state.qd.any()
    assert largest_gaps(hf.dynamics.closure(*found))[0] < 1e-10
    alone, there = on_own_bases(chain, state)
    expected = hf.assemble(alone.arms, TRAY, GRASPS, object_pose=pose)
    assert there.q == pytest.approx(expected.state.q, abs=1e-8)
    assert state.object_pose == pytest.approx(expected.state.object_pose, abs=1e-8)
    assert found.report.arms[0].reach == pytest.approx(expected.report.arms[0].reach)


def test_preferred_by_default():
    """A torso's joints stand in the middle of their limits."""
    _, state = hf.assemble(ARMS, TRAY, GRASPS, object_pose=hf.Pose.translation(0.5, 0, 1.0), **ON)
    assert state.q[:2].tolist() == [0.3, 0.0]


def test_a_torso_that_must_turn():
    """A tray out of reach from the preferred configuration is behind: the torso turns, and the arms are brought."""
    behind = hf.Pose.from_rpy(0, 0, np.pi / 2, [0.0, 0.65, 1.0])
    with pytest.raises(hf.errors.ClosureError):
        hf.assemble(on_own_bases(*stiff(behind))[0].arms, TRAY, GRASPS, object_pose=behind)
    found = hf.assemble(ARMS, TRAY, GRASPS, object_pose=behind, q={"trunk": [0.1, 0.0]}, **ON)
    assert largest_gaps(hf.dynamics.closure(*found))[0] < 1e-10
    assert found.state.object_pose == pytest.approx(behind.wxyz_xyz, abs=1e-12)
    assert 0.2 < found.state.q[1] <= 2.0
    twice = hf.assemble(ARMS, TRAY, GRASPS, object_pose=behind, q={"trunk": [0.1, 0.0]}, **ON)
    assert twice.state.q.tobytes() == found.state.q.tobytes()


def stiff(pose: hf.Pose) -> tuple[hf.ClosedChain, hf.State]:
    """Return the chain with its torso as preferred in the test above."""
    chain = hf.ClosedChain(ARMS, TRAY, GRASPS, **ON)
    return chain, hf.State(np.r_[0.1, 0.0, np.zeros(14)], np.zeros(16), pose)


def test_a_base_that_floats():
    """It stays where it is said to be, and the arms follow it; by default at the origin."""
    ship = hf.Trunk(floating=hf.Link(200.0, inertia=np.diag([30.0, 30.0, 20.0]), name="hull"))
    on: dict[str, Any] = {"trunk": ship, "mounts": dict.fromkeys(ARMS, "base"), "gravity": (0, 0, 0)}
    shift = hf.Pose.from_rpy(0.3, -0.2, 1.0, [1.0, 2.0, -0.5])
    pose = hf.Pose.translation(0.5, 0, 0.6)
    here = hf.assemble(ARMS, TRAY, GRASPS, object_pose=pose, **on)
    there = hf.assemble(ARMS, TRAY, GRASPS, object_pose=shift @ pose, base_pose=shift, **on)
    assert there.state.q == pytest.approx(here.state.q, abs=1e-8)
    assert here.state.base_frame.p.tolist() == [0, 0, 0] and there.state.base_frame.p == pytest.approx([1, 2, -0.5])
    assert here.report.mobility == hf.diagnose(*here).mobility == 14
    assert str(here.report).startswith("trunk: a floating base, no joint limits\n")


def test_report():
    """The trunk's nearest limit, the arms' reach from where they stand, and the mobility of the whole."""
    found = hf.assemble(
        ARMS, TRAY, GRASPS, object_pose=hf.Pose.translation(0.5, 0, 1.0), q={"trunk": [0.05, 0.2]}, **ON
    )
    report, diagnosis = found.report, hf.diagnose(*found)
    assert (report.mobility, report.rank) == (diagnosis.mobility, diagnosis.rank) == (10, 12)
    assert report.trunk is not None
    assert (report.trunk.joint, report.trunk.unit) == ("lift", "m") and report.trunk.margin == pytest.approx(0.05)
    assert str(report).startswith("trunk: a base in the world, lift nearest to a limit (0.05 m)\nleft: reach ")
    assert all(arm.residual < 1e-10 and 0 < arm.reach_used < 1 for arm in report.arms)


@pytest.mark.slow
def test_what_is_refused():
    """Poses of bases that do not float, configurations of another length, what no configuration reaches."""
    pose = hf.Pose.translation(0.5, 0, 1.0)
    for options, message in (
        ({"base_pose": pose, **ON}, "base_pose: expected none, as the trunk's base does not float"),
        ({"base_pose": pose}, "base_pose: expected none without a floating trunk"),
        ({"q": {"trunk": [0.1]}, **ON}, r"q of 'trunk': expected shape \(2,\), got shape \(1,\)"),
        ({"q": {"trunk": HOME}}, "q: no arm 'trunk'"),
        ({"mounts": {"left": 0}}, "mounts"),
    ):
        with pytest.raises(hf.HoldfastError, match=message):
            hf.assemble(ARMS, TRAY, GRASPS, object_pose=pose, **options)
    with pytest.raises(hf.errors.ClosureError, match=r"short.*no other was found to help"):
        hf.assemble(ARMS, TRAY, GRASPS, object_pose=hf.Pose.translation(5, 0, 1.0), **ON)


def test_close_with_a_trunk_that_moves():
    """`close(hold_object=True, hold_trunk=False)`: the object stays to the bit, trunk and arms go to it."""
    chain = hf.ClosedChain(ARMS, TRAY, GRASPS, **ON)
    guess = hf.State(np.r_[HOME, np.tile(hf.robots.HOME["panda"], 2)], np.ones(16), hf.Pose.translation(0.5, 0.1, 0.9))
    state = hf.close(chain, guess, hold_object=True, hold_trunk=False)
    assert state.object_pose.tobytes() == guess.object_pose.tobytes()
    assert np.abs(state.q[:2] - HOME).min() > 1e-3
    assert largest_gaps(hf.dynamics.closure(chain, state)).max() < 1e-10
    assert np.abs(state.qd[:2]).max() > 1e-3 and not state.object_twist.any()
    held = hf.close(chain, guess, hold_object=True)
    assert held.q[:2].tolist() == HOME and held.qd[:2] == pytest.approx([1.0, 1.0])


def test_with_an_anchor_on_the_trunk():
    """One corner of the tray is pinned to the torso, which turns with both: the arm is brought to it there."""
    arms = {"left": ARMS["left"], "pin": hf.Anchor(hf.Pose.translation(0.5, -0.1, 0.6))}
    grasps = {"left": GRASPS["left"], "pin": hf.Grasp("ball", hf.Pose.translation(0, -0.2, -0.05))}
    found = hf.assemble(arms, TRAY, grasps, q={"trunk": HOME}, trunk=TORSO, mounts={"left": 1, "pin": 1})
    assert largest_gaps(hf.dynamics.closure(*found))[0] < 1e-10 and found.state.q[:2].tolist() == HOME
    assert "pin: an anchor, closed to" in str(found.report)
    assert found.report.mobility == hf.diagnose(*found).mobility
