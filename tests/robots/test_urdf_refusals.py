"""Every refusal names file, line and element, says what was expected, and what to try."""

import re

import numpy as np
import pytest

import holdfast
from holdfast.errors import CallError, ModelError, SceneError
from holdfast.robots.urdf import load_urdf, load_urdf_arms, load_urdf_trunk, read_urdf, urdf_chain
from tests.robots.two_armed import TWO_ARMED

ARM = {"base": "torso", "tip": "left_grasp", "lock_others": True}
LINK = '<link name="left_lower">'
ELBOW = '<joint name="left_elbow" type="revolute">'

EDITS = [  # what is replaced, by what, and the message beyond the line
    ('<mass value="2"/>', '<mass value="-2"/>', "link 'head', inertial: mass: expected > 0, got -2.0"),
    ('<mass value="3"/>', '<mass value="heavy"/>', "inertial, mass: value: expected a number, got 'heavy'"),
    ('<mass value="3"/>', '<mass value="1e999"/>', "value: expected sizes up to 1e+09"),
    ('<mass value="3"/>', '<mass value="1_0"/>', "value: expected a number, got '1_0'"),
    ('<mass value="3"/>', '<mass kg="3"/>', "mass: value: expected a number, got no such attribute. Known: kg"),
    ('<mass value="3"/>', "", "link 'left_upper', inertial: expected <mass>, got none"),
    ('xyz="0 0.02 0.15"', 'xyz="0, 0.02, 0.15"', "expected 3 numbers separated by blanks, got '0, 0.02, 0.15'"),
    ('xyz="0 0.02 0.15"', 'xyz="${x} 0 0"', "try expanding it with xacro first"),
    ('xyz="0 0.02 0.15"', 'xzy="0 0.02 0.15"', "origin: 'xzy': unknown attribute. Did you mean 'xyz'?"),
    (' ixx="0.02"', "", "link 'left_lower', inertial, inertia: ixx: expected a number, got no such attribute"),
    ('izz="0.003"', 'izz="0.003" iyx="1"', "iyx: expected ixy, 0.0, since an inertia is symmetric, got 1.0"),
    ('iyy="0.02"', 'iyy="-0.02"', "link 'left_lower', inertial: inertia: expected principal moments >= 0"),
    ('<axis xyz="0.6 0 0.8"/>', '<axis xyz="0 0 0"/>', "'left_elbow', axis: xyz: expected a direction, got 0 0 0"),
    ('upper="2.4"', 'upper="-2.4"', "joint 'left_elbow', limit: expected lower <= upper, got 0 and -2.4"),
    ('effort="60"', 'effort="-60"', "joint 'left_elbow', limit: effort: expected >= 0, got -60.0"),
    ('damping="0.5"', 'damping="-0.5"', "joint 'left_shoulder', dynamics: damping: expected >= 0, got -0.5"),
    ('damping="0.5"', 'dampng="0.5"', "dynamics: 'dampng': unknown attribute. Did you mean 'damping'?"),
    ('damping="0.5"', 'spring_stiffness="-40"', "joint 'left_shoulder', dynamics: spring_stiffness: expected >= 0"),
    (ELBOW, ELBOW.replace("revolute", "revolut"), "got 'revolut'. Did you mean 'revolute'?"),
    (ELBOW, ELBOW.replace("revolute", "floating"), "'left_elbow': type: expected a joint with one degree of freedom"),
    (ELBOW, ELBOW.replace("left_elbow", "lift"), "joint 'lift': expected a unique name, first used in line 5"),
    (ELBOW, ELBOW + '<mimic joint="left_slide"/>', "'left_elbow': mimic: expected joints that move independently"),
    (ELBOW, ELBOW + '<mimic joint="left_slid"/>', "Did you mean 'left_slide'? Or try locked={'left_elbow': 0.0}"),
    (ELBOW, ELBOW + '<mimic joint="left_elbow"/>', "mimic: follows 100 joints or itself"),
    (ELBOW, ELBOW + "<origin/>", "joint 'left_elbow', origin: expected one <origin>, got a second"),
    (LINK, LINK + "<inertal/>", "link 'left_lower', inertal: unknown element. Did you mean <inertial>?"),
    (LINK, '<link name=" ">', "link ' ': name: expected a name of 1 to 256 printable characters"),
    (LINK, '<link name="left_upper">', "link 'left_upper': expected a unique name, first used in line"),
    (LINK, '<xacro:arm side="left"/>' + LINK, "xacro:arm: expected plain URDF, got unexpanded xacro"),
    (LINK, '<loop name="l"/>' + LINK, "loop 'l': closes a loop, which a serial arm cannot contain"),
    ('<child link="left_lower"/>', '<child link="left_lowr"/>', "no link 'left_lowr'. Did you mean 'left_lower'?"),
    ('<child link="left_lower"/>', '<child link="left_box"/>', "link 'left_box' hangs on joint 'left_mount' already"),
    ('<child link="left_lower"/>', '<child link="base"/>', "hangs on a cycle of joints|expected a root link"),
    ('left_upper"/> <child link="left_lower"', 'left_hand"/><child link="left_lower"', "cycle of joints with"),
    ("<robot", "<!DOCTYPE robot>\n<robot", "DOCTYPE 'robot': expected none"),
    ('<?xml version="1.0"', ' <?xml version="1.0"', "try deleting the text before <?xml ...?>"),
    ('encoding="UTF-8"', 'encoding="bogus"', "document: cannot be decoded|unknown encoding"),
    ("</robot>", "", "not well-formed XML: no element found"),
    ("</robot>", "<link/></robot>", "link: name: expected a name, got no such attribute"),
    ("</robot>", "<a>" * 200 + "</a>" * 200 + "</robot>", "expected at most 100 levels of elements"),
    ("</robot>", "<a/>" * 100_000 + "</robot>", "expected at most 100,000 elements"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "said"), EDITS, ids=[said[:40] for _, _, said in EDITS])
