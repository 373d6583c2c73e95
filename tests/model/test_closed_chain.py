"""The whole chain: names, layout of flat arrays, and copies with one thing changed."""

import numpy as np
import pytest

from holdfast import ClosedChain, Grasp, ModelError, Pose
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
