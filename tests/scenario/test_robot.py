"""Scenes whose arms come out of URDF files: the same arms as `load_urdf` gives, found from wherever one stands."""

import shutil

import numpy as np
import pytest

from holdfast import load_urdf_arms
from holdfast.cli import main
from holdfast.dynamics import closure
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.errors import ClosureError, SceneError
from holdfast.scenario.build import load_scene
from tests.io.signing import as_0_1
from tests.robots.two_armed import TWO_ARMED
from tests.scenario.test_build import refusal
from tests.systems.problems import largest_gaps

HELD = {"lift": 0.1}
ARMS = load_urdf_arms(
    TWO_ARMED,
    {side: ("torso", f"{side}_grasp") for side in ("left", "right")},
    locked=HELD,
    lock_others=True,
)
CONFIGURATION = {"left": [0.3, 1.0, 0.1], "right": [-0.2, 1.3, 0.15]}


def scene(urdf="", arm="", pieces=""):
    """Return a scene of both arms on one object, balls where the tips are at CONFIGURATION; text goes into each arm."""
    text = [
        'controller = { type = "gravity_compensation" }',
        "simulation = { duration = 0.02, step = 0.005 }",
        "object = { mass = 2, box = [0.3, 0.3, 0.3] }",
    ]
    for side, arm_of_file in ARMS.items():
        base = arm_of_file.base.p.tolist()
        file = f'file = "robots/two.urdf", base = "torso", tip = "{side}_grasp", lock_others = true{urdf}'
        text += ["[[arms]]", f'name = "{side}"', f"base = {{ position = {base} }}", f"urdf = {{ {file} }}", arm]
        point = forward_kinematics(arm_of_file, np.array(CONFIGURATION[side])).tip.p.tolist()
        text += ["[[grasps]]", f'arm = "{side}"', 'kind = "ball"', f"position = {point}"]
    return "\n".join([*text, pieces])


@pytest.fixture
def folder(tmp_path):
    """A folder with the robot and a scene of it."""
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "two.urdf").write_text(TWO_ARMED)
    (tmp_path / "two.toml").write_text(scene())
    return tmp_path


def test_same_arms(folder):
    """Both arms as `load_urdf_arms` has them; without q the search finds configurations that close."""
    found = load_scene(folder / "two.toml")
    for name, arm in ARMS.items():
        here = found.chain.arms[name]
        assert [joint.name for joint in here.joints] == [joint.name for joint in arm.joints]
        for q in np.random.default_rng(1).uniform(0.1, 1.0, (3, 3)):
            assert forward_kinematics(here, q).tip.wxyz_xyz == pytest.approx(
                forward_kinematics(arm, q).tip.wxyz_xyz, abs=1e-14
            )
        for mine, its in zip(here.links, arm.links, strict=True):
            assert mine.mass == its.mass
            assert (mine.inertia == its.inertia).all()
    assert largest_gaps(closure(found.chain, found.state))[0] < 1e-10


def test_a_guess_that_misses(folder):
    """A far guess of the user's own is refused, and without it the arms are led to the object from elsewhere."""
    (folder / "far.toml").write_text(scene(arm="q = [2.5, 2.4, 0.05]"))
    with pytest.raises(ClosureError, match="arm 'left' misses its grasp"):
        load_scene(folder / "far.toml")
    found = load_scene(folder / "two.toml")
    for name in ARMS:
        assert found.state.q[found.chain.joints[name]] == pytest.approx(CONFIGURATION[name], abs=1e-8)