def test_the_line_is_named(tmp_path, old, new, said):
    """One thing goes wrong in a file: the error says where and what."""
    text = TWO_ARMED.replace(old, new, 1)
    assert text != TWO_ARMED
    path = tmp_path / "r.urdf"
    path.write_text(text, encoding="utf-8")
    options = {"tip": "head", "base": "torso"} if "'head'" in said else ARM
    with pytest.raises(SceneError) as caught:
        load_urdf(path, **options)
    message = str(caught.value)
    found = re.match(rf"{re.escape(str(path))}:(\d+): ", message)
    assert found, message
    pattern = "|".join(re.escape(one) for one in said.split("|"))
    assert re.search(pattern, message), message


def test_the_right_line(tmp_path):
    """The line is that of the element, wherever it begins."""
    text = TWO_ARMED.replace('<mass value="3"/>', '\n\n\n<mass\n value="heavy"/>', 1)
    line = text[: text.index("<mass\n")].count("\n") + 1
    with pytest.raises(SceneError, match=f"URDF text:{line}: link 'left_upper', inertial, mass: value"):
        read_urdf(text)


ASKED = [
    ({"tip": "left_grsp"}, "robot 'two_armed': tip: no link 'left_grsp'. Did you mean 'left_grasp'?"),
    ({"base": "nowhere at all", "tip": "head"}, "base: no link 'nowhere at all'. Known: 'base', 'torso'"),
    ({"base": 3, "tip": "head"}, "base: expected the name of a link, got a int"),
    ({"base": holdfast.Pose.identity(), "tip": "head"}, "got a Pose; a pose in the world is mount="),
    ({"base": "left_hand"}, "several ends"),
    ({"base": "head"}, "tip: no moving joint below base 'head'"),
    ({"base": "left_hand", "tip": "left_grasp"}, "joint that moves between base 'left_hand' and tip 'left_grasp'"),
    ({"base": "head", "tip": "head"}, "expected a joint that moves between base 'head' and tip 'head'"),
    ({"base": "torso", "tip": "left_grasp"}, "'left_finger1': moves link 'left_finger1_link', which hangs"),
    ({"base": "torso", "tip": "left_grasp"}, "try locked={'left_finger1': 0.01} or lock_others=True"),
    ({"tip": "left_finger2_link"}, "mimic: expected joints that move independently"),
    ({"tip": "left_finger1_link", "lock_others": True}, "try locked={'left_finger2': 0.0}"),
    ({"tip": "head", "locked": {"lfit": 0.0}}, "locked: no joint 'lfit'. Did you mean 'lift'?"),
    ({"tip": "head", "locked": {"lift": 0.5}}, "joint 'lift': locked: expected a position from 0 to 0.3"),
    ({"tip": "head", "locked": {"lift": "up"}}, "joint 'lift': locked: expected a number, got 'up'"),
    ({"tip": "head", "locked": {"lift": float("nan")}}, "locked: expected finite numbers"),
    ({"tip": "head", "locked": {"neck": 1e300}}, "locked: expected sizes up to 1e+09"),
    ({"tip": "head", "locked": {"left_tool": 0.0}}, "expected a joint with one degree of freedom, got a fixed one"),
    ({"tip": "head", "locked": ["lift"]}, "locked: expected positions by joint name, got a list"),
    ({"tip": "head", "xacro_args": {"a": "1"}}, "xacro_args: expected none, since this is no .xacro file"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "said"), ASKED, ids=[said[:40] for _, said in ASKED])
