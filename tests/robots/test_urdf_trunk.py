"""Trunks out of URDF files: which joints are shared, where arms leave, what is held, and Pinocchio's tree."""

import numpy as np
import pytest

import holdfast as hf
from holdfast import Pose, load_urdf_trunk
from holdfast.dynamics import link_poses, tip_pose
from tests.robots.test_urdf import ON_A_TORSO, locks_to_try
from tests.robots.two_armed import TWO_ARMED

HANDS = {"left": "left_grasp", "right": "right_grasp"}
FREE_FINGERS = TWO_ARMED.replace('<mimic joint="left_finger1" multiplier="1"/>', "").replace(
    '<mimic joint="right_finger1" multiplier="1"/>', ""
)
FINGERS = {"one": "left_finger1_link", "two": "left_finger2_link"}
ON_A_SHIP = TWO_ARMED.replace('name="lift" type="prismatic"', 'name="lift" type="floating"')
BASE_MASS = '<link name="base"><inertial> <origin xyz="0.1 0 0"/> <mass value="30"/> <inertia ixx="1" ixy="0.1"'
BASE_MASS += ' ixz="0" iyy="1.5" iyz="0" izz="2"/> </inertial></link>'
WAIST = BASE_MASS.replace('"base"', '"waist"')
ON_A_TORSO = ON_A_TORSO.replace('<link name="waist"/>', WAIST)
HEAVY_BASE = ON_A_TORSO.replace('<link name="base"/>', BASE_MASS)

WAYS = {
    "a torso": (ON_A_TORSO, HANDS, {}),
    "held at a place": (ON_A_TORSO, HANDS, {"locked": {"lift": 0.2, "left_elbow": 0.5}}),
    "a head too": (ON_A_TORSO, {**HANDS, "head": "head"}, {}),
    "on several links": (FREE_FINGERS, {**FINGERS, "right": "right_grasp"}, {}),
    "a base that floats": (HEAVY_BASE, HANDS, {"floating": True}),
    "no joints but a floating base's": (HEAVY_BASE, HANDS, {"floating": True, "locked": {"lift": 0.1, "bow": 0.3}}),
}


@pytest.mark.parametrize("way", WAYS)
def test_agrees_with_pinocchio(way):
    """Frames, masses, accelerations of all joints and of the base, and hand wrenches, with a tray in the hands."""
    pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")
    from tests.robots.pinocchio_trunk import gaps

    xml, tips, options = WAYS[way]
    found = load_urdf_trunk(xml, tips, lock_others=True, **options)
    assert max(gaps(xml, found, tips)) < 1e-10


def test_shared_joints_are_the_trunk():
    """In the file's order and with its values; arms keep what only they have."""
    found = load_urdf_trunk(ON_A_TORSO, HANDS, lock_others=True)
    assert [joint.name for joint in found.trunk.joints] == ["lift", "bow"]
    assert [link.name for link in found.trunk.links] == ["waist", "torso"]
    assert found.trunk.joints[0].position_limits == (0.0, 0.3)
    assert found.mounts == {"left": "torso", "right": "torso"}
    assert [joint.name for joint in found.arms["left"].joints] == ["left_shoulder", "left_elbow", "left_slide"]
    assert found.locked["neck"] == 0.0 and found.locked["left_finger2"] == 0.01
    assert found.trunk.links[1].mass == pytest.approx(22.0)  # the head with it
    again = load_urdf_trunk(ON_A_TORSO, ["left_grasp", "right_grasp"], lock_others=True)
    assert [*again.arms] == ["left_grasp", "right_grasp"]


def test_arms_leave_where_no_other_goes_along():
    """Two fingers share the left arm, the right arm shares the lift alone."""
    found = load_urdf_trunk(FREE_FINGERS, {**FINGERS, "right": "right_grasp"}, lock_others=True)
    assert [joint.name for joint in found.trunk.joints] == ["lift", "left_shoulder", "left_elbow", "left_slide"]
    assert found.mounts == {"one": "left_hand", "two": "left_hand", "right": "torso"}
    assert [arm.joint_count for arm in found.arms.values()] == [1, 1, 3]


def test_where_it_stands():
    """The mount places the trunk's base; an arm that shares nothing stands in the world."""
    mount = hf.Pose.translation(1.0, 2.0, 3.0)
    third = """<joint name="side" type="fixed"><parent link="base"/><child link="post"/><origin xyz="0 1 0"/></joint>
      <link name="post"/>"""
    text = TWO_ARMED.replace('<joint name="neck" type="continuous">\n    <parent link="torso"/>', third + (
        '<joint name="neck" type="continuous">\n    <parent link="post"/>'))  # fmt: skip
    found = load_urdf_trunk(text, {**HANDS, "head": "head"}, lock_others=True, mount=mount)
    assert (found.trunk.base.p == mount.p).all()
    assert "head" not in found.mounts
    np.testing.assert_allclose(tip_pose(found.arms["head"], [0.0]).p, [1.0, 3.0, 3.5], atol=1e-15)


