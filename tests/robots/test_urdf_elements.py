"""Every element of URDF and its extensions is read, noted, refused, or known to have no effect on the motion."""

import warnings

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelWarning, SceneError
from holdfast.robots.urdf import read_urdf, urdf_chain
from holdfast.robots.urdf.extensions import ENGINES
from holdfast.robots.urdf.vocabulary import VOCABULARY, is_off
from tests.robots.extended_files import robot
from tests.robots.two_armed import TWO_ARMED

# Of the formats' own descriptions: what moves masses or exerts forces, by the element in which it stands.
ACTS = {
    "robot": ["link", "joint", "gazebo", "transmission", "ros2_control", "mujoco", "loop_joint", "force_element",
              "drake:joint", "drake:linear_bushing_rpy", "drake:ball_constraint", "drake:weld_constraint",
              "drake:distance_constraint", "drake:tendon_constraint", "drake:coupler_constraint"],
    "link": ["inertial", "gravity", "turnGravityOff", "kinematic", "velocity_decay"],
    "inertial": ["origin", "mass", "inertia"],
    "joint": ["parent", "child", "origin", "axis", "dynamics", "mimic", "drake:mimic"],
    "gazebo": ["joint", "joint:hinge", "joint:slider", "gearbox", "link", "model", "include", "gravity",
               "turnGravityOff", "dampingFactor", "velocity_decay", "kinematic", "static", "enable_wind", "inertial",
               "springStiffness", "springReference", "axis", "axis2", "physics", "dynamics", "screw_thread_pitch",
               "thread_pitch", "gearbox_ratio"],
    "sdf axis": ["dynamics", "mimic"],
    "sdf dynamics": ["damping", "friction", "spring_stiffness", "spring_reference"],
    "sdf physics": ["max_force", "must_be_loop_joint"],
    "transmission": ["joint", "actuator", "compensator"],
    "transmission part": ["drake:controller_gains"],
    "ros2_control": ["joint", "transmission"],
    "mujoco compiler": ["boundmass", "boundinertia", "settotalmass", "balanceinertia", "inertiafromgeom"],
}  # fmt: skip
# where an element of a row stands in the file
PLACES = {
    "robot": "{}",
    "gazebo": '<gazebo reference="hand">{0}</gazebo>',
    "sdf axis": '<gazebo reference="wrist"><axis>{}</axis></gazebo>',
    "sdf dynamics": '<gazebo reference="wrist"><axis><dynamics>{}</dynamics></axis></gazebo>',
    "sdf physics": '<gazebo reference="wrist"><physics><ode>{}</ode></physics></gazebo>',
    "transmission": '<transmission name="t"><joint name="wrist"/>{}</transmission>',
    "transmission part": '<transmission name="t"><joint name="wrist"/><actuator name="m">{}</actuator></transmission>',
    "ros2_control": '<ros2_control name="r">{}</ros2_control>',
    "mujoco": "<mujoco>{}</mujoco>",
}


def with_element(row: str, tag: str) -> str:
    """Return a robot with an element at work in a row."""
    inside = "" if tag in (*ENGINES, "visual") else "<body>hand</body><body>upper</body>7"
    element = (
        f"<{tag}>{inside}</{tag}>" if tag != "visual" else "<visual><geometry><sphere radius='1'/></geometry></visual>"
    )
    if row == "link":
        return robot(hand=element)
    if row == "joint":
        return robot(dynamics=element)
    return robot(after=PLACES[row].format(element))


def test_what_acts_has_an_effect():
    """Nothing that the formats' descriptions say of masses and forces is skipped or unknown."""
    silent = [
        (row, tag)
        for row, tags in ACTS.items()
        for tag in tags
        if VOCABULARY[row].effect(tag) not in ("read", "noted", "refused")
    ]
    assert silent == []


ROWS = [
    (row, tag, effect)
    for row in ("link", "joint", *PLACES)
    for effect, tags in (
        ("noted", VOCABULARY[row].noted), ("refused", VOCABULARY[row].refused), ("none", VOCABULARY[row].skipped)
    )
    for tag in (*tags, *(["no_such_element"] if effect == "noted" else []))
]  # fmt: skip


