"""Notes on an arm that is loaded: a tip that points another way than the hand, and links that weigh nothing."""

import pytest

from holdfast.cli.results import opened_scene
from holdfast.robots.urdf import urdf_chain

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
