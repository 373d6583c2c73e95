"""SDF files: the same robots as by URDF, loops, joints of several degrees of freedom, and what is refused."""

from __future__ import annotations

import random
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelWarning, SceneError
from holdfast.robots.urdf import read_urdf, urdf_chain, urdf_tree
from tests.robots.as_sdf import as_sdf, as_urdf, random_joints
from tests.systems import mutated_text

INERTIAL = "<inertial><mass>2</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>"
BOX = hf.HeldObject.box(1.0, 0.2, 0.2, 0.2)


def model(*parts: str, version: str = "1.9") -> str:
    """Return a file with one model."""
    return f'<sdf version="{version}"><model name="m">{"".join(parts)}</model></sdf>'


def link(name: str, pose: str = "", more: str = "") -> str:
    """Return a link of 2 kg."""
    return f'<link name="{name}"><pose>{pose}</pose>{INERTIAL}{more}</link>'


def joint(name: str, kind: str, parent: str, child: str, axis: str = "", more: str = "") -> str:
    """Return a joint; `axis` is its xyz."""
    along = f"<axis><xyz>{axis}</xyz></axis>" if axis else ""
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return f'<joint name="{name}" type="{kind}">{ends}{along}{more}</joint>'


def free(arm: hf.Arm, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """Return the accelerations of an arm without torques."""
    chain = hf.ClosedChain({"arm": arm}, BOX, {})
    return hf.forward_dynamics(chain, hf.State(q, qd, hf.Pose.identity()), np.zeros(len(q))).qdd


@pytest.mark.parametrize("seed", [None, 1, 2])
@pytest.mark.parametrize("robot", [3, 4])
def test_as_urdf(robot, seed):
    """The same arm as from URDF: limits, dynamics, accelerations; frames of links may be anywhere."""
    joints = random_joints(robot)
    by_urdf, by_sdf = hf.load_urdf(as_urdf(joints), tip="link5"), hf.load_urdf(as_sdf(joints, seed), tip="link5")
    for a, b in zip(by_urdf.joints, by_sdf.joints, strict=True):
        for name in ("name", "kind", "position_limits", "rate_limit", "effort_limit", "damping", "friction"):
            assert getattr(a, name) == getattr(b, name)
        assert b.axis == pytest.approx(a.axis, abs=1e-12)
    q, qd = np.random.default_rng(5).normal(size=(2, 5)) * 0.5
    assert free(by_sdf, q, qd) == pytest.approx(free(by_urdf, q, qd), rel=1e-9, abs=1e-9)
    if seed is None:
        tips = [hf.dynamics.tip_pose(arm, q) for arm in (by_sdf, by_urdf)]
        assert np.abs(tips[0].R - tips[1].R).max() < 1e-12 and np.abs(tips[0].p - tips[1].p).max() < 1e-12
        assert [one.name for one in by_sdf.links] == [one.name for one in by_urdf.links]


def four_bar(closing: str, axis: str = "0 1 0", more: str = "") -> str:
    """Return two cranks of 1 m on the ground, 1 m apart, and a coupler that closes onto the second one."""
    return model(
        link("base"), link("crank", "0 0 0 0 0 0"), link("coupler", "0 0 1 0 0 0"), link("rocker", "1 0 0 0 0 0"),
        joint("stand", "fixed", "world", "base"), joint("a", "revolute", "base", "crank", "0 1 0"),
        joint("b", "revolute", "crank", "coupler", "0 1 0"), joint("d", "revolute", "base", "rocker", "0 1 0"),
        joint("c", closing, "coupler", "rocker", axis, "<pose>0 0 1 0 0 0</pose>" + more),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "grasp", "rows", "more"),
    [
        ("revolute", "hinge", 5, ""), ("ball", "ball", 3, ""), ("fixed", "rigid", 6, ""),
        ("prismatic", "slider", 5, ""),
        ("universal", "universal", 4, "<axis2><xyz>1 0 0</xyz></axis2>"),
        ("screw", "screw", 5, "<screw_thread_pitch>0.01</screw_thread_pitch>"),
    ],
)  # fmt: skip
def test_loops(kind, grasp, rows, more):
    """A joint whose child hangs on another one closes a loop of its kind, which is closed as the file stands."""
    text = four_bar(kind, "" if kind in ("ball", "fixed") else "0 1 0", more)
    arm = hf.load_urdf(text, branches=True)
    assert [*arm.loops] == ["c"] and arm.loops["c"].grasp.kind == grasp
    chain = hf.ClosedChain({"arm": arm})
    state = hf.State(np.zeros(3), np.zeros(3))
    found = hf.diagnose(chain, state)
    assert found.rows == rows
    with pytest.raises(SceneError, match=r"closes a loop, which a serial arm cannot contain.*try branches=True"):
        hf.load_urdf(text, base="base", tip="coupler", lock_others=True)


