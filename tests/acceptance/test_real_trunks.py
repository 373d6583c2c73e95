"""Real robots with several arms (`make robots`): each loads in one call, and agrees with Pinocchio's whole tree."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import holdfast as hf
from holdfast import load_urdf_trunk
from holdfast.robots.arms_on_trunk import ArmsOnTrunk
from tests.acceptance.test_real_robots import FOLDER

pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")
from tests.robots.pinocchio_closed import closed_gaps
from tests.robots.pinocchio_trunk import gaps

TOLERANCE = 1e-10
STATES = 10

# file, its tips, and the joints that the arms share; Baxter's torso does not move, and its arms share none
ROBOTS = [
    ("baxter", ("left_gripper", "right_gripper"), ()),
    ("tiago_dual", ("hand_left_grasping_frame", "hand_right_grasping_frame"), ("torso_lift_joint",)),
    ("tiago_pro", ("gripper_left_base_link", "gripper_right_base_link"), ("torso_lift_joint",)),
    ("pr2", ("l_gripper_tool_frame", "r_gripper_tool_frame"), ("torso_lift_joint",)),
    ("talos_reduced", ("gripper_left_base_link", "gripper_right_base_link"), ("torso_1_joint", "torso_2_joint")),
    ("talos_full_v2", ("gripper_left_base_link", "gripper_right_base_link"), ("torso_1_joint", "torso_2_joint")),
    (
        "g1_29dof_rev_1_0",
        ("left_rubber_hand", "right_rubber_hand"),
        ("waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint"),
    ),
    (
        "g1_29dof_with_hand_rev_1_0",
        ("left_hand_palm_link", "right_hand_palm_link"),
        ("waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint"),
    ),
    ("romeo", ("l_gripper", "r_gripper"), ("TrunkYaw",)),
    ("icub", ("l_gripper", "r_gripper"), ("torso_pitch", "torso_roll", "torso_yaw")),
    ("centauro", ("ball1_tip", "ball2_tip"), ("torso_yaw",)),
    ("alex_nub_hands", ("LeftGripperYawLink", "RightGripperYawLink"), ("SpineYaw", "SpineRoll", "SpinePitch")),
    ("simple_humanoid", ("l_wrist", "r_wrist"), ("WAIST_P", "WAIST_R", "CHEST")),
]
ON_A_TRUNK = [
    pytest.param(file, links, floating, id=f"{file}-{'floating' if floating else 'standing'}")
    for file, links, shared in ROBOTS
    for floating in (False, True)
    if floating or shared
]

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not any(FOLDER.rglob("baxter.urdf")), reason="no robots fetched: make robots"),
]


def real(file: str) -> Path:
    """Return the file of a fetched robot."""
    return next(path for path in sorted(FOLDER.rglob(f"{file}.urdf")) if "example-robot-data" in str(path))


def test_a_hand_on_an_arm():
    """The Allegro hand on a UR5, each from its own file, is Pinocchio's tree of one file with both."""
    arm, hand = real("ur5_robot"), real("allegro_right_hand")
    at = hf.Pose.translation(0.01, 0.02, 0.03)
    tips = {f"finger{k}": f"link_{4 * k + 3}.0_tip" for k in range(4)}
    found = load_urdf_trunk(hand, tips, floating=True, physical=False).mounted_on(hf.load_urdf(arm, tip="tool0"), at)
    weld = """<joint name="weld" type="fixed"><parent link="tool0"/><child link="palm_link"/>
        <origin xyz="0.01 0.02 0.03"/></joint>"""
    parts = [re.search(r"<robot[^>]*>(.*)</robot>", path.read_text(), re.DOTALL)[1] for path in (arm, hand)]
    both = f'<robot name="both">{parts[0]}{parts[1]}{weld}</robot>'
    differs = gaps(both, found, tips, hf.HeldObject.box(0.1, 0.05, 0.05, 0.05), "ball")
    print("UR5 with Allegro hand " + "  ".join(f"{gap:.1e}" for gap in differs))
    assert max(differs) <= TOLERANCE


def loaded(file: str, links: tuple[str, str], *, floating: bool) -> tuple[ArmsOnTrunk, dict[str, str]]:
    """Return a robot that stands or floats, all but its arms held, and the links of its tips."""
    tips = dict(zip(("left", "right"), links, strict=True))
    return load_urdf_trunk(real(file), tips, floating=floating, lock_others=True, physical=False), tips


@pytest.mark.parametrize("floating", [False, True], ids=["standing", "floating"])
@pytest.mark.parametrize(("file", "links", "shared"), ROBOTS, ids=[robot[0] for robot in ROBOTS])
def test_arms_on_their_trunk(file, links, shared, floating):
    """Frames, masses, and dynamics with a tray in both hands, the trunk's joints and a floating base included."""
    if not floating and not shared:
        with pytest.raises(hf.SceneError, match="expected a joint that moves two of the arms, got none"):
            loaded(file, links, floating=floating)
        return
    found, tips = loaded(file, links, floating=floating)
    assert tuple(joint.name for joint in found.trunk.joints) == shared
    differs = gaps(real(file).read_text(encoding="utf-8"), found, tips)
    print(f"{file:30s} {'floating' if floating else 'standing'} " + "  ".join(f"{gap:.1e}" for gap in differs))
    assert max(differs) <= TOLERANCE


@pytest.mark.parametrize(("file", "links", "floating"), ON_A_TRUNK)
def test_closed_through_a_tray(file, links, floating):
    """Trunk, base, arms, tray and hands' wrenches in random closed states are those of `constraintDynamics`."""
    found, tips = loaded(file, links, floating=floating)
    xml = real(file).read_text(encoding="utf-8")
    worst = [max(gap) for gap in zip(*(closed_gaps(xml, found, tips, seed) for seed in range(STATES)), strict=True)]
    print(f"{file:30s} {'floating' if floating else 'standing'} " + "  ".join(f"{gap:.1e}" for gap in worst))
    assert max(worst) <= TOLERANCE
