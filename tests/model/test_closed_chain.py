"""The whole chain: names, layout of flat arrays, and copies with one thing changed."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast import ClosedChain, Grasp, Pose
from holdfast.errors import ModelError
from holdfast.model.fingerprint import fingerprint
from holdfast.model.trunk import Trunk
from tests.model.parts import BOX, arm, chain


def test_layout():
    """Flat arrays follow the arms' order; grasps follow it too, however they were given."""
    grasps = {"c": Grasp("hinge"), "a": Grasp("softfinger")}
    made = ClosedChain({"a": arm(3), "b": arm(1), "c": arm(2)}, BOX, grasps)
    assert made.names == ("a", "b", "c")
    assert list(made.grasps) == ["a", "c"]
    assert made.joints == {"a": slice(0, 3), "b": slice(3, 4), "c": slice(4, 6)}
    assert made.contact_freedoms == {"a": slice(0, 2), "c": slice(2, 3)}
    assert (made.joint_count, made.contact_freedom_count, made.constraint_row_count) == (6, 3, 12)
    assert made.joint_names() == ["a/joint1", "a/joint2", "a/joint3", "b/joint1", "c/joint1", "c/joint2"]
    assert all(made.arms[name].name == name for name in made.names)


def test_defaults():
    """Standard gravity along -z; nobody need hold the object."""
    made = ClosedChain({"left": arm()}, BOX, {})
    np.testing.assert_array_equal(made.gravity, [0, 0, -9.81])
    assert (made.contact_freedoms, made.contact_freedom_count, made.constraint_row_count) == ({}, 0, 0)


def test_caller_keeps_his_dictionaries():
    """What the caller changes later does not reach the chain."""
    arms, grasps = {"left": arm()}, {"left": Grasp("ball")}
    made = ClosedChain(arms, BOX, grasps)
    arms["right"], grasps["left"] = arm(), Grasp("rigid")
    assert made.names == ("left",)
    assert made.grasps["left"].kind == "ball"


def test_with_bases():
    """Named arms are mounted elsewhere, the others and the original stay."""
    made = chain(left=2, right=2)
    moved = made.with_bases({"right": Pose.translation(1, 0, 0)})
    np.testing.assert_array_equal(moved.arms["right"].base.p, [1, 0, 0])
    assert moved.arms["left"].base.p[0] == made.arms["right"].base.p[0] == 0.0
    assert moved.grasps.keys() == made.grasps.keys()
    with pytest.raises(ModelError, match=r"base.*: expected finite numbers"):
        made.with_bases({"right": [1.0, 0, 0, 0, np.inf, 0, 0]})
    with pytest.raises(ModelError, match=r"'rihgt'.*Did you mean 'right'\?"):
        made.with_bases({"rihgt": Pose.identity()})


def test_without_grasp():
    """One grasp is opened, the arm stays; an unknown one is refused with a suggestion."""
    made = chain(left=2, right=3)
    opened = made.without_grasp("left")
    assert list(opened.grasps) == ["right"]
    assert opened.names == made.names
    assert list(made.grasps) == ["left", "right"]
    with pytest.raises(ModelError, match=r"grasp 'left': no such grasp\. Known: right\."):
        opened.without_grasp("left")
    with pytest.raises(ModelError, match=r"Did you mean 'right'\?"):
        made.without_grasp("rigth")


def test_with_grasp():
    """An open arm takes hold, in the arms' order; one that holds already, or does not exist, is refused."""
    made = chain(left=2, right=3).without_grasp("left")
    grasp = Grasp("hinge")
    closed = made.with_grasp("left", grasp)
    assert list(closed.grasps) == ["left", "right"]
    assert closed.grasps["left"] is grasp
    assert list(made.grasps) == ["right"]
    with pytest.raises(ModelError, match=r"grasp 'right': expected an arm without a grasp, got .* ball grasp"):
        made.with_grasp("right", grasp)
    with pytest.raises(ModelError, match=r"grasp 'lefft': no such arm\. Did you mean 'left'\?"):
        made.with_grasp("lefft", grasp)
    with pytest.raises(ModelError, match="grasp 'left': expected a Grasp, got str"):
        made.with_grasp("left", "hinge")