def test_joints_that_are_passed_upwards():
    """A base at one hand: the trunk begins there, and each arm with it is the arm that is loaded alone."""
    tips = {"right": "right_grasp", "head": "head"}
    found = load_urdf_trunk(TWO_ARMED, tips, base="left_grasp", lock_others=True)
    assert [joint.name for joint in found.trunk.joints] == ["left_slide", "left_elbow", "left_shoulder"]
    trunk_q = np.array([0.1, 0.5, -0.4])
    for name, arm in found.arms.items():
        alone = hf.load_urdf(TWO_ARMED, base="left_grasp", tip=tips[name], lock_others=True)
        q = np.linspace(0.1, 0.3, arm.joint_count)
        stands = link_poses(found.trunk.serial, trunk_q)[-1] @ arm.base
        tip, expected = tip_pose(arm.at(stands), q), tip_pose(alone, np.r_[trunk_q, q])
        np.testing.assert_allclose(tip.wxyz_xyz, expected.wxyz_xyz, atol=1e-14)


def test_a_hand_from_another_file():
    """On an arm, it is what one file of both says."""
    inertial = BASE_MASS.replace('<link name="base">', "").replace("</link>", "")
    below = f"""<link name="foot"/>
      <joint name="swing" type="continuous"><parent link="foot"/><child link="shank"/><axis xyz="1 0 0"/></joint>
      <link name="shank">{inertial}</link>
      <joint name="roll" type="continuous"><parent link="shank"/><child link="ankle"/><origin xyz="0 1 0.5"/>
      <axis xyz="0 1 0"/></joint><link name="ankle">{inertial}</link>"""
    weld = """<joint name="weld" type="fixed"><parent link="ankle"/><child link="base"/>
      <origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/></joint>"""
    whole = load_urdf_trunk(HEAVY_BASE.replace("</robot>", below + weld + "</robot>"), HANDS, lock_others=True)
    at = Pose.from_rpy(0.4, 0.5, 0.6, [0.1, 0.2, 0.3])
    arm = hf.load_urdf(f'<robot name="leg">{below}</robot>', tip="ankle")
    hand = load_urdf_trunk(HEAVY_BASE, HANDS, lock_others=True, floating=True)
    both = hand.mounted_on(arm, at)
    assert both.mounts == {"left": 3, "right": 3} and whole.mounts == {"left": "torso", "right": "torso"}
    assert [joint.name for joint in both.trunk.joints] == [joint.name for joint in whole.trunk.joints]
    for ours, wanted in zip(both.trunk.links, whole.trunk.links, strict=True):
        assert ours.mass == pytest.approx(wanted.mass)
        np.testing.assert_allclose(ours.com, wanted.com, atol=1e-15)
        np.testing.assert_allclose(ours.inertia, wanted.inertia, atol=1e-14)
    for ours, wanted in zip(both.trunk.joints, whole.trunk.joints, strict=True):
        np.testing.assert_allclose(ours.placement.wxyz_xyz, wanted.placement.wxyz_xyz, atol=1e-15)
    fixed = load_urdf_trunk(HEAVY_BASE, HANDS, locked={"lift": 0.1, "bow": 0.2}, lock_others=True, floating=True)
    on_palm = fixed.mounted_on(arm, at)
    assert on_palm.mounts == {"left": 1, "right": 1}
    expected = at @ fixed.arms["left"].base
    np.testing.assert_allclose(on_palm.arms["left"].base.wxyz_xyz, expected.wxyz_xyz, atol=1e-15)
    with pytest.raises(hf.errors.ModelError, match="mounted_on: expected a floating base"):
        load_urdf_trunk(HEAVY_BASE, HANDS, lock_others=True).mounted_on(arm)


LIFT = TWO_ARMED[TWO_ARMED.index('<joint name="lift"') : TWO_ARMED.index('<link name="torso">')]
PLACE = '<origin xyz="0.1 0.2 0.4" rpy="0.3 0.4 0.5"/>'


def with_planar(axis: str) -> str:
    """Return the robot on a planar joint."""
    lift = f'<parent link="base"/><child link="torso"/>{PLACE}<axis xyz="{axis}"/>'
    return TWO_ARMED.replace(LIFT, f'<joint name="drive" type="planar">{lift}</joint>')


