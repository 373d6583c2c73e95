"""Packages that robots' files refer to: given, beside the file, in its workspace, or in ROS's variables."""

import os
from pathlib import Path

import pytest

import holdfast as hf
from holdfast.cli import main
from holdfast.errors import SceneError
from holdfast.io.result_reader import load_result, setting_of
from holdfast.robots.mesh_files.mesh import MeshFault
from holdfast.robots.mesh_files.read import read_mesh
from holdfast.robots.urdf import urdf_chain
from holdfast.view.link_meshes import meshes_in_files
from tests.robots.mesh_files.written import CORNERS, FILES

VARIABLES = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH")
MACRO = """<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:macro name="lever" params="mass">
  <link name="foot"/>
  <joint name="pivot" type="continuous"><parent link="foot"/><child link="lever"/><axis xyz="0 1 0"/></joint>
  <link name="lever">
    <inertial><origin xyz="0 0 0.2"/><mass value="${mass}"/>
      <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.02"/></inertial>
    <visual><geometry><mesh filename="package://arm_description/meshes/a.stl"/></geometry></visual>
    <visual><geometry><mesh filename="file://$(find arm_description)/meshes/a.stl"/></geometry></visual>
  </link></xacro:macro></robot>"""
CELL = """<robot name="cell" xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:include filename="$(find arm_description)/urdf/lever.xacro"/><xacro:lever mass="2"/></robot>"""


@pytest.fixture(autouse=True)
def no_ros(monkeypatch):
    """No ROS around the tests."""
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)


def package(folder: Path, name: str = "arm_description") -> Path:
    """Write a package with a macro of a lever and a mesh, and return its folder."""
    for inside in ("urdf", "meshes"):
        (folder / inside).mkdir(parents=True)
    (folder / "package.xml").write_text(
        f"<?xml version='1.0'?>\n<!-- <name>other</name> -->\n<package format='3'><name> {name} </name></package>"
    )
    (folder / "urdf" / "lever.xacro").write_text(MACRO)
    (folder / "meshes" / "a.stl").write_bytes(FILES["binary.stl"])
    return folder


def cell(folder: Path) -> Path:
    """Write a package with a file that includes the macro, and return the file's path."""
    file = package(folder, "cell_config") / "config" / "cell.urdf.xacro"
    file.parent.mkdir()
    file.write_text(CELL)
    return file


