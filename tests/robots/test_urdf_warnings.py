"""The notes of a load reach whoever loads a file: one warning, and the report of `assemble`."""

import warnings

import pytest

import holdfast as hf
from holdfast.cli.results import opened_scene
from holdfast.errors import ModelWarning
from holdfast.robots.urdf import urdf_chain
from tests.robots.extended_files import robot
from tests.robots.two_armed import TWO_ARMED

NOTED = robot(after='<gazebo reference="hand"><kinematic>1</kinematic><wind/></gazebo>')
LOADS = {
    "load_urdf": lambda text: hf.load_urdf(text, tip="tip", lock_others=True),
    "load_urdf_arms": lambda text: hf.load_urdf_arms(text, {"a": ("base", "tip")}, lock_others=True),
    "load_urdf_trunk": lambda text: hf.load_urdf_trunk(text, ["tip"], floating=True, lock_others=True),
}


@pytest.mark.parametrize("load", LOADS.values(), ids=LOADS)
def test_once_per_load(load):
    """One warning names every element, in the caller's line; a clean file gives none, whatever its tip."""
    with pytest.warns(ModelWarning) as caught:
        load(NOTED)
    (one,) = caught
    assert [line.partition(": ")[2] for line in str(one.message).splitlines()] == [
        "gazebo, kinematic: acts on the motion, but is not read",
        "gazebo, wind: acts on the motion, but is not read",
    ]
    assert one.filename == __file__
    with warnings.catch_warnings(action="error"):
        load(robot())
        load(robot().replace('<child link="tip"/>', '<child link="tip"/><origin rpy="0 1.5707963267948966 0"/>'))


def test_two_arms_in_one_warning():
    """Notes on what arms share are shown once."""
    arms = {side: ("torso", f"{side}_grasp") for side in ("left", "right")}
    with pytest.warns(ModelWarning) as caught:
        hf.load_urdf_arms(TWO_ARMED, arms, lock_others=True)
    (one,) = caught
    lines = str(one.message).splitlines()
    assert len(lines) == len({*lines})
    assert any("'left_" in line for line in lines)
    assert any("'right_" in line for line in lines)


def test_in_the_report():
    """`assemble` reports the notes of every arm and of the trunk, each once."""
    grasps = {"tip": hf.Grasp("rigid", hf.Pose.identity())}
    box = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)
    found = hf.load_urdf_trunk(NOTED, ["tip"], floating=True, lock_others=True)
    for parts in ({"arms": {"tip": hf.load_urdf(NOTED, tip="tip", lock_others=True)}},
                  {"arms": found.arms, "trunk": found.trunk, "mounts": found.mounts}):  # fmt: skip
        arms = parts.pop("arms")
        report = hf.assemble(arms, box, grasps, **parts).report
        assert [note.partition(": ")[2] for note in report.notes][:1] == [
            "gazebo, kinematic: acts on the motion, but is not read"
        ]
        assert str(report).count("  note: URDF text:1: gazebo, kinematic") == 1


def test_the_notes_stay_with_the_chain():
    """A chain has all notes, those on frames too, and gives no warning."""
    with warnings.catch_warnings(action="error"):
        found = urdf_chain(NOTED, tip="tip", lock_others=True)
    assert len(found.notes) == 3
    assert tuple(found.arm.notes) == found.notes[:2]


# As the UR5's: a massless root, and two frames on the flange, `hand` with x forward and `tool0` with z forward.
ROBOT = """<robot name="ur">
  <link name="world"/>
  <joint name="mount" type="fixed"> <parent link="world"/> <child link="pedestal"/> </joint>
  <link name="pedestal"/>
  <joint name="shoulder" type="revolute">
    <parent link="pedestal"/> <child link="upper"/> <axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="2" effort="80"/>
  </joint>
  <link name="upper">
    <inertial> <mass value="3"/> <inertia ixx="0.04" iyy="0.04" izz="0.005" ixy="0" ixz="0" iyz="0"/> </inertial>
  </link>
  <joint name="wrist" type="revolute">
    <parent link="upper"/> <child link="flange"/> <origin xyz="0 0.1 0.4"/> <axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="2" effort="40"/>
  </joint>
  <link name="flange">
    <inertial> <mass value="1"/> <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/> </inertial>
  </link>
  <joint name="hand_joint" type="fixed">
    <parent link="flange"/> <child link="hand"/> <origin xyz="0 0.0823 0" rpy="0 0 1.5707963267948966"/>
  </joint>
  <link name="hand"/>
  <joint name="tool0_joint" type="fixed">
    <parent link="flange"/> <child link="tool0"/> <origin xyz="0 0.0823 0" rpy="-1.5707963267948966 0 0"/>
  </joint>
  <link name="tool0"/>
</robot>"""

SCENE = """
arms = [{{ name = "arm", urdf = {{ file = "ur.urdf", tip = "hand" }}, q = [0.2, 0.3]{tip} }}]
object = {{ mass = 1.0, box = [0.1, 0.1, 0.1], pose = {{ position = [0.0, 0.0, 0.4] }} }}
controller = {{ type = "gravity_compensation" }}
simulation = {{ duration = 0.01, step = 0.005 }}
"""


def test_a_tip_that_points_sideways():
    """The note has the file's line, the angle, the turn as code, and a link in the same place that points outward."""
    chain = urdf_chain(ROBOT, tip="hand")
    assert chain.tip_note == chain.notes[-1]
    assert chain.tip_note.startswith("URDF text:22: link 'hand': as a tip: the tip's z axis is 90 deg off")
    assert "try arm.with_tip(arm.tip @ hf.Pose.from_wxyz_xyz([0.5**0.5, 0, 0.5**0.5, 0, 0, 0, 0]))" in chain.tip_note
    assert chain.tip_note.endswith("or tip='tool0', a frame at the same place")
    good = urdf_chain(ROBOT, tip="tool0")
    assert good.tip_note == ""  # links that stand still need no mass; one that moves is noted
    massless = [f"link '{name}': no <inertial>, taken as massless" for name in ("hand", "tool0")]
    assert sorted(note.split(": ", 1)[1] for note in good.notes) == massless


@pytest.mark.parametrize("turned", [False, True])
def test_in_a_scene(tmp_path, capsys, turned):
    """The command line says it once; a scene whose `tip` turns the hand has nothing to be told."""
    (tmp_path / "ur.urdf").write_text(ROBOT)
    tip = ", tip = { rpy = [0, 1.5707963267948966, 0] }" if turned else ""
    (tmp_path / "scene.toml").write_text(SCENE.format(tip=tip))
    opened_scene(tmp_path / "scene.toml", trust_xacro=False)
    said = capsys.readouterr().err
    assert said.count("as a tip") == (not turned)
    assert "link 'world'" not in said
