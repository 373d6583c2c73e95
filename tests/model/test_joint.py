"""Joints: what is accepted is normalised and frozen, what is not is refused by name."""

import dataclasses

import numpy as np
import pytest

from holdfast import Joint, ModelError, Pose
from holdfast.spatial import rotation

REFUSED = {
    "kind": ({"kind": "planar"}, r"joint 'elbow': kind: expected 'revolute' or 'prismatic', got 'planar'"),
    "axis length": ({"axis": [0, 0, 2]}, r"joint 'elbow': axis: expected a unit vector, got length 2"),
    "axis shape": ({"axis": [0, 1]}, r"joint 'elbow': axis: expected shape \(3,\)"),
    "axis text": ({"axis": "z"}, r"joint 'elbow': axis: expected numbers"),
    "placement": ({"placement": [1, 0, 0]}, r"joint 'elbow': placement"),
    "placement mirror": (
        {"placement": Pose.unchecked(-np.eye(3), np.zeros(3))},
        r"joint 'elbow': placement: rotation: expected",
    ),
    "placement nan": (
        {"placement": Pose.unchecked(np.eye(3), np.array([0, np.nan, 0]))},
        r"joint 'elbow': placement: position",
    ),
    "armature": ({"armature": -1e-9}, r"joint 'elbow': armature: expected >= 0, got -1e-09"),
    "damping": ({"damping": -1.0}, r"joint 'elbow': damping: expected >= 0"),
    "damping nan": ({"damping": np.nan}, r"joint 'elbow': damping: expected finite"),
    "friction": ({"friction": "rough"}, r"joint 'elbow': friction: expected a number"),
    "rate limit": ({"rate_limit": 0.0}, r"joint 'elbow': rate_limit: expected > 0, got 0.0"),
    "rate limit nan": ({"rate_limit": np.nan}, r"joint 'elbow': rate_limit"),
    "effort limit": ({"effort_limit": "87"}, r"joint 'elbow': effort_limit: expected a number, got '87'"),
    "limits reversed": (
        {"position_limits": (1, -1)},
        r"joint 'elbow': position_limits: expected lower <= upper, got 1",
    ),
    "limits nan": ({"position_limits": (np.nan, 1)}, r"joint 'elbow': position_limits: expected lower <= upper"),
    "three limits": ({"position_limits": (0, 1, 2)}, r"joint 'elbow': position_limits: expected two numbers"),
    "no limits": ({"position_limits": None}, r"joint 'elbow': position_limits: expected two numbers, got None"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refused(what):
    """A joint that cannot exist is refused; the message names joint, field and value."""
    given, message = REFUSED[what]
    with pytest.raises(ModelError, match=message):
        Joint(**given, name="elbow")


def test_defaults():
    """By default a frictionless revolute joint about z without limits."""
    joint = Joint()
    assert (joint.kind, joint.position_limits, joint.rate_limit) == ("revolute", (-np.inf, np.inf), np.inf)
    assert (joint.armature, joint.damping, joint.friction) == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(joint.axis, [0, 0, 1])


def test_numpy_numbers_are_numbers():
    """Limits read from an integer or single-precision array are accepted."""
    joint = Joint(rate_limit=np.float32(2.0), effort_limit=np.array([87])[0], position_limits=np.array([-1, 1]))
    assert (joint.rate_limit, joint.effort_limit, joint.position_limits) == (2.0, 87.0, (-1.0, 1.0))


def test_frozen():
    """Neither fields nor arrays can be changed, and the caller's array is not shared."""
    axis = np.array([1.0, 0.0, 0.0])
    joint = Joint(axis=axis, placement=[1, 0, 0, 0, 0.1, 0.2, 0.3])
    axis[:] = 7.0
    np.testing.assert_array_equal(joint.axis, [1, 0, 0])
    with pytest.raises(dataclasses.FrozenInstanceError):
        joint.armature = 1.0
    for array in (joint.axis, joint.placement.R, joint.placement.p):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize("q", [0.0, 0.3, -2.0, 100.0])
def test_rotation_parts(q):
    """R0 Rot(axis, q) = F + cos(q) C + sin(q) S."""
    axis = np.array([0.36, 0.48, 0.8])
    R0 = rotation.exp(np.array([0.4, -1.0, 0.2]))
    joint = Joint("revolute", axis, Pose(R0, np.zeros(3)))
    F, C, S = joint.rotation_parts
    np.testing.assert_allclose(F + np.cos(q) * C + np.sin(q) * S, R0 @ rotation.exp(q * axis), atol=5e-14)
    np.testing.assert_allclose(dataclasses.replace(joint, kind="prismatic").parent_shift, R0 @ axis, atol=1e-15)
