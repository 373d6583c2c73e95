"""The Panda's published geometry, and what the model must not spoil."""

import numpy as np
import pytest

from holdfast import ModelError, Pose
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.posture import posture
from holdfast.robots import HOME, PANDA_HOME, ROBOTS, panda
from holdfast.robots.panda import FR3_ARMATURE
from holdfast.spatial import rotation


def test_stretched_flange():
    """At q = 0 the DH distances add up along the axes: 333 + 316 + 384 - 107 mm high."""
    tip = posture(panda(), np.zeros(7)).tip
    np.testing.assert_allclose(tip.p, [0.088, 0.0, 0.926], atol=1e-15)
    np.testing.assert_array_equal(tip.R, np.diag([1.0, -1.0, -1.0]))


def test_ready_posture_of_the_hand():
    """In the maker's ready posture the hand points down at (0.307, 0, 0.487), fingers along y."""
    hand = Pose(rotation.exp(np.array([0.0, 0.0, -np.pi / 4])), np.array([0.0, 0.0, 0.1034]))
    tip = posture(panda(tip=hand), PANDA_HOME).tip
    np.testing.assert_allclose(tip.p, [0.3069, 0.0, 0.4869], atol=5e-5)
    np.testing.assert_allclose(tip.R, np.diag([1.0, -1.0, -1.0]), atol=1e-15)


def test_right_angles_are_exact():
    """Every entry of every joint rotation is exactly 0, 1 or -1, so that it folds away."""
    for joint in panda().joints:
        assert set(np.abs(joint.placement.R).ravel()) <= {0.0, 1.0}
        assert not np.signbit(joint.placement.R[joint.placement.R == 0]).any()


def test_data():
    """16.06 kg without base, limits around the ready posture, no drive inertia unless given."""
    arm = panda()
    assert sum(link.mass for link in arm.links) == pytest.approx(16.062132)
    assert all(low < q < high for q, (low, high) in zip(PANDA_HOME, arm.position_limits, strict=True))
    assert [joint.effort_limit for joint in arm.joints] == [87.0] * 4 + [12.0] * 3
    assert [joint.rate_limit for joint in arm.joints] == [2.175] * 4 + [2.61] * 3
    np.testing.assert_array_equal(arm.armature, np.zeros(7))


def test_armature_adds_to_the_diagonal():
    """One number or seven; only the diagonal of M changes."""
    bare = mass_matrix(panda(), posture(panda(), PANDA_HOME))[0]
    for given in (0.25, FR3_ARMATURE):
        arm = panda(armature=given)
        added = mass_matrix(arm, posture(arm, PANDA_HOME))[0] - bare
        np.testing.assert_allclose(added, np.diag(np.broadcast_to(given, 7)), atol=1e-15)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"armature": -0.1}, "armature"),
        ({"armature": [0.1, 0.2]}, "panda: armature"),
        ({"armature": "heavy"}, "panda: armature"),
        ({"tip": [1.0, 0.0, 0.0]}, "panda: tip"),
        ({"base": "table"}, "base"),
    ],
)
def test_bad_options_are_named(options, named):
    """What cannot be is refused by name."""
    with pytest.raises(ModelError, match=named):
        panda(**options)


def test_robots_by_name():
    """Every robot has a home posture of its own length, within its limits, not writable."""
    assert ROBOTS.keys() == HOME.keys()
    for name, make in ROBOTS.items():
        arm = make(base=Pose.translation(1.0, 0.0, 0.0))
        assert HOME[name].shape == (arm.joint_count,)
        assert not HOME[name].flags.writeable
