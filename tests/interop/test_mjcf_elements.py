"""Every element of MJCF is read, noted, refused, or known to have no effect on the motion of an arm."""

import re
import warnings

import pytest

from holdfast.errors import ModelWarning, SceneError
from holdfast.interop import load_mjcf, load_mjcf_arms, load_mjcf_trunk
from holdfast.interop import mjcf_model as reader
from holdfast.interop.mjcf_model import EFFECTS, NONE_ELEMENTS, NOTED_ELEMENTS, READ_ELEMENTS, REFUSED_ELEMENTS

mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco-core")

BODY = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
# an arm of two joints; its gripper has two fingers, whose joints are locked
ROBOT = f"""<mujoco>{{option}}<worldbody>
  <body name="stand"{{stand}}>
    <body name="upper"><joint name="j" {{j}}/>{BODY}
      <body name="lower" pos="1 0 0"{{lower}}><joint name="k"/>{BODY}<site name="palm"/>
        <body name="left" pos="0 .1 0"><joint name="l"/>{BODY}<site name="ls"/></body>
        <body name="right" pos="0 -.1 0"><joint name="r"/>{BODY}<site name="rs"/></body>
      </body>
    </body>
  </body>
  <site name="ground"/>
</worldbody>{{more}}</mujoco>"""


def robot(more: str = "", **filled: str) -> str:
    """Return the robot with something added."""
    return ROBOT.format(more=more, **{"option": "", "stand": "", "j": "", "lower": "", **filled})


def loaded(text: str) -> list[str]:
    """Return the lines of the warning that loading the arm gives."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        arm = load_mjcf(text, base="stand", tip="palm", lock_others=True)
    assert [joint.name for joint in arm.joints] == ["j", "k"]
    assert len(caught) <= 1
    lines = [line for one in caught for line in str(one.message).splitlines()]
    assert tuple(arm.notes) == tuple(lines)
    return lines


def test_every_element_has_a_row():
    """The rows are those of the schema of MuJoCo's reader, each in one place."""
    schema = re.findall(r"^ *(\S+) \([!?*R]\)", mujoco.mj_printSchema(False, False), re.MULTILINE)
    assert len({*schema}) > 100
    assert {tag.removeprefix("(world)") for tag in schema} - EFFECTS.keys() == set()
    assert len(EFFECTS) == len(READ_ELEMENTS) + len(NOTED_ELEMENTS) + len(REFUSED_ELEMENTS) + len(NONE_ELEMENTS)


def test_an_element_without_a_row(monkeypatch):
    """What a later MuJoCo may know is noted by name."""
    monkeypatch.setattr(reader, "EFFECTS", {tag: effect for tag, effect in EFFECTS.items() if tag != "site"})
    assert {line.rpartition(": ")[2] for line in loaded(robot())} == {"unknown element, not read"}
    assert any("site 'palm'" in line for line in loaded(robot()))


NOTES = {
    "inactive weld": ('<equality><weld name="e" body1="lower" body2="world" active="false"/></equality>', "'e': an eq"),
    "inactive joint": ('<equality><joint name="e" joint1="j" active="false"/></equality>', "'e': an equality"),
    "servo": ('<actuator><position name="a" joint="j" kp="9"/><motor joint="k"/></actuator>', "actuators 'a': servos"),
    "speed servo": ('<actuator><velocity name="a" joint="k" kv="9"/></actuator>', "actuators 'a': servos"),
    "servo of a tendon": (
        '<tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>'
        '<actuator><position name="a" tendon="t"/></actuator>', "actuators 'a': servos"),
    "muscle": ('<actuator><muscle name="a" joint="j" lengthrange="0 1"/></actuator>', "actuators 'a': servos"),
    "servo at a site": ('<actuator><general name="a" site="palm" biastype="affine" biasprm="1"/></actuator>', "'a': s"),
}  # fmt: skip


@pytest.mark.parametrize(("more", "said"), NOTES.values(), ids=NOTES)
def test_noted(more, said):
    """What acts on the arm and is not read is noted by name."""
    (line,) = loaded(robot(more))
    assert said in line


OPTIONS = {
    '<option gravity="0 0 -1.62"/>': "option gravity: 0 0 -1.62, not read",
    '<option><flag gravity="disable"/></option>': "option gravity: disabled, not read",
    '<option density="1000" viscosity="1e-3" wind="1 0 0"/>': "option density, viscosity, wind: the forces of a fluid",
}


@pytest.mark.parametrize(("option", "said"), OPTIONS.items())
def test_options(option, said):
    """Settings that act on every body are noted."""
    (line,) = loaded(robot(option=option))
    assert said in line


