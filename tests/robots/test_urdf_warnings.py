"""The notes of a load reach whoever loads a file: one warning, and the report of `assemble`."""

import warnings

import pytest

import holdfast as hf
from holdfast.errors import ModelWarning
from holdfast.robots.urdf import urdf_chain
from tests.robots.extended_files import robot
from tests.robots.two_armed import TWO_ARMED

NOTED = robot(after='<gazebo reference="hand"><kinematic>1</kinematic><wind/></gazebo>')
LOADS = {
    "load_urdf": lambda text: hf.load_urdf(text, tip="tip", lock_others=True),
    "load_urdf_arms": lambda text: hf.load_urdf_arms(text, {"a": ("base", "tip")}, lock_others=True),
    "load_urdf_trunk": lambda text: hf.load_urdf_trunk(text, ["tip"], floating=True, lock_others=True),
}


@pytest.mark.parametrize("load", LOADS.values(), ids=LOADS)
def test_once_per_load(load):
    """One warning names every element, in the caller's line; a clean file gives none, whatever its tip."""
    with pytest.warns(ModelWarning) as caught:
        load(NOTED)
    (one,) = caught
    assert [line.partition(": ")[2] for line in str(one.message).splitlines()] == [
        "gazebo, kinematic: acts on the motion, but is not read",
        "gazebo, wind: acts on the motion, but is not read",
    ]
    assert one.filename == __file__
    with warnings.catch_warnings(action="error"):
        load(robot())
        load(robot().replace('<child link="tip"/>', '<child link="tip"/><origin rpy="0 1.5707963267948966 0"/>'))


def test_two_arms_in_one_warning():
    """Notes on what arms share are shown once."""
    arms = {side: ("torso", f"{side}_grasp") for side in ("left", "right")}
    with pytest.warns(ModelWarning) as caught:
        hf.load_urdf_arms(TWO_ARMED, arms, lock_others=True)
    (one,) = caught
    lines = str(one.message).splitlines()
    assert len(lines) == len({*lines})
    assert any("'left_" in line for line in lines)
    assert any("'right_" in line for line in lines)


def test_in_the_report():
    """`assemble` reports the notes of every arm and of the trunk, each once."""
    grasps = {"tip": hf.Grasp("rigid", hf.Pose.identity())}
    box = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)
    found = hf.load_urdf_trunk(NOTED, ["tip"], floating=True, lock_others=True)
    for parts in ({"arms": {"tip": hf.load_urdf(NOTED, tip="tip", lock_others=True)}},
                  {"arms": found.arms, "trunk": found.trunk, "mounts": found.mounts}):  # fmt: skip
        arms = parts.pop("arms")
        report = hf.assemble(arms, box, grasps, **parts).report
        assert [note.partition(": ")[2] for note in report.notes][:1] == [
            "gazebo, kinematic: acts on the motion, but is not read"
        ]
        assert str(report).count("  note: URDF text:1: gazebo, kinematic") == 1


def test_the_notes_stay_with_the_chain():
    """A chain has all notes, those on frames too, and gives no warning."""
    with warnings.catch_warnings(action="error"):
        found = urdf_chain(NOTED, tip="tip", lock_others=True)
    assert len(found.notes) == 3
    assert tuple(found.arm.notes) == found.notes[:2]
