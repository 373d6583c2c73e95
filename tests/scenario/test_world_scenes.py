"""Scenes in which the object touches the world, beside closed forms."""

import re
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import SceneError
from holdfast.scenario.build import Scenario, parse_scene
from holdfast.scenario.robots import RobotFiles

PAGE = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text(encoding="utf-8")
(SLIDE,) = re.findall(r"```toml\n(# slide\.toml.*?)```", PAGE, re.DOTALL)


def scene(text: str) -> Scenario:
    return parse_scene(text.encode(), "scene", "scene", RobotFiles())


@pytest.mark.parametrize(
    ("contacts", "close"), [("events", 1e-12), pytest.param("steps", 1e-3, marks=pytest.mark.slow)]
)
def test_slides_and_stops(contacts: str, close: float):
    """A box comes to rest after v / mu g, v^2 / 2 mu g further."""
    found = scene(SLIDE.replace("step = 0.01", f'step = 0.01, contacts = "{contacts}"'))
    run = hf.simulate(found.chain, found.state, found.controller, found.duration, found.step, **found.options)
    np.testing.assert_allclose(run.object_pose[-1, 4:], [0.25 / 9.81, 0.0, 0.45], atol=close)
    if contacts == "events":
        (stop,) = {one.t for one in run.occurrences if one.kind == "stick"}
        assert stop == pytest.approx(1.0 / 9.81, abs=1e-12)


def test_shapes():
    """Every type of shape becomes the shape of that kind, with its numbers and its place."""
    shapes = """[
        { name = "floor", type = "half_space", normal = [0, 1, 0], offset = 0.1, friction = 0.3, restitution = 0.2 },
        { name = "ball", type = "sphere", radius = 0.2, pose = { position = [1, 2, 3] } },
        { name = "hole", type = "cylinder", radius = 0.3, inside = true },
        { name = "funnel", type = "cone", angle = 0.5, inside = true, surface_twist = [0, 0, 1, 0, 0, 0] },
        { name = "block", type = "box", half = [1, 2, 3], edge = 0.01 },
    ]"""
    text = re.sub(r"world = .*", f"world = {shapes}", SLIDE).replace("[0, 0, 0.45]", "[0, 0, 100]")
    text = text.replace(
        'points = "corners"', 'points = { tip = [0, 0, -0.05] }, radius = 0.01, pairs = [["tip", "hole"]]'
    )
    touching = scene(text).chain.touching
    assert touching is not None
    floor, ball, hole, funnel, block = touching.world.values()
    assert isinstance(floor, hf.world.HalfSpace) and (floor.offset, floor.friction, floor.restitution) == (
        0.1,
        0.3,
        0.2,
    )
    assert isinstance(ball, hf.world.Ball) and ball.pose.p.tolist() == [1, 2, 3]
    assert isinstance(hole, hf.world.Cylinder) and hole.inside
    assert isinstance(funnel, hf.world.Cone) and funnel.surface_twist[2] == 1.0
    assert isinstance(block, hf.world.Box) and block.edge == 0.01
    assert touching.names == ("tip/hole",) and touching.points["tip"].radius == 0.01


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("world = [", "others = [", "others"),
        ('touching = { points = "corners" }', "", r"\$\.world: expected object\.touching"),
        (re.search(r"world = .*", SLIDE)[0], "world = []", r"\$\.arms: expected at least one arm, or shapes"),
        ("box = [0.2, 0.2, 0.1]", "sphere = 0.1", r"\$\.object\.touching\.points: expected points by name"),
        ("friction = 0.5", "friction = -0.5", r"\$\.world\[0\]\.friction: expected >= 0"),
        ('"half_space"', '"plane"', r"\$\.world\[0\]"),
        ('points = "corners"', 'points = "corners", pairs = [["-+-", "chair"]]', r"\$\.object\.touching.*chair.*table"),
    ],
)
def test_refusals(old: str, new: str, message: str):
    assert old in SLIDE
    with pytest.raises(SceneError, match=message):
        scene(SLIDE.replace(old, new, 1))


def test_peg_and_hole():
    """A hole, a rod on the object, circles on both sides, ground, and a table that moves."""
    shapes = """[
        { name = "hole", type = "hole", radius = 0.05, chamfer = 0.01, depth = 0.02, edge = 0.001, MOTION },
        { name = "post", type = "rod", radius = 0.05, half_length = 0.2 },
        { name = "ground", type = "height_field", spacing = 0.1, heights = [
            [0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]] },
    ]"""
    shapes = shapes.replace("MOTION", "base_motion.shift = { amplitude = [0.1, 0, 0], frequency = [1, 1, 1] }")
    text = re.sub(r"world = .*", f"world = {shapes}", SLIDE).replace("[0, 0, 0.45]", "[0, 0, 100]")
    text = text.replace(
        'points = "corners"',
        'circles = { rim = { centre = [0, 0, -0.05], axis = [0, 0, 1], radius = 0.04 } }, solids = [{ name = "peg",'
        ' type = "rod", radius = 0.04, half_length = 0.05 }], edges = { edge = { centre = [0, 0, 0], axis = [0, 0, 1],'
        " radius = 0.051, thickness = 0.001 } }",
    )
    found = scene(text)
    touching = found.chain.touching
    assert touching is not None
    assert touching.names[:3] == ("rim.a/hole", "rim.b/hole", "rim.a/post") and touching.names[-1] == "edge.b/peg"
    hole, _, ground = touching.world.values()
    assert isinstance(hole, hf.world.Hole) and hole.depth == 0.02
    assert isinstance(ground, hf.world.HeightField) and ground.heights[1, 1] == 1.0
    assert list(found.options["base_motion"]) == ["hole"]
    pose, twist, _ = found.options["base_motion"]["hole"](1.0)
    assert pose.p[0] == pytest.approx(0.0, abs=1e-12) and twist[3] == pytest.approx(0.2 * np.pi)
