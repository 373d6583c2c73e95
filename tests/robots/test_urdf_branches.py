"""Arms with their grippers free out of URDF files: branches, mimic joints, named frames."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import SceneError
from tests.robots.two_armed import TWO_ARMED

HAND = {"tip": "left_hand", "base": "torso"}
HANDS = {"left": "left_hand", "right": "right_hand"}


def test_fingers_are_branches():
    """Fingers stand on the hand; the mimic joint is coupled to the one that it follows; every link has its frame."""
    arm = hf.load_urdf(TWO_ARMED, **HAND, branches=True)
    names = [joint.name for joint in arm.joints]
    assert names == ["left_shoulder", "left_elbow", "left_slide", "left_finger1", "left_finger2"]
    assert arm.parents == (None, 0, 1, 2, 2)
    (mimic,) = arm.couplings
    assert dict(mimic.terms) == {"left_finger2": 1.0, "left_finger1": -1.0} and mimic.offset == 0.0
    assert {"left_hand", "left_grasp", "left_box", "left_finger1_link"} <= set(arm.frames)
    held = hf.load_urdf(TWO_ARMED, **HAND, lock_others=True)
    q = np.array([0.1, 0.2, 0.1, 0.02, 0.02])
    poses = hf.dynamics.link_poses(arm, q)
    for pose, same in zip(poses, hf.dynamics.link_poses(held, q[:3]), strict=False):
        np.testing.assert_allclose([*pose.R.flat, *pose.p], [*same.R.flat, *same.p], atol=1e-14)


def test_locked_fingers_leave_a_serial_arm():
    """What is locked is no branch, and a serial arm has its tip as always."""
    arm = hf.load_urdf(TWO_ARMED, **HAND, branches=True, locked={"left_finger1": 0.02})
    same = hf.load_urdf(TWO_ARMED, **HAND, locked={"left_finger1": 0.02})
    assert arm.is_serial and arm.joint_count == 3
    np.testing.assert_array_equal(arm.tip.p, same.tip.p)
    assert arm.links[2].mass == same.links[2].mass


def test_two_arms_on_a_torso_with_free_grippers():
    """`lock_others` holds what is on no arm, such as the head; fingers move, and the trunk is that of locked ones."""
    found = hf.load_urdf_trunk(TWO_ARMED, HANDS, branches=True, lock_others=True)
    locked = hf.load_urdf_trunk(TWO_ARMED, HANDS, lock_others=True)
    assert [joint.name for joint in found.trunk.joints] == ["lift"] and found.mounts == locked.mounts
    assert found.arms["right"].joint_count == 5 and "neck" in found.locked and "left_finger1" not in found.locked
    chain = hf.ClosedChain(found.arms, trunk=found.trunk, mounts=found.mounts)
    assert len(chain.all_couplings) == 2 and chain.joint_names()[4] == "left/left_finger1"
    arms = hf.load_urdf_arms(
        TWO_ARMED, {n: ("torso", tip) for n, tip in HANDS.items()}, branches=True, lock_others=True
    )
    assert arms["left"].parents == found.arms["left"].parents


def test_the_whole_robot():
    """Without a tip all joints beyond the base move: accelerations are those of Pinocchio's mass matrix and bias."""
    pinocchio = pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")
    from benchmarks.free_robots import by_pinocchio, coupled, gap

    arm = hf.load_urdf(TWO_ARMED, branches=True)
    assert arm.joint_count == 12 and arm.parents[:2] == (None, 0)
    random = np.random.default_rng(0)
    q = coupled(arm, random.uniform(-0.5, 0.5, 12), offsets=True)
    qd, tau = coupled(arm, random.normal(size=12), offsets=False), random.normal(size=12)
    found = hf.forward_dynamics(hf.ClosedChain({"robot": arm}), hf.State(q, qd), tau)
    model = pinocchio.buildModelFromXML(TWO_ARMED)
    assert gap(found.qdd, by_pinocchio(model, arm, q, qd, tau)[0]) < 1e-12


@pytest.mark.parametrize(
    ("was", "now", "message"),
    [
        (
            '<mimic joint="left_finger1"',
            '<mimic joint="neck"',
            "expected to follow a joint of the same arm that moves, got 'neck'",
        ),
        (
            'name="left_finger1" type="prismatic"',
            'name="left_finger1" type="floating"',
            "expected a joint with one deg",
        ),
    ],
)
def test_refusals(was, now, message):
    """Leaders outside of the arm and joints that arms cannot have are refused with file and line."""
    with pytest.raises(SceneError, match=message):
        hf.load_urdf(TWO_ARMED.replace(was, now), **HAND, branches=True)


def test_a_loop_that_mimic_joints_say_again():
    """A loop of Gazebo's between links of joints that mimic one another is noted, and refused between others."""
    loop = """<gazebo><joint:hinge name="again"><body1>left_finger1_link</body1><body2>left_finger2_link</body2>
        </joint:hinge></gazebo></robot>"""
    arm = hf.load_urdf(TWO_ARMED.replace("</robot>", loop), **HAND, branches=True)
    assert "'again': not read, since the joints between its links mimic one of them" in " ".join(arm.notes)
    other = loop.replace("left_finger2_link", "left_upper")
    with pytest.raises(SceneError, match="closes a loop"):
        hf.load_urdf(TWO_ARMED.replace("</robot>", other), **HAND, branches=True)
