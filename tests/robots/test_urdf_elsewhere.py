"""What is wrong elsewhere in a file does not block an arm: it is locked and noted; on the way it is refused."""

import re

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelWarning, SceneError
from tests.robots.extended_files import robot

WHEEL = '<joint name="pinch" type="continuous">'  # the joint that hangs on the hand
LIMIT = '<limit effort="9" velocity="9"/>'


def changed(old: str, new: str, kind: str = "continuous") -> str:
    """Return the robot with something changed in the joint that hangs on its hand."""
    text = robot(finger=kind)
    head, mark, tail = text.partition(f'<joint name="pinch" type="{kind}">')
    assert old in tail
    return head + mark + tail.replace(old, new, 1)


FAULTS = [
    (LIMIT, '<limit effort="9" velocity="-1"/>', "velocity: expected >= 0, got -1.0"),
    (LIMIT, '<limit effort="-9" velocity="1"/>', "effort: expected >= 0, got -9.0"),
    (LIMIT, '<limit lower="1" upper="-1" effort="9" velocity="1"/>', "expected lower <= upper, got 1 and -1"),
    (LIMIT, '<limit effort="nine" velocity="1"/>', "effort: expected a number, got 'nine'"),
    (LIMIT, LIMIT + '<dynamics damping="-1"/>', "damping: expected >= 0, got -1.0"),
    ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "xyz: expected a direction, got 0 0 0"),
    (LIMIT, LIMIT + '<mimic joint="wrist" multiplier="two"/>', "multiplier: expected a number, got 'two'"),
]


@pytest.mark.parametrize(("old", "new", "said"), FAULTS, ids=[said for _, _, said in FAULTS])
def test_a_wheel_with_a_fault(old, new, said):
    """Locked and noted under `lock_others`, noted where it is not part of the arm, refused where it moves."""
    text = changed(old, new, kind="revolute")
    noted = pytest.warns(ModelWarning, match=rf"URDF text:1: joint 'pinch'.*{re.escape(said)}; not read")
    with noted:
        arm = hf.load_urdf(text, tip="hand", lock_others=True)
    assert (arm.joint_count, arm.links[-1].mass) == (3, 4.0)
    with pytest.warns(ModelWarning, match=re.escape(said)):
        assert hf.load_urdf(text, base="hand", tip="base").joint_count == 3
    with pytest.raises(SceneError, match=re.escape(said)):
        hf.load_urdf(text, tip="thumb")
    with pytest.raises(SceneError, match=re.escape(said)):
        hf.load_urdf(text, tip="hand", locked={"pinch": 0.3})


MIMICS = [
    ('<mimic joint="pnch2"/>', {}, "mimic: no joint 'pnch2'; locked at 0"),
    ('<mimic joint="pinch"/>', {}, ""),  # itself
    ('<mimic joint="at" offset="0.3"/>', {}, ""),  # a fixed joint
]


@pytest.mark.parametrize(("mimic", "options", "said"), MIMICS, ids=[mimic for mimic, _, _ in MIMICS])
def test_a_finger_that_follows_nothing(mimic, options, said, recwarn):
    """A finger whose leader is not there, or does not move, is locked with the gripper."""
    arm = hf.load_urdf(changed(LIMIT, LIMIT + mimic), tip="hand", lock_others=True, **options)
    assert arm.joint_count == 3
    assert [one for one in recwarn if said and said in str(one.message)] or not said
    tilt = 0.3 if "offset" in mimic else 0.0
    mass_centre = 0.5 * 0.0 + 0.5 * 0.3  # of the thumb, whose own is on its axis
    assert arm.links[-1].com == pytest.approx([0.0, 0.0, mass_centre])
    I = np.diag([0.03, 0.03, 0.02])
    R = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    welded = I + R @ I @ R.T + 2 * 2 * 0.15**2 * np.diag([1, 1, 0])
    assert arm.links[-1].inertia == pytest.approx(welded)


def test_a_finger_that_follows_the_arm():
    """It cannot be locked by `lock_others`, and the message says why."""
    text = changed(LIMIT, LIMIT + '<mimic joint="wrist"/>')
    why = "hangs on the arm but is not between base and tip, and mimics 'wrist', which moves, so that lock_others"
    with pytest.raises(SceneError, match=why):
        hf.load_urdf(text, tip="hand", lock_others=True)


