"""Trunks and mounts: what a model takes, and what it refuses by name."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.model.fingerprint import fingerprint
from holdfast.model.trunk import Trunk

BODY = hf.Link(1.0, inertia=np.eye(3))
ARM = hf.Arm([hf.Joint()], [BODY])
TORSO = Trunk([hf.Joint(), hf.Joint()], [hf.Link(1.0, name="hip"), hf.Link(1.0, name="chest")])
SHIP = Trunk(floating=BODY)
BOX = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)


def chain(trunk=TORSO, mounts=None, arms=None):
    """Return a chain of two arms, the first of which holds."""
    arms = arms or {"left": ARM, "right": ARM}
    return hf.ClosedChain(arms, BOX, {next(iter(arms)): hf.Grasp("rigid")}, trunk=trunk, mounts=mounts or {})


@pytest.mark.parametrize("mount", ["chest", 1])
def test_mounts_by_name_or_index(mount):
    """Both say the same link."""
    assert chain(mounts={"left": mount}).mounted_on == {"left": 1}


def test_layout():
    """The trunk's joints come first in q; a floating base is not among them."""
    on_torso = chain(mounts={"left": "chest"})
    assert on_torso.joints == {"trunk": slice(0, 2), "left": slice(2, 3), "right": slice(3, 4)}
    assert on_torso.joint_names() == ["trunk/joint1", "trunk/joint2", "left/joint1", "right/joint1"]
    assert (on_torso.joint_count, on_torso.velocity_count) == (4, 10)
    ship = chain(SHIP, {"left": "base"})
    assert (ship.joint_count, ship.velocity_count, ship.floats) == (2, 14, True)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Trunk(), "at least one joint or a floating base"),
        (lambda: Trunk([hf.Joint()], []), "one link per joint"),
        (lambda: Trunk(floating=ARM), "floating: expected a Link"),
        (lambda: Trunk(3), "joints: expected a list"),
        (lambda: chain(mounts={"left": "head"}), r"mount of 'left': .*'hip', 'chest'.*got 'head'"),
        (lambda: chain(mounts={"left": 2}), r"index 0 .. 1"),
        (lambda: chain(mounts={"left": "base"}), "mount of 'left'"),
        (lambda: chain(mounts={"middle": 0}), "mount of 'middle': no such arm"),
        (lambda: chain(None, {"left": 0}), "expected a trunk to mount 'left' on"),
        (lambda: chain(ARM), "trunk: expected a Trunk or None, got Arm"),
        (
            lambda: replace(chain(), springs=[hf.Spring(("world", [0, 0, 0]), ("trunk", "nowhere", [0, 0, 0]), 1.0)]),
            "spring: point on 'trunk': expected a link of the trunk",
        ),
        (lambda: chain(mounts=[1]), "expected mounts as a mapping"),
        (lambda: chain(arms={"trunk": ARM}), "arm 'trunk': the name is reserved for the trunk"),
    ],
)
def test_refused(make, message):
    """Messages say what was expected."""
    with pytest.raises(hf.ModelError, match=message):
        make()


def test_state_of_a_floating_base():
    """Its pose belongs to the state, and only there."""
    q = np.zeros(2)
    with pytest.raises(hf.StateError, match="base_pose: expected the pose of the trunk's floating base"):
        hf.State(q, q, np.r_[1.0, np.zeros(6)]).fits(chain(SHIP, {"left": "base"}))
    floating = hf.State(q, q, np.r_[1.0, np.zeros(6)], base_pose=hf.Pose.identity())
    np.testing.assert_array_equal(floating.base_twist, np.zeros(6))
    with pytest.raises(hf.StateError, match="base_pose: expected none"):
        floating.fits(chain(None))
    with pytest.raises(hf.StateError, match="base_pose: expected a unit quaternion"):
        hf.State(q, q, np.r_[1.0, np.zeros(6)], base_pose=np.ones(7))
    with pytest.raises(hf.StateError, match=r"base_twist: .*no base_pose"):
        hf.State(q, q, np.r_[1.0, np.zeros(6)], base_twist=np.ones(6))


@pytest.mark.parametrize(
    ("trunk", "inputs", "message"),
    [
        (None, {"trunk_base_twist": np.ones(6)}, "the chain has no trunk"),
        (SHIP, {"trunk_base_twist": np.ones(6)}, "the trunk's base floats"),
        (TORSO, {"trunk_base_twist": np.ones(5)}, "trunk_base_twist"),
        (TORSO, {"trunk_link_wrenches": np.ones((3, 6))}, "trunk_link_wrenches"),
        (TORSO, {"base_twists": np.ones((2, 6))}, "arm 'left' moves with the trunk"),
        (TORSO, {"link_wrenches": np.ones((4, 6))}, "link_wrenches"),
    ],
)
def test_inputs_refused(trunk, inputs, message):
    """What has no place is named."""
    mounts = {} if trunk is None else {"left": "base" if trunk is SHIP else 0}
    with pytest.raises(hf.StateError, match=message):
        hf.Inputs(**inputs).shaped(chain(trunk, mounts))


def test_fingerprints_of_chains_without_a_trunk_stay():
    """The trunk has a part in a chain's fingerprint only where there is one."""
    plain = chain(None)
    assert fingerprint(plain) != fingerprint(chain())
    assert fingerprint(chain(mounts={"left": 0})) != fingerprint(chain(mounts={"left": 1}))