def test_a_ring():
    """If every link hangs on another one, the canonical link is the base; a switch of Simbody's cuts elsewhere."""
    places = {"one": "0 0.2 0", "two": "0.2 0 0", "three": "0 -0.2 0", "four": "-0.2 0 0"}
    names, at = [*places], ["-0.2 0 0", "0 0.2 0", "0.2 0 0", "0 -0.2 0"]
    parts = [link(name, f"{xyz} 0 0 0") for name, xyz in places.items()]
    parts += [
        joint(f"above {names[k]}", "revolute", names[k - 1], names[k], "0 0 1", f"<pose>{at[k]} 0 0 0</pose>")
        for k in range(4)
    ]
    for text, base in (
        (model(*parts), "one"),
        (model(*parts).replace('name="m"', 'name="m" canonical_link="two"'), "two"),
    ):
        found = urdf_chain(text, branches=True)
        assert found.base == base and [*found.arm.loops] == [f"above {base}"]
        chain = hf.ClosedChain({"ring": found.arm})
        assert hf.diagnose(chain, hf.State(np.zeros(3), np.zeros(3))).mobility == 1
    cut = "<physics><simbody><must_be_loop_joint>true</must_be_loop_joint></simbody></physics>"
    twice = joint("first", "revolute", "one", "two", "0 0 1", cut), joint("second", "revolute", "three", "two", "0 0 1")
    chosen = hf.load_urdf(model(*parts[:3], *twice, joint("third", "revolute", "one", "three", "0 0 1")), branches=True)
    assert [*chosen.loops] == ["first"]


def test_four_bar_moves():
    """Gravity moves the parallelogram as one equation says: its two cranks and the coupler, 2 kg each."""
    arm = hf.load_urdf(four_bar("revolute"), branches=True)
    order = [one.name for one in arm.joints]
    q = 0.4
    angles = {"a": q, "b": -q, "d": q}
    state = hf.State([angles[name] for name in order], np.zeros(3))
    found = hf.forward_dynamics(hf.ClosedChain({"arm": arm}), state, np.zeros(3))
    expected = 2 * 9.81 * np.sin(q) / (2 * 0.1 + 2)  # only the coupler's mass is off its pivot; the bars' is on it
    assert found.mobility == 1
    assert found.qdd[order.index("a")] == pytest.approx(expected, rel=1e-9)


URDF_INERTIAL = '<inertial><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'


def hinged(name: str, parent: str, child: str, xyz: str) -> str:
    """Return a hinge of a URDF file."""
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="continuous">{ends}<origin xyz="{xyz}"/><axis xyz="0 1 0"/></joint>'


def pinned(name: str, parent: str, xyz: str) -> str:
    """Return a frame of a URDF file whose x axis is y of its parent."""
    ends = f'<parent link="{parent}"/><child link="{name}"/>'
    at = f'<origin xyz="{xyz}" rpy="0 0 1.5707963267948966"/>'
    return f'<link name="{name}"/><joint name="to {name}" type="fixed">{ends}{at}</joint>'


