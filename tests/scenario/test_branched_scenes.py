"""Scenes with grippers, loops, couplings and several objects, beside the same chains built in Python."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ClosureError, SceneError
from holdfast.scenario.build import parse_scene
from holdfast.scenario.robots import RobotFiles

PAGE = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text(encoding="utf-8")
(GRIPPER,) = re.findall(r"```toml\n(# gripper\.toml.*?)```", PAGE, re.DOTALL)

# A palletiser, whose hand stays level by a parallelogram, has a bag; a stool falls.
PARALLELOGRAM = """
simulation = { duration = 0.05, step = 0.01 }
wrenches = [{ of = "bag", force = [0, 0, 20] }]
grasps = [{ arm = "palletiser", frame = "cup", of = "bag", kind = "softfinger" }]

[objects.bag]
mass = 5.0
box = [0.3, 0.3, 0.2]
pose = { position = [0.3, 0, 1.5] }

[objects.stool]
mass = 2.0
sphere = 0.2
twist = [0, 0, 1, 0.5, 0, 0]

[[arms]]
name = "palletiser"
q = [0.0, 0.0, 0.0]
frames.cup = { link = "hand", position = [0.3, 0, 0] }

[[arms.joints]]
axis = [0, 1, 0]
position = [0, 0, 0.5]
link = { name = "upper", mass = 20.0, com = [0, 0, 0.5], box = [0.1, 0.1, 1.0] }

[[arms.joints]]
axis = [0, 1, 0]
position = [0, 0, 1.0]
actuated = false
link = { name = "hand", mass = 5.0, com = [0.3, 0, 0], box = [0.3, 0.1, 0.1] }

[[arms.joints]]
parent = "base"
axis = [0, 1, 0]
position = [0.2, 0, 0.5]
actuated = false
link = { name = "rod", mass = 4.0, com = [0, 0, 0.5], box = [0.05, 0.05, 1.0] }

[[loops]]
name = "level"
kind = "hinge"
a = "palletiser/rod"
b = "palletiser/hand"
position = [0.2, 0, 0]
rpy = [0, 0, 1.5707963267948966]
tip = { position = [0, 0, 1.0], rpy = [0, 0, 1.5707963267948966] }
"""


def scene(text: str) -> hf.scenario.build.Scenario:
    return parse_scene(text.encode(), "scene", "scene", RobotFiles())


def simulated(text: str) -> hf.simulation.Trajectory:
    found = scene(text)
    return hf.simulate(found.chain, found.state, found.controller, found.duration, found.step, **found.options)


@pytest.mark.slow
def test_gripper():
    """Fingers move alike, the grip is closed where the scene has the box, and the push's work becomes energy."""
    found = scene(GRIPPER)
    np.testing.assert_array_equal(found.state.object_pose[4:], [0.4, 0, 0.6])
    assert found.chain.beyond_serial and not found.notes
    run = simulated(GRIPPER)
    assert run.rows == ["left/pad1", "left/pad2"]
    np.testing.assert_allclose(run.q[:, 3], run.q[:, 4], atol=1e-12)
    assert run.position_gap[:, 1].max() < 1e-12
    assert abs(run.imbalance).max() < 1e-9 and run.kinetic.max() > 1e-3


def test_parallelogram_and_objects():
    """The hand stays level, what nobody holds falls, and the scene is the chain that one would write in Python."""
    found = scene(PARALLELOGRAM)
    chain = found.chain
    assert [*chain.free_objects] == ["bag", "stool"] and [*chain.loops] == ["level"]
    assert [joint.actuated for joint in chain.all_joints] == [True, False, False]
    turn = hf.Pose.from_rpy(0, 0, np.pi / 2).R
    level = hf.Closure(
        "palletiser/rod", "palletiser/hand", hf.Grasp("hinge", hf.Pose(turn, [0.2, 0, 0])), hf.Pose(turn, [0, 0, 1.0])
    )
    same = replace(chain, loops={"level": level})
    push = np.zeros((2, 6))
    push[0, 5] = 20.0
    pushed = hf.Inputs(object_wrench=push)
    one, other = (hf.forward_dynamics(x, found.state, np.zeros(3), inputs=pushed) for x in (chain, same))
    np.testing.assert_allclose(one.qdd, other.qdd, atol=1e-12)
    run = simulated(PARALLELOGRAM)
    np.testing.assert_allclose(run.q[:, 0] + run.q[:, 1], 0.0, atol=1e-12)
    t = run.t[-1]
    np.testing.assert_allclose(run.object_pose[-1, 1, 4:], [0.5 * t, 0, -0.5 * 9.81 * t**2], atol=1e-12)
    assert abs(run.imbalance).max() < 1e-6


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('frame = "pad2"', 'frame = "pad1"', r"\$\.grasps\[1\]\.frame: 'pad1' of arm 'left' has a grasp already"),
        ('parent = "palm"', 'parent = "plam"', r"\$\.arms\[0\].*plam.*palm"),
        ('kind = "prismatic"', 'kind = "screw"', r"\$\.arms\[0\]\.joints\[3\].*pitch"),
        ('link = "finger1", pos', 'link = "finger9", pos', r"\$\.arms\[0\]\.frames.*finger9.*finger2"),
        ('"left/finger2" = -1.0', '"left/finger9" = -1.0', r"finger9.*finger2"),
        ("-1.0 } }]", "-1.0 }, offset = 0.1, rates_only = true }]", r"\$\.couplings\[0\]\.offset: expected none"),
        ("wrenches = [{", 'wrenches = [{ of = "box",', r"\$\.wrenches\[0\]\.of: expected one of object, got 'box'"),
        ("q = [0.4, 0.4, 0.4", "q = [0.4, 0.4", r"\$\.arms\[0\]\.q: expected 5 joint positions"),
    ],
)
def test_refusals(old: str, new: str, message: str):
    assert old in GRIPPER
    with pytest.raises(SceneError, match=message):
        scene(GRIPPER.replace(old, new, 1))


def test_unreachable():
    with pytest.raises(ClosureError, match=r"\$\.object\.pose: cannot close"):
        scene(GRIPPER.replace("position = [0.4, 0, 0.6]", "position = [4.0, 0, 0.6]"))


def test_held_states():
    """Closing keeps poses and twists of objects on request, and then the joints follow these."""
    found = scene(GRIPPER)
    rng = np.random.default_rng(3)
    q = found.state.q + np.array([0.02, 0.02, 0.02, 0.002, 0.002]) * rng.standard_normal(5)
    moving = hf.State(q, np.zeros(5), found.state.object_pose, [0, 0.2, 0, 0.1, 0, 0.05])
    held = hf.close(found.chain, moving, hold_object=True)
    np.testing.assert_array_equal(held.object_pose, moving.object_pose)
    np.testing.assert_array_equal(held.object_twist, moving.object_twist)
    gaps = hf.dynamics.closure(found.chain, held).values()
    assert max(max(abs(gap.position).max(), abs(gap.velocity).max()) for gap in gaps) < 1e-12
    assert abs(held.qd[3] - held.qd[4]) < 1e-12
