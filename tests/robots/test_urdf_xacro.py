"""Xacro files and robots by name, through the extra `robots`."""

import sys
import types

import pytest

from holdfast.errors import MissingExtra, SceneError
from holdfast.robots.descriptions import load_robot_description, robot_description_path
from holdfast.robots.urdf import load_urdf, read_urdf
from tests.robots.two_armed import TWO_ARMED

XACRO = """<robot name="macro" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="mass" default="1"/>
  <xacro:macro name="body" params="link">
    <link name="${link}">
      <inertial>
        <mass value="$(arg mass)"/>
        <inertia ixx="${2 * 0.01}" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/>
      </inertial>
    </link>
  </xacro:macro>
  <link name="base"/>
  <joint name="hinge" type="continuous"><parent link="base"/><child link="bar"/><axis xyz="0 1 0"/></joint>
  <xacro:body link="bar"/>
</robot>
"""


@pytest.fixture
def xacro_file(tmp_path):
    """A robot with a macro and an argument."""
    pytest.importorskip("xacrodoc", reason="needs xacrodoc: pip install xacrodoc")
    path = tmp_path / "macro.urdf.xacro"
    path.write_text(XACRO)
    return path


def test_xacro(xacro_file):
    """Macros, expressions and arguments are expanded before the file is read."""
    assert load_urdf(xacro_file, trust_xacro=True).links[0].mass == 1.0
    assert load_urdf(xacro_file, xacro_args={"mass": "2.5"}, trust_xacro=True).links[0].mass == 2.5


def test_xacro_includes(xacro_file):
    """A file is found beside the one that includes it, wherever Python stands."""
    (xacro_file.parent / "parts").mkdir()
    (xacro_file.parent / "parts" / "body.xacro").write_text(XACRO)
    outer = xacro_file.parent / "outer.xacro"
    outer.write_text(
        '<robot name="outer" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:include filename="parts/body.xacro"/></robot>'
    )
    assert load_urdf(outer, trust_xacro=True).links[0].mass == 1.0


@pytest.mark.parametrize("broken", ["${1/0}", "$(find no_such_package)"])
def test_xacro_that_cannot_be_expanded(xacro_file, broken):
    """Whatever xacro raises is told by the file's name, and nothing is printed."""
    xacro_file.write_text(XACRO.replace("${2 * 0.01}", broken))
    with pytest.raises(SceneError, match=r"macro\.urdf\.xacro: xacro cannot expand it: "):
        read_urdf(xacro_file, trust_xacro=True)


def test_xacro_that_becomes_nonsense(xacro_file, capfd):
    """What it expands to is read as strictly as any file; lines are those after expansion."""
    xacro_file.write_text(XACRO.replace("$(arg mass)", "heavy"))
    with pytest.raises(SceneError, match=r"macro\.urdf\.xacro \(expanded\):\d+: link 'bar', inertial, mass: value: "):
        read_urdf(xacro_file, trust_xacro=True)
    assert capfd.readouterr() == ("", "")


def test_without_xacrodoc(tmp_path, monkeypatch):
    """A missing package is told by the extra that brings it."""
    path = tmp_path / "r.xacro"
    path.write_text(XACRO)
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    with pytest.raises(MissingExtra, match=r"holdfast\[robots\]"):
        load_urdf(path, trust_xacro=True)
    with pytest.raises(SceneError, match="cannot be read: no such file"):
        load_urdf(tmp_path / "nowhere.xacro")
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    with pytest.raises(MissingExtra, match=r"holdfast\[robots\]"):
        load_robot_description("panda_description")


@pytest.fixture
def descriptions(tmp_path, monkeypatch):
    """The package of robot descriptions, with one repository as if it had been fetched."""
    pytest.importorskip("robot_descriptions", reason="needs robot_descriptions")
    from robot_descriptions import _cache

    folder = tmp_path / "robots" / "panda_description" / "urdf"
    folder.mkdir(parents=True)
    (folder / "panda.urdf").write_text(TWO_ARMED)
    monkeypatch.setattr(_cache, "clone_to_cache", lambda name, commit=None: str(tmp_path))
    monkeypatch.delitem(sys.modules, "robot_descriptions.panda_description", raising=False)
    yield tmp_path
    sys.modules.pop("robot_descriptions.panda_description", None)


def test_robot_by_name(descriptions):
    """A description's name gives its file, and the arm in it; a name that is not known is refused with one that is."""
    name = "panda"
    assert robot_description_path(name).startswith(str(descriptions))
    assert load_robot_description(name, base="torso", tip="left_grasp", lock_others=True).joint_count == 3
    with pytest.raises(SceneError, match=r"no URDF named 'pnda_description'\. Did you mean 'panda_description'"):
        load_robot_description("pnda_description")


def test_robot_that_is_a_xacro_file(descriptions, monkeypatch):
    """A description that would have to be expanded needs the user's word, as a file of their own does."""
    proof = descriptions / "proof"
    module = types.SimpleNamespace(XACRO_PATH=str(descriptions / "panda.xacro"), PACKAGE_PATH=str(descriptions))
    monkeypatch.setitem(sys.modules, "robot_descriptions.panda_description", module)
    monkeypatch.setattr("robot_descriptions._xacro.get_urdf_path", lambda *_, **__: proof.touch())
    with pytest.raises(SceneError, match=r"is a xacro file, .* try trust_xacro=True"):
        robot_description_path("panda_description")
    assert not proof.exists()
    robot_description_path("panda_description", trust_xacro=True)
    assert proof.exists()


def test_robot_that_cannot_be_fetched(descriptions, monkeypatch):
    """Without network the error says what to do instead."""
    from robot_descriptions import _cache

    def offline(name, commit=None):
        raise OSError("no route to host")

    monkeypatch.setattr(_cache, "clone_to_cache", offline)
    with pytest.raises(SceneError, match="is not available: OSError: no route to host; it needs the network once"):
        load_robot_description("panda_description")