@pytest.mark.parametrize(("row", "tag", "effect"), ROWS, ids=[f"{row}, {tag}" for row, tag, _ in ROWS])
def test_effects(row, tag, effect):
    """An element does what its row says: a note with its name, a refusal, or nothing; an unknown one is noted."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if effect == "refused":
            with pytest.raises(SceneError, match=f"{tag}.*closes a loop"):
                hf.load_urdf(with_element(row, tag), tip="tip", lock_others=True)
            return
        hf.load_urdf(with_element(row, tag), tip="tip", lock_others=True)
    said = [str(one.message) for one in caught if one.category is ModelWarning]
    assert len(said) == (effect == "noted")
    assert all(f", {tag}: " in one or f": {tag}: " in one for one in said), said


def test_what_is_off_needs_no_note():
    """A zero, or false, has no effect."""
    off = (
        "<kinematic>0</kinematic><velocity_decay><linear>0.0</linear></velocity_decay><enable_wind>false</enable_wind>"
    )
    assert not urdf_chain(
        robot(after=f'<gazebo reference="hand">{off}</gazebo>'), tip="hand", lock_others=True
    ).arm.notes
    gazebo = read_urdf(robot(after=f"<gazebo>{off}<static/></gazebo>")).element.first("gazebo")
    assert gazebo is not None
    assert [is_off(child) for child in gazebo.children] == [True, True, True, False]


@pytest.mark.parametrize("name", ["boundmass", "boundinertia", "settotalmass", "balanceinertia", "inertiafromgeom"])
def test_masses_that_mujoco_changes(name):
    """Settings of MuJoCo's compiler that change masses are noted; others are not."""
    text = robot(after=f'<mujoco><compiler {name}="1" meshdir="m"/></mujoco>')
    (note,) = read_urdf(text).notes
    assert f"compiler: {name}: changes masses" in note
    assert read_urdf(robot(after='<mujoco><compiler meshdir="m"/></mujoco>')).notes == ()


def test_within_a_sensor():
    """A sensor has no effect; what would have one elsewhere is noted."""
    sensor = '<sensor name="s"><update_rate>9</update_rate><imu><noise><mean>1</mean></noise></imu>{}</sensor>'
    for place in ("{}", '<gazebo reference="base">{}</gazebo>'):
        assert read_urdf(robot(after=place.format(sensor.format("")))).notes == ()
        found = read_urdf(robot(after=place.format(sensor.format("<a><springStiffness>3</springStiffness></a>"))))
        (note,) = [note for part in (found, *found.links.values()) for note in part.notes]
        assert "springStiffness: not read within a sensor" in note


def test_what_names_nothing():
    """A switch or a spring for a link or joint that is not there is noted; so is a rotor."""
    text = robot(
        after='<gazebo><turnGravityOff>true</turnGravityOff></gazebo><gazebo reference="wrst">'
        "<springStiffness>3</springStiffness></gazebo><transmission><joint name='wrst'/><actuator name='m'>"
        "<rotor_inertia>1e-4</rotor_inertia></actuator></transmission>"
    )
    gravity, spring, rotor = read_urdf(text).notes
    assert "gravity off: expected the name of a link" in gravity
    assert "no joint 'wrst'" in spring
    assert "no joint 'wrst'" in rotor


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
    with pytest.raises(
        hf.errors.SceneError, match=r"link 'base': expected one rigid body, got joints .* 'lift'; try link="
    ):
        hf.HeldObject.from_urdf(TWO_ARMED)
    with pytest.raises(hf.errors.SceneError, match=r"link: no link 'tary'. Did you mean 'tray'"):
        hf.HeldObject.from_urdf(TRAY, "tary")
    with pytest.raises(hf.errors.SceneError, match="link 'left_grasp': expected <inertial>"):
        hf.HeldObject.from_urdf(TWO_ARMED, "left_grasp")
    point = TRAY.replace("0.001", "0").replace("0.01", "0").replace("0.02", "0").replace('"05"', '"0"')
    with pytest.raises(hf.errors.SceneError, match="principal moments > 0"):
        hf.HeldObject.from_urdf(point, "cup")