CLEAN = {
    "nothing": "",
    "motor": '<actuator><motor joint="j"/></actuator>',
    "servo of a finger": '<actuator><position joint="l"/></actuator>',
    "fingers that are coupled": '<equality><joint joint1="l" joint2="r"/></equality>',
    "fingers that are welded": '<equality><weld body1="left" body2="right"/></equality>',
    "spring between fingers": '<tendon><spatial stiffness="9"><site site="ls"/><site site="rs"/></spatial></tendon>',
    "spring of fingers": '<tendon><fixed stiffness="9"><joint joint="l" coef="1"/></fixed></tendon>',
    "tendons of fingers": '<tendon><fixed name="t"><joint joint="l" coef="1"/></fixed></tendon>'
    '<equality><tendon tendon1="t"/></equality>',
    "wind in a vacuum": "",
}


@pytest.mark.parametrize("more", CLEAN.values(), ids=CLEAN)
def test_without_effect(more):
    """What is within the locked gripper, and plain drives, need no note and no refusal."""
    assert loaded(robot(more, option='<option wind="1 0 0"/>' if more == "" else "")) == []


REFUSALS = {
    "weld": '<equality><weld name="e" body1="lower" body2="world"/></equality>',
    "weld to the stand": '<equality><weld name="e" body1="lower" body2="stand"/></equality>',
    "loop": '<equality><connect name="e" body1="left" body2="upper" anchor="0 0 0"/></equality>',
    "sites": '<equality><connect name="e" site1="palm" site2="ground"/></equality>',
    "joint": '<equality><joint name="e" joint1="j" joint2="l"/></equality>',
    "tendon": '<tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>'
    '<equality><tendon name="e" tendon1="t"/></equality>',
    "spring": '<tendon><spatial name="e" stiffness="9"><site site="ground"/><site site="palm"/></spatial></tendon>',
    "spring of joints": '<tendon><fixed name="e" stiffness="9"><joint joint="j" coef="1"/></fixed></tendon>',
}


@pytest.mark.parametrize("more", REFUSALS.values(), ids=REFUSALS)
def test_refused(more):
    """A coupling of bodies that move against each other is refused by name."""
    with pytest.raises(SceneError, match="'e': expected"):
        load_mjcf(robot(more), base="stand", tip="palm", lock_others=True)


def test_switched_off():
    """Springs, dampers, friction and equalities that a flag switches off are none."""
    joint = 'stiffness="3" damping="2" frictionloss="1"'
    flags = '<option><flag spring="disable" damper="disable" frictionloss="disable" equality="disable"/></option>'
    weld = '<equality><weld name="e" body1="lower" body2="world"/></equality>'
    for option, values in (("", (3.0, 2.0, 1.0)), (flags, (0.0, 0.0, 0.0))):
        arm = load_mjcf(
            robot(weld if option else "", option=option, j=joint), base="stand", tip="palm", lock_others=True
        )
        assert (arm.joints[0].stiffness, arm.joints[0].damping, arm.joints[0].friction) == values
    (line,) = loaded(robot(weld, option=flags))
    assert "not active" in line


def test_weightless_and_moved():
    """Gravity compensation is refused with a way round; a base that is moved from outside is noted."""
    with pytest.raises(SceneError, match=r"body 'lower': gravcomp: expected 0, got 0.5; try 0 there, and"):
        load_mjcf(robot(lower=' gravcomp="0.5"'), base="stand", tip="palm", lock_others=True)
    (line,) = loaded(robot(stand=' mocap="true"'))
    assert "body 'stand': mocap, taken as standing still" in line


def test_flexible_bodies():
    """A flexible body between the arm and the world is noted."""
    cloth = (
        '<deformable><flex name="f" dim="1" body="lower world" vertex="0 0 0 0 0 1" element="0 1" radius="0.01">'
        '<edge stiffness="5"/></flex></deformable>'
    )
    (line,) = loaded(robot(cloth))
    assert "flex 'f': its elastic forces are not read" in line


def test_every_loader_warns():
    """Several arms give one warning, which the trunk keeps."""
    text = robot(option='<option gravity="0 0 0"/>')
    with pytest.warns(ModelWarning, match="option gravity") as caught:
        load_mjcf_arms(text, {"a": ("stand", "palm")}, lock_others=True)
    assert [one.filename for one in caught] == [__file__]
    with pytest.warns(ModelWarning, match="option gravity") as caught:
        found = load_mjcf_trunk(text, ["ls", "rs"], base="stand")
    assert [one.filename for one in caught] == [__file__]
    assert found.notes == tuple(found.trunk.notes)
    assert "option gravity" in found.notes[0]
