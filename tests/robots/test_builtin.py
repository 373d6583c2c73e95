"""Every built-in robot is the one its maker describes."""

import numpy as np
import pytest

from holdfast import Arm, ModelError, Pose
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmInputs, arm_motion
from holdfast.robots import HOME, ROBOTS
from holdfast.robots.link_table import signed_axes
from holdfast.robots.recognise import BUILT_IN, builtin_of, home_of
from tests.robots.published import PUBLISHED

SOURCES_DIGITS = {"iiwa14": 1e-9, "ur5e": 2e-9, "gen3": 1e-9}  # the UR5e's file rounds pi/2 to 1.570796327
MASSES = {"panda": 16.062132, "iiwa14": 25.61, "ur5e": 17.7, "gen3": 6.4909}  # without base [kg]


@pytest.mark.parametrize(("name", "case"), [(name, k) for name, cases in PUBLISHED.items() for k in range(len(cases))])
def test_published_figures(name, case):
    """Tip pose, mass matrix and gravity torques are what Pinocchio finds from the source."""
    arm, figures, close = ROBOTS[name](), PUBLISHED[name][case], SOURCES_DIGITS[name]
    q = np.sin(1.0 + np.arange(arm.joint_count) + 10 * case)
    none = np.zeros(arm.joint_count)
    motion = arm_motion(ArmInputs(arm, q, none, none, np.zeros(6), np.array([0, 0, 0, 0, 0, 9.81])))
    M = mass_matrix(arm, motion.at)[0]
    assert motion.at.tip.p == pytest.approx(figures.tip, abs=close)
    assert motion.at.tip.R[:, 2] == pytest.approx(figures.z, abs=close)
    assert motion.at.tip.R[:, 0] == pytest.approx(figures.x, abs=close)
    assert np.diag(M) == pytest.approx(figures.diagonal, rel=close, abs=close)
    assert M[0] == pytest.approx(figures.first_row, abs=close)
    assert bias_torque(arm, motion.at, motion.bias.wrenches)[0] == pytest.approx(figures.weight, abs=100 * close)


@pytest.mark.parametrize("name", ROBOTS)
def test_data(name):
    """Weights, limits around the home posture, no drive inertia unless given, right angles exact."""
    arm = ROBOTS[name]()
    assert sum(link.mass for link in arm.links) == pytest.approx(MASSES[name])
    room = np.min([HOME[name] - arm.position_limits[:, 0], arm.position_limits[:, 1] - HOME[name]], axis=0)
    assert room.min() > 0.3
    assert all(0 < joint.effort_limit < np.inf and 0 < joint.rate_limit < np.inf for joint in arm.joints)
    assert not arm.armature.any()
    assert ROBOTS[name](armature=0.1).armature == pytest.approx(0.1)
    for joint in arm.joints:
        assert set(np.abs(joint.placement.R).ravel()) <= {0.0, 1.0}
        assert not np.signbit(joint.placement.R[joint.placement.R == 0]).any()


@pytest.mark.parametrize("name", ROBOTS)
def test_recognised_by_its_joints(name):
    """Name, tool, base and payload do not hide a robot; another joint does."""
    arm = ROBOTS[name](Pose.translation(1.0, 2.0, 3.0), Pose.translation(0.0, 0.0, 0.1))
    renamed = Arm(arm.joints, arm.links, arm.tip, arm.base, name="left")
    assert builtin_of(renamed).name == name
    assert home_of(renamed) is HOME[name]
    assert builtin_of(Arm(arm.joints[:-1], arm.links[:-1])) is None
    assert home_of(Arm(arm.joints[::-1], arm.links)) is None
    assert [robot.name for robot in BUILT_IN] == list(ROBOTS)


@pytest.mark.parametrize("name", ROBOTS)
def test_bad_options_are_named(name):
    """What cannot be is refused with the robot's name."""
    for options in ({"armature": [0.1, 0.2]}, {"tip": [1.0, 0.0, 0.0]}):
        with pytest.raises(ModelError, match=name):
            ROBOTS[name](**options)


def test_signed_axes():
    """A text of axes is the rotation whose columns it names."""
    assert (signed_axes("-x z y") == [[-1, 0, 0], [0, 0, 1], [0, 1, 0]]).all()
    assert np.linalg.det(signed_axes("x -z y")) == 1.0