def test_drives(folder):
    """Drive inertia and springs, which URDF has no place for, reach the joints."""
    (folder / "two.toml").write_text(scene(urdf=", armature = { left_elbow = 0.25 }").replace("right_elbow", "x", 1))
    with pytest.raises(SceneError, match=r"\$\.arms\[1\]\.urdf\.armature: no moving joint 'left_elbow'"):
        load_scene(folder / "two.toml")
    more = "armature = { left_elbow = 0.25 }, stiffness = { left_elbow = 30 }, rest = { left_elbow = 0.5 }"
    text = scene().replace('"left_grasp", lock', f'"left_grasp", {more}, lock')
    (folder / "two.toml").write_text(text)
    arms = load_scene(folder / "two.toml").chain.arms
    assert [joint.armature for joint in arms["left"].joints] == [0.0, 0.25, 0.0]
    assert [joint.armature for joint in arms["right"].joints] == [0.0, 0.0, 0.0]
    assert [(joint.stiffness, joint.rest) for joint in arms["left"].joints] == [(0.0, 0.0), (30.0, 0.5), (0.0, 0.0)]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("urdf = {", "urdfs = {", "$.arms[0]: Object contains unknown field `urdfs`. Did you mean 'urdf'?"),
        ("urdf = {", 'robot = "panda"\nurdf = {', "one of robot, urdf, joints and anchor, got robot and urdf"),
        ("urdf = { file", "# { file", "$.arms[0]: expected one of robot, urdf, joints and anchor, got none of them"),
        ("robots/two.urdf", "robots/tow.urdf", "$.arms[0].urdf: "),
        ('tip = "left_grasp"', 'tip = "left_gasp"', "Did you mean 'left_grasp'?"),
        ("lock_others = true", "lock_others = 1", "$.arms[0].urdf.lock_others: Expected `bool`, got `int`"),
        ("lock_others = true", "armature = { left_elbow = -1 }, lock_others = true",
         "$.arms[0].urdf.armature.left_elbow.armature: expected >= 0"),
        ("lock_others = true", "locked = { neck = 1e12 }", "$.arms[0].urdf.locked.neck: expected a number up to 1e+09"),
        ("lock_others = true", 'xacro_args = { a = "1" }', "xacro_args: expected none, since this is no .xacro file"),
        ("urdf = {", "q = [0.1]\nurdf = {", "$.arms[0].q: expected 3 joint positions"),
    ],
)  # fmt: skip
def test_refusals(old, new, message, folder):
    """One line that names the scene, the place in it, and what is wrong there or in the robot's file."""
    text = scene()
    assert old in text
    assert message in refusal(folder / "bad.toml", text.replace(old, new, 1))


@pytest.mark.slow
def test_result_keeps_its_robots(folder, tmp_path_factory, monkeypatch, cli):
    """A result is shown from anywhere as it was simulated, whatever has become of the robot's file."""
    pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    monkeypatch.chdir(folder)
    said = cli("simulate", "two.toml", "--out", elsewhere / "result", "--no-plots").err
    assert "note: robots/two.urdf:" in said  # the hand's link without inertia
    assert [path.read_text() for path in (elsewhere / "result").glob("robot_*.urdf")] == [TWO_ARMED]
    monkeypatch.chdir(elsewhere)
    show = ["view", "result", "--export", "page.html", "--overwrite"]
    said = cli(*show)
    assert "another model" not in said.err
    assert "note: arm 'left' is drawn with simple solids: " in said.err  # its finger's mesh is not there
    page = (elsewhere / "page.html").read_text()
    robot = folder / "robots" / "two.urdf"
    robot.write_text(TWO_ARMED.replace('<mass value="3"/>', '<mass value="4"/>'))
    shutil.move(elsewhere / "result", elsewhere / "moved")
    assert "another model" not in cli("view", "moved", *show[2:]).err
    assert (elsewhere / "page.html").read_text() == page


@pytest.mark.slow
def test_result_that_keeps_no_robots(folder, tmp_path_factory, monkeypatch, cli):
    """A folder of holdfast 0.1 knows where the robots were; if one has changed since, or has gone, that is said."""
    pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    monkeypatch.chdir(folder)
    assert main(["simulate", "two.toml", "--out", str(elsewhere / "result"), "--no-plots"]) == 0
    as_0_1(elsewhere / "result", robots=None)
    monkeypatch.chdir(elsewhere)
    show = ["view", "result", "--export", "page.html", "--overwrite"]
    assert "another model" not in cli(*show).err
    robot = folder / "robots" / "two.urdf"
    robot.write_text(TWO_ARMED.replace('<mass value="3"/>', '<mass value="4"/>'))
    assert "no longer describes the simulated model" in cli(*show).err
    shutil.move(folder / "robots", folder / "gone")
    assert f"{robot}: cannot be read: no such file" in cli(*show, code=2).err