BODY = hf.Link(1.0, inertia=np.eye(3))
ONE = hf.Arm([hf.Joint()], [BODY])
TORSO = Trunk([hf.Joint(), hf.Joint()], [hf.Link(1.0, name="hip"), hf.Link(1.0, name="chest")])
SHIP = Trunk(floating=BODY)
CUBE = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)


def on_trunk(trunk=TORSO, mounts=None, arms=None):
    """Return a chain of two arms, the first of which holds."""
    arms = arms or {"left": ONE, "right": ONE}
    return hf.ClosedChain(arms, CUBE, {next(iter(arms)): hf.Grasp("rigid")}, trunk=trunk, mounts=mounts or {})


@pytest.mark.parametrize("mount", ["chest", 1])
def test_mounts_by_name_or_index(mount):
    """Both say the same link."""
    assert on_trunk(mounts={"left": mount}).mounted_on == {"left": 1}


def test_layout_with_a_trunk():
    """The trunk's joints come first in q; a floating base is not among them."""
    on_torso = on_trunk(mounts={"left": "chest"})
    assert on_torso.joints == {"trunk": slice(0, 2), "left": slice(2, 3), "right": slice(3, 4)}
    assert on_torso.joint_names() == ["trunk/joint1", "trunk/joint2", "left/joint1", "right/joint1"]
    assert (on_torso.joint_count, on_torso.velocity_count) == (4, 10)
    ship = on_trunk(SHIP, {"left": "base"})
    assert (ship.joint_count, ship.velocity_count, ship.floats) == (2, 14, True)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Trunk(), "at least one joint or a floating base"),
        (lambda: Trunk([hf.Joint()], []), "one link per joint"),
        (lambda: Trunk(floating=ONE), "floating: expected a Link"),
        (lambda: Trunk(3), "joints: expected a list"),
        (lambda: on_trunk(mounts={"left": "head"}), r"mount of 'left': .*'hip', 'chest'.*got 'head'"),
        (lambda: on_trunk(mounts={"left": 2}), r"index 0 .. 1"),
        (lambda: on_trunk(mounts={"left": "base"}), "mount of 'left'"),
        (lambda: on_trunk(mounts={"middle": 0}), "mount of 'middle': no such arm"),
        (lambda: on_trunk(None, {"left": 0}), "expected a trunk to mount 'left' on"),
        (lambda: on_trunk(ONE), "trunk: expected a Trunk or None, got Arm"),
        (
            lambda: replace(
                on_trunk(), springs=[hf.Spring(("world", [0, 0, 0]), ("trunk", "nowhere", [0, 0, 0]), 1.0)]
            ),
            "spring: point on 'trunk': expected a link of the trunk",
        ),
        (lambda: on_trunk(mounts=[1]), "expected mounts as a mapping"),
        (lambda: on_trunk(arms={"trunk": ONE}), "arm 'trunk': the name is reserved for the trunk"),
    ],
)
def test_refused_trunks(make, message):
    """Messages say what was expected."""
    with pytest.raises(hf.errors.ModelError, match=message):
        make()


def test_state_of_a_floating_base():
    """Its pose belongs to the state, and only there."""
    q = np.zeros(2)
    with pytest.raises(hf.errors.StateError, match="base_pose: expected the pose of the trunk's floating base"):
        hf.State(q, q, np.r_[1.0, np.zeros(6)]).fits(on_trunk(SHIP, {"left": "base"}))
    floating = hf.State(q, q, np.r_[1.0, np.zeros(6)], base_pose=hf.Pose.identity())
    np.testing.assert_array_equal(floating.base_twist, np.zeros(6))
    with pytest.raises(hf.errors.StateError, match="base_pose: expected none"):
        floating.fits(on_trunk(None))
    with pytest.raises(hf.errors.StateError, match="base_pose: expected a unit quaternion"):
        hf.State(q, q, np.r_[1.0, np.zeros(6)], base_pose=np.ones(7))
    with pytest.raises(hf.errors.StateError, match=r"base_twist: .*no base_pose"):
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
    with pytest.raises(hf.errors.StateError, match=message):
        hf.Inputs(**inputs).shaped(on_trunk(trunk, mounts))


def test_fingerprints_of_chains_without_a_trunk_stay():
    """The trunk has a part in a chain's fingerprint only where there is one."""
    plain = on_trunk(None)
    assert fingerprint(plain) != fingerprint(on_trunk())
    assert fingerprint(on_trunk(mounts={"left": 0})) != fingerprint(on_trunk(mounts={"left": 1}))
