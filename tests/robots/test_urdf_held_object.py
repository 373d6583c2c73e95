"""Held objects out of URDF files."""

import numpy as np
import pytest

import holdfast as hf
from tests.robots.two_armed import TWO_ARMED

TRAY = """<robot name="tray"><link name="tray">
  <inertial><origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/><mass value="2"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.025"/></inertial></link>
  <joint name="on" type="fixed"><parent link="tray"/><child link="cup"/><origin xyz="0.3 0 0.1"/></joint>
  <link name="cup"><inertial><mass value="1"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link></robot>"""


def test_welded():
    """Two kilograms and one, 0.3 m apart: the centre at a third, m1 m2 / (m1 + m2) d^2 more about y and z."""
    found = hf.HeldObject.from_urdf(TRAY)
    assert found.mass == 3.0
    np.testing.assert_allclose(found.com, [0.1, 0.0, 0.1], atol=1e-16)
    more = 2.0 * 1.0 / 3.0 * 0.3**2
    np.testing.assert_allclose(found.inertia, np.diag([0.021, 0.011 + more, 0.026 + more]), atol=1e-16)


def test_named_link(tmp_path):
    """A link by itself, about its own origin, out of a file; a link of an arm with what is fixed to it."""
    (tmp_path / "tray.urdf").write_text(TRAY)
    cup = hf.HeldObject.from_urdf(tmp_path / "tray.urdf", "cup")
    assert cup.mass == 1.0 and not cup.com.any()
    head = hf.HeldObject.from_urdf(TWO_ARMED, "head")
    assert head.mass == 2.0
    np.testing.assert_array_equal(head.inertia, 0.01 * np.eye(3))


def test_notes():
    """What is noted reaches the caller."""
    with pytest.warns(hf.errors.ModelWarning, match="gazebo, static: acts on the motion, but is not read") as caught:
        hf.HeldObject.from_urdf(TRAY.replace("</robot>", "<gazebo><static>1</static></gazebo></robot>"))
    assert [one.filename for one in caught] == [__file__]


def test_refused():
    """Several bodies, unknown links, and links without inertia, by name and line."""
    with pytest.raises(hf.SceneError, match=r"link 'base': expected one rigid body, got joints .* 'lift'; try link="):
        hf.HeldObject.from_urdf(TWO_ARMED)
    with pytest.raises(hf.SceneError, match=r"link: no link 'tary'. Did you mean 'tray'"):
        hf.HeldObject.from_urdf(TRAY, "tary")
    with pytest.raises(hf.SceneError, match="link 'left_grasp': expected <inertial>"):
        hf.HeldObject.from_urdf(TWO_ARMED, "left_grasp")
    point = TRAY.replace("0.001", "0").replace("0.01", "0").replace("0.02", "0").replace('"05"', '"0"')
    with pytest.raises(hf.SceneError, match="principal moments > 0"):
        hf.HeldObject.from_urdf(point, "cup")
