"""Tips whose z axis points another way than the hand: the angle is reported, with a turn that mends it."""

import itertools
import re

import numpy as np
import pytest

import holdfast as hf
from holdfast import Arm, Friction, Grasp, Joint, Link, Pose
from holdfast.io.typed import Location
from holdfast.model.tip_direction import advice_for, tip_advice, tip_angle, way_to_tip
from holdfast.robots import ROBOTS
from holdfast.scenario.joints import pose
from holdfast.scenario.table import PoseTable
from holdfast.spatial import rotation

ROD = Link(1.0, [0.0, 0.0, 0.1], np.diag([0.01, 0.01, 0.001]))
ATTITUDES = [
    np.column_stack([x, np.cross(z, x), z])
    for x, z in itertools.product(np.vstack([np.eye(3), -np.eye(3)]), repeat=2)
    if x @ z == 0
]


def wrist(tip: Pose, axis=(0.0, 0.0, 1.0), joint_at=(0.0, 0.0, 0.3)) -> Arm:
    """Return an arm whose last joint turns about an axis, 0.3 m beyond the first."""
    last = Joint("revolute", list(axis), Pose.translation(*joint_at))
    return Arm([Joint("revolute", [0.0, 1.0, 0.0]), last], [ROD, ROD], tip)


def mended(arm: Arm) -> list[Arm]:
    """Return the arm with its tip turned as the advice says, in Python and in a scene."""
    advice = tip_advice(arm)
    code = re.search(r"try (arm\.with_tip\(.*\)), in a scene", advice)
    angles = re.search(r"tip = { rpy = \[(.*)\] }", advice)
    assert code
    assert angles
    roll, pitch, yaw = (float(angle) for angle in angles[1].split(","))
    in_a_scene = arm.tip @ pose(PoseTable(rpy=(roll, pitch, yaw)), Location("scene"))
    return [eval(code[1], {"arm": arm, "hf": hf}), arm.with_tip(in_a_scene)]


@pytest.mark.parametrize("robot", ROBOTS)
def test_built_in_robots(robot):
    """Their tips point out of the hand; turned over, they are said to point back."""
    arm = ROBOTS[robot]()
    assert tip_angle(arm) == pytest.approx(0.0, abs=1e-7)
    assert tip_advice(arm) == ""
    back = arm.with_tip(arm.tip @ Pose.from_wxyz_xyz([0, 1, 0, 0, 0, 0, 0]))
    assert tip_angle(back) == pytest.approx(np.pi)
    assert "180 deg off" in tip_advice(back)


@pytest.mark.parametrize("R", ATTITUDES, ids=str)
@pytest.mark.parametrize("axis", np.eye(3), ids=["x", "y", "z"])
def test_every_attitude(R, axis):
    """However the frame lies on the flange: the angle is z's, and the suggested turn brings z along the way."""
    way = np.array([0.0, 0.0, 0.1])
    arm = wrist(Pose(R, way), axis)
    angle = float(np.arccos(R[2, 2]))
    assert tip_angle(arm) == pytest.approx(angle)
    assert bool(tip_advice(arm)) == (angle > 0.1)
    if angle > 0.1:
        assert f"is {np.degrees(angle):.0f} deg off" in tip_advice(arm)
        for turned in mended(arm):
            assert tip_angle(turned) == pytest.approx(0.0, abs=1e-7)
            assert turned.tip.p == pytest.approx(way)


def test_a_tip_on_the_last_joint():
    """As a UR's: outward is along that joint's axis, the way the arm comes to it; sideways and back are reported."""
    for turned, angle in (([0.0, 0.0, 0.0], 0.0), ([0.0, np.pi / 2, 0.0], 90.0), ([np.pi, 0.0, 0.0], 180.0)):
        arm = wrist(Pose(rotation.exp(np.array(turned)), np.zeros(3)))
        assert np.degrees(tip_angle(arm)) == pytest.approx(angle)
        assert bool(tip_advice(arm)) == (angle > 0)


def test_the_frame_of_a_joint():
    """A frame on a joint that the arm comes to across its axis is no hand: nothing is said."""
    arm = wrist(Pose.identity(), axis=(1.0, 0.0, 0.0))
    assert way_to_tip(arm) is None
    assert np.isnan(tip_angle(arm))
    assert tip_advice(arm) == ""


def test_an_angled_tool():
    """On a wrist that rolls, z along its axis is right, however far to the side the tool reaches."""
    assert tip_advice(wrist(Pose.translation(0.3, 0.0, 0.1))) == ""
    assert "180 deg" in tip_advice(wrist(Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.3, 0.0, 0.1]))))


def test_a_planar_arm():
    """Its z axes are its joints', across the way; the hand points along x."""
    arm = wrist(Pose.translation(0.2, 0.0, 0.0), joint_at=(0.3, 0.0, 0.0))
    assert "90 deg off the direction from the last joint to the tip, which is along its +x" in tip_advice(arm)


def test_grasps_that_feel_it():
    """A ball without friction does not feel how the tip is turned."""
    arm = wrist(Pose(rotation.exp(np.array([0.0, np.pi / 2, 0.0])), np.array([0.0, 0.0, 0.1])))
    assert advice_for(arm, Grasp("ball", Pose.identity())) == ""
    assert advice_for(arm, Grasp("ball", Pose.identity(), contact=Friction(0.5))) == tip_advice(arm) != ""
    assert advice_for(arm, Grasp("rigid", Pose.identity())) == tip_advice(arm)