def test_what_was_asked_for(options, said):
    """A wish that the robot cannot meet is refused with what would do."""
    with pytest.raises(SceneError) as caught:
        load_urdf(TWO_ARMED, **options)
    assert said in str(caught.value)
    assert str(caught.value).startswith("URDF text:")


@pytest.mark.parametrize("arms", [{}, None, {"a": "torso"}, {"a": ("torso",)}, {"a": ("torso", "hnd")}, {"a": (1, 2)}])
def test_arms_that_are_none(arms):
    """Arms are pairs of link names; the mount is a pose, and no matter of the file."""
    with pytest.raises(SceneError, match="URDF text:2: robot 'two_armed': arm"):
        load_urdf_arms(TWO_ARMED, arms)
    with pytest.raises(ModelError, match="mount"):
        load_urdf(TWO_ARMED, base="torso", tip="head", mount=np.zeros(3))


@pytest.mark.parametrize("given", ["", "nowhere.urdf", ".", "a\0b", "x" * 5000, 3, b"<robot/>", None])
def test_files_that_are_none(given):
    """What cannot be read is no traceback."""
    with pytest.raises(SceneError, match=r"cannot be read|expected a path"):
        load_urdf(given)


def test_files_that_are_too_large(tmp_path):
    """A file of more than 32 MiB is not even parsed."""
    path = tmp_path / "r.urdf"
    path.write_bytes(b"<robot>" + b" " * (32 << 20))
    with pytest.raises(SceneError, match=r"r\.urdf:1: robot: expected at most 32 MiB"):
        read_urdf(path)


def test_entities_do_not_grow():
    """A billion laughs is refused at its DOCTYPE."""
    levels = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10))
    text = f'<?xml version="1.0"?><!DOCTYPE robot [<!ENTITY e0 "ha">{levels}]><robot name="&e9;"/>'
    with pytest.raises(SceneError, match="URDF text:1: DOCTYPE 'robot': expected none"):
        read_urdf(text)


def test_unknown_words_become_notes():
    """What is not read is told; what cannot matter for dynamics is not."""
    text = TWO_ARMED.replace(LINK, '<link name="left_lower" colour="red"><buoyancy>0</buoyancy>stray', 1)
    text = text.replace("</robot>", '<gazebo/><transmission/><plugin name="p"/></robot>')
    notes = [note.split(": ", 1)[1] for note in urdf_chain(text, **ARM).notes]
    assert "link 'left_lower': colour: unknown, not read" in notes
    assert "link 'left_lower', buoyancy: unknown element, not read" in notes
    assert "link 'left_lower': text 'stray', not read" in notes
    assert "plugin 'p': unknown element, not read" in notes
    assert not any("gazebo" in note or "transmission" in note for note in notes)


@pytest.mark.parametrize(
    ("read", "given"),
    [
        (urdf_chain, ()),
        (holdfast.load_urdf_arms, ({"left": ("torso", "left_hand")},)),
        (load_urdf_trunk, (["left_hand"],)),
    ],
)
def test_no_such_option(read, given):
    """A keyword that no reader of URDF files has is refused, with the nearest that they have."""
    with pytest.raises(CallError, match=r"'lock_other'\. Did you mean 'lock_others'"):
        read(TWO_ARMED, *given, lock_other=True)