OPEN_FOUR_BAR = "".join(
    [
        '<robot name="r"><link name="base"/>',
        *(f'<link name="{name}">{URDF_INERTIAL}</link>' for name in ("crank", "coupler", "rocker")),
        hinged("a", "base", "crank", "0 0 0"),
        hinged("b", "crank", "coupler", "0 0 1"),
        hinged("d", "base", "rocker", "1 0 0"),
        pinned("c1", "coupler", "1 0 0"),
        pinned("c2", "rocker", "0 0 1"),
        "</robot>",
    ]
)
HINGE = hf.Closure("c1", "c2", hf.Grasp("hinge"))


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ([("c1", "c2", "hinge")], "c1-c2"),
        ({"pin": ("c1", "c2", "hinge")}, "pin"),
        ([HINGE], "c1-c2"),
        ({"pin": HINGE}, "pin"),
        ([["c2", "c1", "3d"]], "c2-c1"),
        ([("c2", "c1")], "c2-c1"),
    ],
)
def test_listed_closures(given, name):
    """A URDF file whose loop the caller lists, in every form, moves as the SDF file that states it."""
    by_list = hf.load_urdf(OPEN_FOUR_BAR, branches=True, loop_closures=given)
    by_file, found = hf.load_urdf(four_bar("revolute"), branches=True), []
    assert [*by_list.loops] == [name]
    for arm in (by_list, by_file):
        angles = {"a": 0.4, "b": -0.4, "d": 0.4}
        state = hf.State([angles[one.name] for one in arm.joints], np.zeros(3))
        qdd = hf.forward_dynamics(hf.ClosedChain({"arm": arm}), state, np.zeros(3)).qdd
        found.append(dict(zip([one.name for one in arm.joints], qdd.tolist(), strict=True)))
    assert found[0] == pytest.approx(found[1], rel=1e-9)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("c1", "expected pairs of links"),
        ([("c1",)], "expected pairs of links"),
        ([("c1", "c3")], "no link 'c3'. Known"),
        ([("c1", "c1")], "expected two links"),
        ([("c1", "c2", "hing")], "Did you mean 'hinge'"),
        ([("c1", "c2", "screw")], "pitch"),
        ([("c1", "c2"), ("c1", "c2")], "expected unique names"),
    ],
)
def test_wrong_lists(given, message):
    """What is no list of closures is refused, and one without branches."""
    with pytest.raises(SceneError, match=message):
        hf.load_urdf(OPEN_FOUR_BAR, branches=True, loop_closures=given)
    with pytest.raises(SceneError, match="try branches=True"):
        hf.load_urdf(OPEN_FOUR_BAR, tip="coupler", lock_others=True, loop_closures=[HINGE])


def test_a_joint_for_gazebo():
    """A URDF file whose loop is stated for Gazebo moves as the SDF file, with branches; without, it says so."""
    pin = joint("closing", "revolute", "r::coupler", "r::rocker", "0 1 0", "<pose>0 0 1 0 0 0</pose>")
    text, found = OPEN_FOUR_BAR.replace("</robot>", f"<gazebo>{pin}</gazebo></robot>"), []
    for arm in (hf.load_urdf(text, branches=True), hf.load_urdf(four_bar("revolute"), branches=True)):
        angles = {"a": 0.4, "b": -0.4, "d": 0.4}
        state = hf.State([angles[one.name] for one in arm.joints], np.zeros(3))
        qdd = hf.forward_dynamics(hf.ClosedChain({"arm": arm}), state, np.zeros(3)).qdd
        found.append(dict(zip([one.name for one in arm.joints], qdd.tolist(), strict=True)))
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    with pytest.raises(SceneError, match=r"closes a loop, which a serial arm cannot contain.*branches=True"):
        hf.load_urdf(text, tip="coupler", lock_others=True)
    with pytest.raises(SceneError, match="closes a loop"):
        hf.load_urdf(text.replace('type="revolute"', 'type="gearbox"'), branches=True)


def test_joints_of_several_freedoms():
    """A ball joint is spherical, a universal one two revolute ones, a screw travels by its pitch per turn."""
    text = model(
        link("base"), link("x"), link("y"), link("z", "0 0 1 0 0 0"),
        joint("ball", "ball", "base", "x"),
        joint("cross", "universal", "x", "y", "1 0 0", "<axis2><xyz>0 1 0</xyz></axis2>"),
        joint("thread", "screw", "y", "z", "0 0 1", "<screw_thread_pitch>0.01</screw_thread_pitch>"),
    )  # fmt: skip
    arm = hf.load_urdf(text, tip="z")
    assert [(one.name, one.kind) for one in arm.joints] == [
        ("ball", "spherical"), ("cross.1", "revolute"), ("cross.2", "revolute"), ("thread", "screw"),
    ]  # fmt: skip
    assert arm.joints[3].pitch == pytest.approx(0.01 / (2 * np.pi))
    held = hf.load_urdf(text, base="y", tip="z")
    assert hf.dynamics.tip_pose(held, [2 * np.pi]).p == pytest.approx([0, 0, 1.01])
    shut = hf.load_urdf(text, base="x", tip="y", locked={"thread": np.pi})
    assert shut.links[-1].com == pytest.approx([0, 0, 1.005 / 2])


