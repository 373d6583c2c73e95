"""Every built-in robot is the one its maker describes."""

import numpy as np
import pytest

from holdfast import Arm, ClosedChain, Pose, State, close, robots
from holdfast.dynamics import closure, object_mobility
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.rank import constraint_rank
from holdfast.errors import ModelError
from holdfast.robots import HOME, ROBOTS, panda, stewart_platform, three_finger_hand
from holdfast.robots.built_in import BUILT_IN, builtin_of, home_of
from holdfast.robots.link_table import signed_axes
from holdfast.robots.panda import FR3_ARMATURE
from holdfast.spatial import rotation
from tests.robots.arm_dynamics import mass_jacobian_bias
from tests.robots.published import PUBLISHED
from tests.systems.problems import largest_gaps

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
def test_home_by_name(name):
    """The constants of an earlier version are gone; the error names the entry of the table."""
    with pytest.raises(AttributeError, match=rf'Did you mean .HOME\["{name}"\]'):
        getattr(robots, f"{name.upper()}_HOME")


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


def at_rest(parts, height):
    """Return chain and closed state with all joints near the middle of their ranges."""
    chain = ClosedChain(*parts)
    q = np.concatenate([arm.position_limits.mean(axis=1) for arm in chain.arms.values()])
    return chain, close(chain, State(q, 0 * q, [1, 0, 0, 0, 0, 0, height]))


def test_platform_is_closed_at_zero():
    """All joints at 0 hold the platform level at 0.45 m, without any closing."""
    chain = ClosedChain(*stewart_platform())
    state = State(np.zeros(18), np.zeros(18), [1, 0, 0, 0, 0, 0, 0.45])
    assert largest_gaps(closure(chain, state))[0] < 1e-15


@pytest.mark.parametrize(("parts", "height"), [(stewart_platform(), 0.45), (three_finger_hand(), 0.08)])
def test_six_mobilities_all_of_the_object(parts, height):
    """Full rank, as many mobilities as the object has, and it can be moved along each."""
    chain, state = at_rest(parts, height)
    rank = constraint_rank(chain, state)
    assert rank == chain.constraint_row_count
    assert chain.joint_count + 6 + chain.contact_freedom_count - rank == 6
    mobility = object_mobility(chain, state)
    size = np.sqrt(np.diag(mobility))
    assert np.linalg.eigvalsh(mobility / np.outer(size, size))[0] > 1e-4


def test_fingers_press_inward():
    """Contact normals point at the ball's middle, from fingertips that lie outside."""
    for grasp in three_finger_hand().grasps.values():
        assert grasp.frame.R[:, 2] == pytest.approx(-grasp.frame.p / 0.035, abs=1e-15)
    chain, state = at_rest(three_finger_hand(), 0.08)
    assert state.object_pose[4:6] == pytest.approx([0, 0], abs=1e-12)
    low, high = np.concatenate([arm.position_limits for arm in chain.arms.values()]).T
    assert np.minimum(state.q - low, high - state.q).min() > 0.3


def test_sizes():
    """Payload and radius are the caller's; impossible ones are refused."""
    assert stewart_platform(payload=7.0).held_object.mass == 7.0
    assert three_finger_hand(radius=0.03).grasps["finger1"].frame.p == pytest.approx([0.03, 0, 0])
    for make in (lambda: stewart_platform(-1.0), lambda: three_finger_hand(mass=0.0)):
        with pytest.raises(ModelError, match="mass"):
            make()
