"""Serial arms: one link per joint, mountable, with tools."""

import numpy as np
import pytest

from holdfast import Arm, Joint, Link, ModelError, Pose
from tests.model.parts import arm, bar

REFUSED = {
    "none": ({"joints": [], "links": []}, r"arm 'left': expected at least one joint, got none"),
    "counts": ({"links": [bar()] * 2}, r"arm 'left': expected one link per joint, got 1 joints and 2 links"),
    "no list": ({"joints": Joint()}, r"arm 'left': joints: expected a list, got Joint"),
    "array": ({"links": np.zeros(3)}, r"arm 'left': links: expected a list, got ndarray"),
    "wrong joint": ({"joints": [bar()]}, r"arm 'left', joints\[0\]: expected a Joint, got Link"),
    "wrong link": ({"links": ["x"]}, r"arm 'left', links\[0\]: expected a Link, got str"),
    "tip": ({"tip": [0, 0, 1]}, r"arm 'left': tip \(wxyz_xyz\): expected shape \(7,\), got shape \(3,\)"),
    "tip quaternion": ({"tip": [2, 0, 0, 0, 0, 0, 1]}, r"arm 'left': tip: expected a unit quaternion .* got length 2"),
    "base": (
        {"base": Pose.unchecked(2 * np.eye(3), np.zeros(3))},
        r"arm 'left': base: rotation: expected a rotation matrix",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refused(what):
    """An arm that cannot exist is refused; the message names arm and part."""
    given, message = REFUSED[what]
    with pytest.raises(ModelError, match=message):
        Arm(**{"joints": [Joint()], "links": [bar()], "name": "left", **given})


def test_at():
    """`at` mounts a copy elsewhere, from a Pose or seven numbers; the original stays."""
    original = arm()
    for base in (Pose.translation(1, 2, 3), [1, 0, 0, 0, 1, 2, 3]):
        mounted = original.at(base)
        np.testing.assert_array_equal(mounted.base.p, [1, 2, 3])
        assert mounted.joints == original.joints
    np.testing.assert_array_equal(original.base.p, np.zeros(3))
    with pytest.raises(ModelError, match="base: expected a unit quaternion"):
        original.at(np.zeros(7))


def test_with_tip():
    """`with_tip` changes the tool only."""
    original = arm()
    tool = Pose.translation(0, 0, 0.1)
    np.testing.assert_array_equal(original.with_tip(tool).tip.p, tool.p)
    np.testing.assert_array_equal(original.tip.p, [0.5, 0, 0])
    with pytest.raises(ModelError, match="tip"):
        original.with_tip("hand")


def test_vectors_of_joint_data():
    """Armature, damping and limits, base to tip."""
    joints = [Joint(armature=0.1, damping=0.2, position_limits=(-1, 1)), Joint(armature=0.3, damping=0.4)]
    made = Arm(joints, [bar(), Link(1.0)])
    assert made.joint_count == 2
    np.testing.assert_array_equal(made.armature, [0.1, 0.3])
    np.testing.assert_array_equal(made.damping, [0.2, 0.4])
    np.testing.assert_array_equal(made.position_limits, [[-1, 1], [-np.inf, np.inf]])


@pytest.mark.parametrize("pose", [Pose.identity(), [1, 0, 0, 0, 0, 0, 0]], ids=["pose", "seven numbers"])
def test_frozen(pose):
    """Joints and links are tuples; tip and base are read-only however they were given."""
    made = Arm([Joint()], [bar()], tip=pose, base=pose)
    assert isinstance(made.joints, tuple)
    assert isinstance(made.links, tuple)
    for array in (made.tip.R, made.tip.p, made.base.R, made.base.p):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize("field", ["armature", "damping", "position_limits"])
def test_kept_vectors_are_read_only(field):
    """What is computed once and kept cannot be written: it would change the arm."""
    with pytest.raises(ValueError, match="read-only"):
        getattr(arm(), field)[0] = 1.0
