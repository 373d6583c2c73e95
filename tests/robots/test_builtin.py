"""Every built-in robot is the one its maker describes."""

import numpy as np
import pytest

from holdfast import Arm, ModelError, Pose
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.robots import HOME, ROBOTS, panda
from holdfast.robots.built_in import BUILT_IN, builtin_of, home_of
from holdfast.robots.link_table import signed_axes
from holdfast.robots.panda import FR3_ARMATURE
from holdfast.spatial import rotation
from tests.robots.arm_dynamics import mass_jacobian_bias
from tests.robots.published import PUBLISHED

SOURCES_DIGITS = {"iiwa14": 1e-9, "ur5e": 2e-9, "gen3": 1e-9}  # the UR5e's file rounds pi/2 to 1.570796327
MASSES = {"panda": 16.062132, "iiwa14": 25.61, "ur5e": 17.7, "gen3": 6.4909}  # without base [kg]


@pytest.mark.parametrize(("name", "case"), [(name, k) for name, cases in PUBLISHED.items() for k in range(len(cases))])
def test_published_figures(name, case):
    """Tip pose, mass matrix and gravity torques are what Pinocchio finds from the source."""
    arm, figures, close = ROBOTS[name](), PUBLISHED[name][case], SOURCES_DIGITS[name]
    q = np.sin(1.0 + np.arange(arm.joint_count) + 10 * case)
    tip, (M, _, weight) = forward_kinematics(arm, q).tip, mass_jacobian_bias(arm, q, 0 * q)
    assert tip.p == pytest.approx(figures.tip, abs=close)
    assert tip.R[:, 2] == pytest.approx(figures.z, abs=close)
    assert tip.R[:, 0] == pytest.approx(figures.x, abs=close)
    assert np.diag(M) == pytest.approx(figures.diagonal, rel=close, abs=close)
    assert M[0] == pytest.approx(figures.first_row, abs=close)
    assert weight == pytest.approx(figures.weight, abs=100 * close)


@pytest.mark.parametrize("name", ROBOTS)
def test_data(name):
    """Weights, limits around the home configuration, no drive inertia unless given, right angles exact."""
    arm = ROBOTS[name]()
    assert HOME[name].shape == (arm.joint_count,) and not HOME[name].flags.writeable
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
    for options in ({"armature": [0.1, 0.2]}, {"armature": "heavy"}, {"tip": [1.0, 0.0, 0.0]}):
        with pytest.raises(ModelError, match=f"{name}: {next(iter(options))}"):
            ROBOTS[name](**options)
    for option, value in (("armature", -0.1), ("base", "table")):
        with pytest.raises(ModelError, match=option):
            ROBOTS[name](**{option: value})


def test_the_pandas_published_geometry():
    """At q = 0 the DH distances add up: 333 + 316 + 384 - 107 mm; ready, the hand is at (0.307, 0, 0.487), down."""
    tip = forward_kinematics(panda(), np.zeros(7)).tip
    np.testing.assert_allclose(tip.p, [0.088, 0.0, 0.926], atol=1e-15)
    np.testing.assert_array_equal(tip.R, np.diag([1.0, -1.0, -1.0]))
    hand = Pose(rotation.exp(np.array([0.0, 0.0, -np.pi / 4])), np.array([0.0, 0.0, 0.1034]))
    tip = forward_kinematics(panda(tip=hand), HOME["panda"]).tip
    np.testing.assert_allclose(tip.p, [0.3069, 0.0, 0.4869], atol=5e-5)
    np.testing.assert_allclose(tip.R, np.diag([1.0, -1.0, -1.0]), atol=1e-15)
    assert [joint.effort_limit for joint in panda().joints] == [87.0] * 4 + [12.0] * 3
    assert [joint.rate_limit for joint in panda().joints] == [2.175] * 4 + [2.61] * 3


def test_armature_adds_to_the_diagonal():
    """One number or seven; only the diagonal of M changes."""
    still = np.zeros(7)
    for given in (0.25, FR3_ARMATURE):
        added = mass_jacobian_bias(panda(armature=given), HOME["panda"], still)[0]
        added = added - mass_jacobian_bias(panda(), HOME["panda"], still)[0]
        np.testing.assert_allclose(added, np.diag(np.broadcast_to(given, 7)), atol=1e-15)


def test_signed_axes():
    """A text of axes is the rotation whose columns it names."""
    assert (signed_axes("-x z y") == [[-1, 0, 0], [0, 0, 1], [0, 1, 0]]).all()