def test_frames_mimics_and_switches():
    """Frames are links, mimic joints couplings, gravity that is off a refusal; what is not read is noted."""
    fingers = [joint(f"f{k}", "prismatic", "hand", f"finger{k}", "0 1 0", "") for k in (1, 2)]
    fingers[1] = fingers[1].replace(
        "</xyz>",
        '</xyz><mimic joint="f1"><multiplier>-1</multiplier><offset>0.1</offset><reference>0.02</reference></mimic>',
    )
    parts = [
        link("base"), link("hand", more="<velocity_decay><linear>0.1</linear></velocity_decay>"),
        link("finger1"), link("finger2"),
        joint("turn", "revolute", "base", "hand", "0 0 1"), *fingers,
        '<frame name="tool" attached_to="hand"><pose degrees="true">0 0 0.3 0 180 0</pose></frame>',
    ]  # fmt: skip
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        arm = hf.load_urdf(model(*parts), branches=True)
    assert issubclass(warned[0].category, ModelWarning) and "velocity_decay" in str(warned[0].message)
    (coupling,) = arm.couplings
    assert coupling.terms == {"f2": 1.0, "f1": 1.0} and coupling.offset == pytest.approx(0.12)
    index, at = arm.frames["tool"]
    assert arm.links[index].name == "hand" and at.p == pytest.approx([0, 0, 0.3])
    assert at.R[:, 2] == pytest.approx([0, 0, -1])
    off = model(*(part.replace("</inertial></link>", "</inertial><gravity>false</gravity></link>") for part in parts))
    with pytest.raises(SceneError, match="gravity off for link"):
        hf.load_urdf(off, branches=True)
    assert "turn: revolute" in urdf_tree(read_urdf(model(*parts)))


def test_world_and_pose():
    """A joint to the world stands where the model is; quaternions are read; a world around one model is, too."""
    parts = [
        '<pose rotation_format="quat_xyzw">1 2 3 0 0 0.7071067811865476 0.7071067811865476</pose>',
        link("base", "1 0 0 0 0 0"), link("arm"), joint("stand", "fixed", "world", "base"),
        joint("j", "revolute", "base", "arm", "0 0 1"),
    ]  # fmt: skip
    found = urdf_chain(model(*parts), tip="arm")
    assert found.base == "world" and hf.dynamics.tip_pose(found.arm, [0.0]).p == pytest.approx([1, 2, 3])
    around = (
        model(*parts)
        .replace("<model", '<world name="w"><gravity>0 0 -1</gravity><model')
        .replace("</model>", "</model></world>")
    )
    noted = urdf_chain(around, tip="arm")
    assert any("gravity" in note for note in noted.notes)
    with pytest.raises(SceneError, match="expected one <model>, got 'm', 'n'"):
        read_urdf(model(*parts).replace("</sdf>", '<model name="n"/></sdf>'))