@pytest.mark.parametrize(
    ("axis", "slides"),
    [("0 0 1", ("1 0 0", "0 1 0")), ("-1 0 0", ("0 1 0", "0 0 -1")), ("0 0.6 0.8", ("1 0 0", "0 0.8 -0.6"))],
)
def test_planar_joints(axis, slides):
    """They are two joints that slide and one that turns; Pinocchio agrees, where these are written out."""
    pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")
    from tests.robots.pinocchio_trunk import gaps

    inertial = '<inertial><mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'
    bound = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    written = f"""
      <joint name="drive.1" type="prismatic"><parent link="base"/><child link="drive.1"/>{PLACE}{bound}
      <axis xyz="{slides[0]}"/></joint><link name="drive.1">{inertial}</link>
      <joint name="drive.2" type="prismatic"><parent link="drive.1"/><child link="drive.2"/>{bound}
      <axis xyz="{slides[1]}"/></joint><link name="drive.2">{inertial}</link>
      <joint name="drive.3" type="continuous"><parent link="drive.2"/><child link="torso"/>
      <axis xyz="{axis}"/></joint>"""
    found = load_urdf_trunk(with_planar(axis), HANDS, lock_others=True)
    assert [joint.name for joint in found.trunk.joints] == ["drive.1", "drive.2", "drive.3"]
    assert "planar, read as two prismatic joints and a revolute joint" in "".join(found.notes)
    assert max(gaps(TWO_ARMED.replace(LIFT, written), found, HANDS)) < 1e-10


def test_pinocchios_own_planar_joint():
    """Places the torso at the same x, y and angle."""
    pin = pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")
    text, (x, y, angle) = with_planar("0 0 1"), (0.3, -0.7, 1.1)
    model = pin.buildModelFromXML(text)
    data, at = model.createData(), pin.neutral(model)
    first = model.joints[model.getJointId("drive")].idx_q
    at[first : first + 4] = x, y, np.cos(angle), np.sin(angle)
    pin.framesForwardKinematics(model, data, at)
    expected = data.oMf[model.getFrameId("torso")]
    torso = link_poses(load_urdf_trunk(text, HANDS, lock_others=True).trunk.serial, [x, y, angle])[-1]
    np.testing.assert_allclose(torso.p, expected.translation, atol=1e-14)
    np.testing.assert_allclose(torso.R, expected.rotation, atol=1e-14)


def test_a_floating_joint_makes_the_base_float():
    """A file that says so itself: what lies before the joint is of no meaning, the link beyond is the base."""
    found = load_urdf_trunk(ON_A_SHIP, HANDS, lock_others=True)
    assert found.trunk.floating is not None and found.trunk.floating.name == "torso"
    assert found.mounts == {"left": "base", "right": "base"}
    again = load_urdf_trunk(ON_A_SHIP, HANDS, lock_others=True, base="torso", floating=True)
    still = load_urdf_trunk(TWO_ARMED, HANDS, lock_others=True, base="torso", floating=True)
    for other in (again.trunk.floating, still.trunk.floating):
        assert other is not None
        np.testing.assert_array_equal(found.trunk.floating.inertia, other.inertia)
    with pytest.raises(hf.errors.SceneError, match="mount: expected none, since the base floats"):
        load_urdf_trunk(ON_A_SHIP, HANDS, lock_others=True, mount=hf.Pose.identity())


def test_all_that_moves_on_it_is_refused_at_once():
    """Head and fingers in one list, and what it says to try serves."""
    with pytest.raises(hf.errors.SceneError, match="moves link 'head', which hangs on the trunk") as refused:
        load_urdf_trunk(TWO_ARMED, HANDS)
    held = locks_to_try(refused.value)
    assert set(held) == {"neck", "left_finger1", "right_finger1"}
    assert load_urdf_trunk(TWO_ARMED, HANDS, locked=held).locked == {
        **held,
        "left_finger2": 0.01,
        "right_finger2": 0.01,
    }


@pytest.mark.parametrize(
    ("tips", "options", "said"),
    [
        ({}, {}, "tips: expected links by arm"),
        ("left_grasp", {}, "tips: expected links by arm"),
        ({"left": "left_gras"}, {}, "arm 'left': tip: no link 'left_gras'. Did you mean 'left_grasp'"),
        ({**HANDS, "upper": "left_upper"}, {}, "arm 'upper': expected a joint that moves no other arm, got none"),
        (HANDS, {"base": "torso"}, r"got none between base 'torso' and the tips; try load_urdf_arms with \{'left'"),
        (HANDS, {"locked": {"lift": 0.0}}, "expected a joint that moves two of the arms"),
        (
            {f"{side}{k}": f"{side}_finger{k}_link" for side in HANDS for k in (1, 2)},
            {},
            "'right_shoulder': moves arms 'right1', 'right2', while 'left_shoulder' moves .* 'left2'.*branches",
        ),
    ],
)
def test_refusals(tips, options, said):
    """What is no trunk is refused by name."""
    with pytest.raises(hf.errors.SceneError, match=said):
        load_urdf_trunk(FREE_FINGERS, tips, lock_others=True, **options)
