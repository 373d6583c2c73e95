"""Anchors: what they hold, what is refused by name, copies and texts of them, and assembling with them."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.model.fingerprint import fingerprint
from tests.control.two_pandas import two_pandas
from tests.model.parts import arm
from tests.systems.problems import largest_gaps

BOX = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)
PLACE = hf.Pose.from_rpy(0.1, 0.2, 0.3, [1.0, 2.0, 3.0])


def test_an_arm_without_joints():
    """It has a place in the chain and none in q; its tip is where it stands."""
    chain = hf.ClosedChain({"left": arm(2), "pin": hf.Anchor(PLACE)}, BOX, {"pin": hf.Grasp("ball")})
    pin = chain.arms["pin"]
    assert isinstance(pin, hf.Anchor) and isinstance(pin, hf.Arm)
    assert (pin.name, pin.joints, pin.links, pin.joint_count, pin.length) == ("pin", (), (), 0, 0.0)
    assert chain.joints["pin"] == slice(2, 2) and chain.joint_names() == ["left/joint1", "left/joint2"]
    assert pin.position_limits.shape == (0, 2)
    np.testing.assert_array_equal(hf.dynamics.tip_pose(pin, []).p, PLACE.p)
    assert hf.dynamics.link_poses(pin, []) == []
    assert hf.dynamics.joint_mass_matrix(pin, []).shape == (0, 0)
    assert hf.dynamics.tip_jacobian(pin, []).shape == (6, 0)


def test_moved_and_copied():
    """What moves an arm moves an anchor and leaves it one; texts and fingerprints are its own."""
    pin = hf.Anchor(PLACE, "pin")
    for other in (pin.at(hf.Pose.identity()), pin.with_tip(PLACE), pin.of(), replace(pin, name="other")):
        assert type(other) is hf.Anchor
    pickled = pickle.loads(pickle.dumps(pin))
    assert type(pickled) is hf.Anchor and fingerprint(pickled) == fingerprint(pin)
    assert fingerprint(pin.at(hf.Pose.identity())) != fingerprint(pin)
    assert repr(pin).startswith("<Anchor 'pin': base at ")
    lever = hf.Anchor(PLACE, tip=hf.Pose.translation(0.1, 0, 0))
    assert lever.length == 0.1
    np.testing.assert_allclose(hf.dynamics.tip_pose(lever, []).p, PLACE.p + 0.1 * PLACE.R[:, 0], rtol=1e-15)


def test_what_is_refused():
    """Places and names that are none, joints, and an arm that has lost its joints."""
    with pytest.raises(hf.ModelError, match="anchor: base "):
        hf.Anchor([1, 0, 0])
    with pytest.raises(hf.ModelError, match="anchor 'pin': tip "):
        hf.Anchor(PLACE, "pin", tip=3)
    with pytest.raises(hf.ModelError, match="anchor: name: expected str"):
        hf.Anchor(PLACE, 3)
    with pytest.raises(TypeError, match="joints"):
        hf.Anchor(PLACE, joints=[hf.Joint()])
    with pytest.raises(hf.ModelError, match=r"at least one joint, got none; try holdfast\.Anchor\(pose\)"):
        hf.Arm([], [])


def test_assembled():
    """Arms are brought to an object that an anchor pins, wherever that is; the report says so, and a miss is named."""
    chain, state = two_pandas()
    pin = hf.contact_frame([0, 0, 0.1], into=[0, 0, -1])
    at = state.object_frame @ pin
    arms, grasps = {**chain.arms, "pin": hf.Anchor(at)}, {**chain.grasps, "pin": hf.Grasp("ball", pin)}
    for given in (state.object_frame, None):
        found = hf.assemble(arms, chain.held_object, grasps, object_pose=given)
        assert largest_gaps(hf.dynamics.closure(*found))[0] < 1e-10
        (line,) = (line for line in str(found.report).splitlines() if line.startswith("pin:"))
        assert line.startswith("pin: an anchor, closed to ")
        assert found.report.arms[2].reach_used == 1.0
    with pytest.raises(hf.ClosureError, match="'pin' misses its grasp"):
        hf.assemble(arms, chain.held_object, grasps, object_pose=hf.Pose.translation(0, 0, 0.75))
    alone = hf.assemble({"pin": hf.Anchor(at)}, chain.held_object, {"pin": hf.Grasp("rigid", pin)})
    assert np.abs(alone.state.object_pose - state.object_pose).max() < 1e-12
    assert "an anchor" in str(alone.report)