# where the cell is, where the package is, and a variable with the folder that it lists
LAYOUTS = {
    "beside it": ("cell_config", "arm_description", None),
    "beside it, under another name": ("cell_config", "arm_description-2.0", None),
    "beside its repository": ("src/cell_repository/cell_config", "src/arm_repository/arm", None),
    "beside a folder above": ("robots/cells/first/cell_config", "robots/arm_description", None),
    "in it": ("cell_config", "cell_config/arm_description", None),
    "in ROS_PACKAGE_PATH": ("cell_config", "opt/ros/arms/arm", ("ROS_PACKAGE_PATH", "opt/ros")),
    "ROS_PACKAGE_PATH itself": ("cell_config", "opt/arm", ("ROS_PACKAGE_PATH", "opt/arm")),
    "installed": ("cell_config", "opt/share/arm_description", ("AMENT_PREFIX_PATH", "opt")),
    "installed by itself": (
        "cell_config", "install/arm_description/share/arm_description", ("COLCON_PREFIX_PATH", "install"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_where_packages_are_found(layout, tmp_path, monkeypatch):
    """An include and both meshes are found; the meshes also later, in the same places, without the variables."""
    pytest.importorskip("xacrodoc", reason="needs xacrodoc: pip install xacrodoc")
    here, there, variable = LAYOUTS[layout]
    file = cell(tmp_path / here)
    package(tmp_path / there)
    if variable is not None:
        monkeypatch.setenv(variable[0], os.pathsep.join(["/nowhere", str(tmp_path / variable[1])]))
    arm = hf.load_urdf(file, trust_xacro=True)
    assert [(joint.name, link.mass) for joint, link in zip(arm.joints, arm.links, strict=True)] == [("pivot", 2.0)]
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    chain = hf.ClosedChain({"arm": arm}, hf.HeldObject.box(1, 0.1, 0.1, 0.1), {})
    found, missing = meshes_in_files(chain)
    assert not missing
    assert [len(piece.mesh.faces) for piece in found["arm"][1]] == [len(CORNERS)] * 2


def test_a_given_package_comes_first(tmp_path):
    """`packages=` is used although there is another package of that name beside the file; and for every reader."""
    pytest.importorskip("xacrodoc", reason="needs xacrodoc: pip install xacrodoc")
    package(tmp_path / "arm_description")
    other, file = package(tmp_path / "elsewhere" / "fork"), cell(tmp_path / "cell_config")
    (other / "urdf" / "lever.xacro").write_text(MACRO.replace("${mass}", "7"))
    given = {"packages": {"arm_description": other}, "trust_xacro": True}
    assert hf.load_urdf(file, trust_xacro=True).links[0].mass == 2.0
    assert hf.load_urdf(file, **given).links[0].mass == 7.0
    assert hf.load_urdf_arms(file, {"arm": ("foot", "lever")}, **given)["arm"].links[0].mass == 7.0
    assert urdf_chain(file, **given).arm.links[0].mass == 7.0
    assert hf.HeldObject.from_urdf(file, "lever", **given).mass == 7.0
    assert hf.load_urdf(file, trust_xacro=True).links[0].mass == 2.0, "for one call"


def test_a_package_that_is_not_found(tmp_path, monkeypatch):
    """The error says where it was looked for, and how to give it on the command line, in scenes and in Python."""
    pytest.importorskip("xacrodoc", reason="needs xacrodoc: pip install xacrodoc")
    file = cell(tmp_path / "cell_config")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    with pytest.raises(SceneError) as caught:
        hf.load_urdf(file, trust_xacro=True)
    for part in (
        "no package 'arm_description' beside", str(tmp_path / "cell_config"), "ROS_PACKAGE_PATH (set)",
        "AMENT_PREFIX_PATH (not set)", "--package arm_description=FOLDER", "packages = { arm_description = 'FOLDER' }",
        "packages={'arm_description': 'FOLDER'}",
    ):  # fmt: skip
        assert part in str(caught.value)
    with pytest.raises(MeshFault, match="--package nothing=FOLDER"):
        read_mesh("package://nothing/a.stl", file.parent)
    assert len(read_mesh("package://nothing/meshes/a.stl", file.parent).faces) == len(CORNERS), "the file's own"
    for wrong, said in (
        ({"arm_description": tmp_path / "none"}, "'arm_description': expected a folder, got .*none, which is none"),
        ({"a": "nul\0"}, "'a': expected a folder"),
        ({3: "a"}, "expected the name of a package and its folder"),
        ("a=b", "packages: expected folders by name, got a str"),
    ):
        with pytest.raises(SceneError, match=said):
            hf.load_urdf(file, trust_xacro=True, packages=wrong)


def test_no_way_out_of_a_given_package(tmp_path):
    """A given package opens its own folder to meshes, and no other."""
    file, other = cell(tmp_path / "cell_config"), package(tmp_path / "fork")
    given = {"arm": str(other)}
    assert len(read_mesh("package://arm/meshes/a.stl", None, given).faces) == len(CORNERS)
    assert len(read_mesh(f"file://{other}/meshes/a.stl", file.parent, given).faces) == len(CORNERS)
    for name in ("package://arm/../fork/meshes/a.stl", f"{other}/../cell_config/config/cell.urdf.xacro", "a.stl"):
        with pytest.raises(MeshFault):
            read_mesh(name, None, given)
    with pytest.raises(MeshFault, match="expected a file in the robot's package"):
        read_mesh(f"file://{other}/meshes/a.stl", file.parent)


SCENE = """object = {{ mass = 1.0, box = [0.1, 0.1, 0.1], pose = {{ position = [0, 0, 0.4] }} }}
simulation = {{ duration = 0.02, step = 0.01 }}
grasps = [{{ arm = "arm", kind = "ball" }}]
arms = [{{ name = "arm", urdf = {{ file = "cell/config/cell.urdf.xacro" }}, tip = {{ position = [0, 0, 0.4] }} }}]
{packages}
"""


@pytest.mark.parametrize("how", ["in the scene", "on the command line"])
def test_packages_of_a_scene(how, tmp_path, monkeypatch, capfd):
    """A scene names packages relative to its folder; its result is read again when they are there no more."""
    pytest.importorskip("xacrodoc", reason="needs xacrodoc: pip install xacrodoc")
    cell(tmp_path / "scenes" / "cell")
    package(tmp_path / "parts" / "v2" / "arm")
    scene, out = tmp_path / "scenes" / "scene.toml", tmp_path / "run"
    named = 'packages = { arm_description = "../parts/v2/arm" }' if how == "in the scene" else ""
    scene.write_text(SCENE.format(packages=named))
    monkeypatch.chdir(tmp_path)
    call = ["simulate", str(scene), "--trust-xacro", "--out", str(out), "--no-plots"]
    if not named:
        assert main(call) == 2
        said = capfd.readouterr().err
        assert "--package arm_description=FOLDER" in said and not out.exists()
        assert main([*call, "--package", "arm_description"]) == 2
        assert "--package: expected NAME=FOLDER, got 'arm_description'" in capfd.readouterr().err
        call += ["--package", "arm_description=parts/v2/arm"]
    assert main(call) == 0
    loaded = hf.load_scene(scene, trust_xacro=True, packages={"arm_description": "parts/v2/arm"})
    assert loaded.chain.arms["arm"].links[0].mass == 2.0
    result = load_result(out)
    chain = setting_of(out, result.meta).chain
    assert meshes_in_files(chain)[0]["arm"]
    (tmp_path / "parts").rename(tmp_path / "gone")
    chain = setting_of(out, result.meta).chain
    assert chain.arms["arm"].links[0].mass == 2.0
    ((name, reasons),) = meshes_in_files(chain)[1].items()
    assert name == "arm" and "no such file" in reasons[0]
    assert main(["view", str(out), "--package", "a=b", "--export", str(tmp_path / "p.html")]) == 2
    assert main(["summary", str(out)]) == 0
