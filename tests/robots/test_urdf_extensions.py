"""What <gazebo>, <transmission>, <ros2_control> and elements of Drake say of the motion is read right, or refused."""

import re
import warnings

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelWarning, SceneError
from holdfast.robots.urdf import urdf_chain
from tests.robots.extended_files import ExtendedFile, files, robot, rotors, springs

QUANTITIES = ("armature", "stiffness", "rest", "damping", "friction")
FILES = files()


def test_there_are_enough():
    """Every kind of element is tried in several spellings."""
    counts = {kind: sum(file.name.startswith(kind) for file in FILES) for kind in ("rotor", "spring", "gravity")}
    assert min(counts.values()) >= 10


@pytest.mark.parametrize("file", FILES, ids=[file.name for file in FILES])
def test_read_or_refused(file: ExtendedFile):
    """The values are those that were written, by construction; without a warning, since nothing is left out."""
    if file.refused:
        with pytest.raises(SceneError, match=rf"URDF text:\d+: .*{re.escape(file.refused)}"):
            hf.load_urdf(file.text, tip="tip", lock_others=True)
        return
    with warnings.catch_warnings(action="error", category=ModelWarning):
        arm = hf.load_urdf(file.text, tip="tip", lock_others=True)
    for joint in arm.joints:
        truth = file.truth.get(joint.name, {})
        for quantity in QUANTITIES:
            assert getattr(joint, quantity) == pytest.approx(truth.get(quantity, 0.0), rel=1e-14), (
                joint.name,
                quantity,
            )


def test_a_rotor_and_a_spring_move_the_joint():
    """A joint with a rotor, a spring and a damper accelerates by Newton's law, written by hand."""
    J, n, k, rest, d = 1e-4, 100.0, 3.0, 0.2, 0.5
    said = rotors("elbow", J, n)["drake"] + springs("elbow", k, rest, d)["sdf axis"]
    arm = hf.load_urdf(robot(after=said), base="upper", tip="lower", locked={"wrist": 0.0, "pinch": 0.0})
    chain = hf.ClosedChain({"arm": arm}, hf.HeldObject.box(1.0, 0.1, 0.1, 0.1), {}, gravity=[0, 0, 0])
    state = hf.State([0.7], [0.4], [1, 0, 0, 0, 5, 0, 0])
    qdd = hf.forward_dynamics(chain, state, np.array([2.0])).qdd[0]
    links = 3 * 0.03 + 2 * (0.3**2 + 0.6**2)  # lower, hand and thumb about the elbow, welded
    assert qdd == pytest.approx((2.0 - k * (0.7 - rest) - d * 0.4) / (links + J * n**2), rel=1e-12)


LOOPS = {  # that tie the link {a} to the link {b}
    "sdf": '<gazebo><joint name="j" type="revolute"><parent>{a}</parent><child>{b}</child></joint></gazebo>',
    "sdf with the model's name": '<gazebo><joint name="j" type="ball"><parent>r::{a}</parent><child>r::{b}</child>'
    "</joint></gazebo>",
    "old gazebo": '<gazebo><joint:hinge name="j"><body1>{a}</body1><body2>{b}</body2></joint:hinge></gazebo>',
    "loop_joint": '<loop_joint name="j" type="spherical"><link1 link="{a}"/><link2 link="{b}"/></loop_joint>',
    "ball constraint": '<drake:ball_constraint><drake:ball_constraint_body_A name="{a}"/>'
    '<drake:ball_constraint_body_B name="{b}"/></drake:ball_constraint>',
    "bushing": '<frame name="fA" link="{a}" rpy="0 0 0" xyz="0 0 0"/><frame name="fC" link="{b}"/>'
    '<drake:linear_bushing_rpy><drake:bushing_frameA name="fA"/><drake:bushing_frameC name="fC"/>'
    '<drake:bushing_torque_stiffness value="1 2 3"/></drake:linear_bushing_rpy>',
    "spring between links": '<force_element name="j"><linear_spring_damper stiffness="9"><link1 link="{a}"/>'
    '<link2 link="{b}"/></linear_spring_damper></force_element>',
}


@pytest.mark.parametrize("loop", LOOPS.values(), ids=LOOPS)
def test_loops(loop):
    """Across a joint that moves, a loop is refused; within the locked hand, it is noted; elsewhere, it is nothing."""
    with pytest.raises(
        SceneError, match="closes a loop, which a serial arm cannot contain: it couples 'hand' and 'upper'"
    ):
        hf.load_urdf(robot(after=loop.format(a="upper", b="hand")), tip="tip", lock_others=True)
    with pytest.warns(ModelWarning, match="no effect between links that are locked together"):
        arm = hf.load_urdf(robot(after=loop.format(a="hand", b="thumb")), tip="tip", lock_others=True)
    assert arm.joint_count == 3
    with pytest.raises(SceneError, match="closes a loop"):
        hf.load_urdf(robot(after=loop.format(a="hand", b="thumb")), tip="thumb")
    onward = urdf_chain(robot(after=loop.format(a="base", b="upper")), base="upper", tip="tip", lock_others=True)
    assert not any("loop" in note for note in onward.notes)


def test_a_joint_to_the_world():
    """A base that Gazebo fixes in the world stands there anyway; a floating one would not float."""
    fixed = robot(after=LOOPS["sdf"].format(a="world", b="base"))
    assert hf.load_urdf(fixed, tip="tip", lock_others=True).joint_count == 3
    with pytest.raises(SceneError, match=r"closes a loop.* 'base' and 'world'"):
        hf.load_urdf_trunk(fixed, ["tip"], floating=True, lock_others=True)


def test_weight_on_request():
    """`physical=False` gives weight to a link for which the file switches gravity off, and notes it."""
    text = robot(after='<gazebo reference="hand"><turnGravityOff>true</turnGravityOff></gazebo>')
    with pytest.raises(SceneError, match="try physical=False, which gives it weight"):
        hf.load_urdf(text, tip="tip", lock_others=True)
    with pytest.warns(ModelWarning, match="gravity off for link 'hand': not read, it has weight"):
        arm = hf.load_urdf(text, tip="tip", lock_others=True, physical=False)
    assert arm.links[-1].mass == 4.0


def test_couplings_of_joints():
    """A joint that follows another in SDF is refused where it moves, and nothing where both are locked."""
    mimic = '<gazebo reference="pinch"><axis><mimic joint="elbow"><multiplier>2</multiplier></mimic></axis></gazebo>'
    with pytest.raises(SceneError, match=r"closes a loop.* 'elbow' and 'pinch'"):
        hf.load_urdf(robot(after=mimic), tip="tip", lock_others=True)
    locked = hf.load_urdf(robot(after=mimic), tip="tip", locked={"elbow": 0.1, "pinch": 0.2})
    assert locked.joint_count == 2


def test_types_of_drake():
    """A joint of a type of Drake's own is refused on the way to the tip, and locked with a note in the hand."""
    text = robot().replace('<joint name="pinch" type="continuous"', '<drake:joint name="pinch" type="universal"')
    head, _, tail = text.partition('<drake:joint name="pinch"')
    text = head + '<drake:joint name="pinch"' + tail.replace("</joint>", "</drake:joint>", 1)
    with pytest.warns(ModelWarning, match="joint 'pinch': drake:universal, locked in the pose of its <origin>"):
        arm = hf.load_urdf(text, tip="tip", lock_others=True)
    assert arm.links[-1].mass == 4.0
    with pytest.raises(SceneError, match="one degree of freedom between base and tip, got 'drake:universal'"):
        hf.load_urdf(text, tip="thumb", lock_others=True)