def test_a_joint_on_the_way_that_follows_a_locked_one():
    """It is locked, too, which is said."""
    mimic = changed(LIMIT, LIMIT).replace('<joint name="wrist" type="continuous">', "{}<mimic joint='pinch'/>")
    text = mimic.format('<joint name="wrist" type="continuous">')
    with pytest.warns(ModelWarning, match="joint 'wrist': locked at 0, since it mimics 'pinch', which is locked"):
        assert hf.load_urdf(text, tip="hand", lock_others=True).joint_count == 2


@pytest.mark.parametrize("kind", ["ball", "spherical"])
def test_a_finger_on_a_ball(kind):
    """A joint with several degrees of freedom in the gripper is locked where it is."""
    with pytest.warns(ModelWarning, match=f"joint 'pinch': {kind}, locked in the pose of its <origin>"):
        assert hf.load_urdf(robot(finger=kind), tip="hand", lock_others=True).joint_count == 3
    with pytest.raises(SceneError, match="expected a joint that can be locked"):
        hf.load_urdf(robot(finger="floating"), tip="hand", lock_others=True)


def antenna(moments: str) -> str:
    """Return the robot with an antenna on its base."""
    inertial = f'<inertial><mass value="0.01"/><inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial>'
    return robot(
        after=f'<link name="antenna">{inertial}</link><joint name="mast" type="fixed"><parent link="base"/>'
        '<child link="antenna"/><origin xyz="0 0 0.1"/></joint>'
    )


@pytest.mark.parametrize("physical", [True, False])
def test_one_antenna(physical):
    """An impossible inertia far below that of its body is used as it stands, and noted by name."""
    moments = 'ixx="-3e-8" iyy="2e-6" izz="2e-6"'
    with pytest.warns(ModelWarning, match="link 'antenna', inertial: inertia: .* moments -3e-08, 2e-06, 2e-06; used"):
        found = hf.load_urdf_trunk(antenna(moments), ["tip"], floating=True, lock_others=True, physical=physical)
    base = found.trunk.floating
    assert base is not None
    shift = 2 * 0.01 / 2.01 * 0.1**2  # about the common mass centre
    assert base.inertia == pytest.approx(np.diag([0.03 + shift - 3e-8, 0.03 + shift + 2e-6, 0.02 + 2e-6]), abs=1e-12)
    assert any("antenna" in note for note in found.notes)


def test_an_impossible_body():
    """What matters is refused, and so is an antenna that moves alone."""
    with pytest.raises(SceneError, match="link 'antenna', inertial: inertia: expected principal moments >= 0"):
        hf.load_urdf_trunk(antenna('ixx="-3e-5" iyy="2e-5" izz="2e-5"'), ["tip"], floating=True, lock_others=True)
    alone = antenna('ixx="-3e-8" iyy="2e-6" izz="2e-6"').replace(
        'name="mast" type="fixed"', 'name="mast" type="continuous"'
    )
    with pytest.raises(SceneError, match="link 'antenna'"):
        hf.load_urdf(alone, tip="antenna")


def test_a_link_without_inertia():
    """A mass without an inertia is refused on a body that moves, and is nothing on the base."""
    cut = re.sub(r"<inertia [^>]*/>", "", robot(), count=1)
    assert hf.load_urdf(cut, tip="hand", lock_others=True).joint_count == 3
    with pytest.raises(SceneError, match="link 'base', inertial: expected <inertia>, got none"):
        hf.load_urdf_trunk(cut, ["tip"], floating=True, lock_others=True)


MACROS = (
    '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="m" params="p"><link name="${p}"/>{}</robot>'
)


def test_macros_only(tmp_path):
    """The message names the reason, for the file itself and for what is left of it after expansion."""
    pytest.importorskip("xacrodoc", reason="needs xacrodoc: pip install xacrodoc")
    path = tmp_path / "macros.xacro"
    path.write_text(MACROS.replace("{}", "</xacro:macro>"))
    why = "contains macros only and calls none; try to load the file that calls them"
    with pytest.raises(SceneError, match=why):
        hf.load_urdf(path, trust_xacro=True)
    with pytest.raises(SceneError, match=why):
        hf.load_urdf('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"/>')
    with pytest.raises(SceneError, match=r"at least one <link>, got none$"):
        hf.load_urdf("<robot/>")