ARM = (link("base"), link("arm"), joint("j", "revolute", "base", "arm", "0 0 1"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (model(*ARM, version="1.4"), "version: expected one of 1.6"),
        (model(*ARM, "<include><uri>model://x</uri></include>"), "model of another file"),
        (model(*ARM, '<model name="inner"/>'), "a nested model"),
        (model(*ARM, link("arm")), "expected a unique name, got 'arm', first used"),
        (model(*ARM, link("loose")), "expected one root link, got"),
        (model(*ARM[:2], joint("j", "revolut", "base", "arm", "0 0 1")), "Did you mean 'revolute'"),
        (model(*ARM[:2], joint("j", "revolute", "bse", "arm", "0 0 1")), "no link, joint or frame 'bse'. Did you mean"),
        (model(*ARM[:2], joint("j", "revolute", "base", "arm", "0 0 0")), "expected a direction"),
        (model(*ARM[:2], joint("j", "revolute", "base", "arm")), "expected <axis>, got none"),
        (model(*ARM[:2], joint("j", "revolute", "base", "arm", "0 0 x")), "expected 3 numbers"),
        (model(*ARM[:2], joint("j", "revolute", "base", "world", "0 0 1")), "not the world"),
        (model(*ARM[:2], joint("j", "screw", "base", "arm", "0 0 1", "<thread_pitch>1</thread_pitch>")), "<screw_thr"),
        (model(*ARM[:2], joint("j", "screw", "base", "arm", "0 0 1")), "expected <screw_thread_pitch>"),
        (model(*ARM).replace("<xyz>", '<xyz expressed_in="nowhere">'), "no link, joint or frame 'nowhere'"),
        (model(*ARM).replace("<mass>2", "<mas>2").replace("</mass>", "</mas>"), "Did you mean <mass>"),
        (model(*ARM, '<frame name="f" attached_to="g"/><frame name="g" attached_to="f"/>'), "is attached to itself"),
        (model(link("base"), link("arm").replace("<pose>", '<pose relative_to="arm">'), ARM[2]), "relative to itself"),
        (model(*ARM[:1], link("arm").replace("<inertial>", '<inertial auto="true">'), ARM[2]), "auto: inertia"),
        (model(*ARM[:1], link("arm", "0 0 0 0 0"), ARM[2]), "expected 6 numbers"),
    ],
)  # fmt: skip
def test_refusals(text, message):
    """Every refusal gives file, line and element, and what to do."""
    with pytest.raises(SceneError, match=message) as caught:
        hf.load_urdf(text, tip="arm")
    assert "SDF text:1: " in str(caught.value)


def test_scene(tmp_path: Path):
    """A scene reads an SDF file as an arm."""
    (tmp_path / "arm.sdf").write_text(as_sdf(random_joints(3)))
    (tmp_path / "arm.urdf").write_text(as_urdf(random_joints(3)))
    chains = []
    for kind in ("sdf", "urdf"):
        rest = '[controller]\ntype = "gravity_compensation"\n[simulation]\nduration = 0.1\nstep = 0.01\n'
        (tmp_path / f"{kind}.toml").write_text(
            f'[[arms]]\nname = "arm"\n[arms.urdf]\nfile = "arm.{kind}"\ntip = "link5"\n[object]\nmass = 1.0\n'
            f"box = [0.1, 0.1, 0.1]\n{rest}"
        )
        chains.append(hf.load_scene(tmp_path / f"{kind}.toml").chain)
    for a, b in zip(*(one.arms["arm"].links for one in chains), strict=True):
        assert a.mass == b.mass and a.com == pytest.approx(b.com)


@pytest.mark.parametrize("seed", range(4))
def test_spoilt_files(seed):
    """A spoilt file is read, or refused by our error with file and line."""
    dice, whole = random.Random(seed), four_bar("revolute") if seed % 2 else as_sdf(random_joints(3), 1)
    lines, refused = whole.replace("><", ">\n<"), list[str]()
    for _ in range(150):
        spoil = dice.choice([spoilt_value, mistyped, deleted, duplicated])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                hf.load_urdf(spoil(lines, dice), branches=True)
        except SceneError as cause:
            refused.append(str(cause))
    assert len(refused) > 20 and all(" text:" in message for message in refused)


def spoilt_value(text: str, dice: random.Random) -> str:
    """Return the text with the text of one element replaced by an odd one."""
    found = dice.choice([*re.finditer(r">([^<>]+)<", text)])
    odd = dice.choice(["", "nan", "inf", "1e999", "-1", "0 0 0", "0 0 0 0 0 0", "world", "base", "__model__", "x::y"])
    return text[: found.start(1)] + odd + text[found.end(1) :]


def mistyped(text: str, dice: random.Random) -> str:
    """Return the text with one wrong letter."""
    return mutated_text.mistyped(text, dice, "abcxyz<>&\"'/= ")


def deleted(text: str, dice: random.Random) -> str:
    """Return the text without one tag, one line, or everything beyond a point."""
    return mutated_text.deleted(text, dice, re.compile(r"<[^<>]*>"))


def duplicated(text: str, dice: random.Random) -> str:
    """Return the text with a line or block repeated."""
    return mutated_text.duplicated(text, dice, first=2)
