"""Sound calls of shapes of the world, and of what of the object may touch them."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import world
from holdfast.scenario.build import parse_scene
from holdfast.scenario.overrides import toml_text
from holdfast.scenario.robots import RobotFiles
from tests.fuzz.calls import call, named

OF_EVERY = {
    "friction": 0.3,
    "restitution": 0.5,
    "pose": np.array([1.0, 0.0, 0.0, 0.0, 0.1, 0.2, -3.0]),
    "surface_twist": np.array([0, 0, 0, 0.1, 0, 0]),
}
SHAPES: dict[str, dict[str, Any]] = {
    "HalfSpace": {"normal": np.array([0.0, 0.6, 0.8]), "offset": 0.1},
    "Ball": {"radius": 0.2},
    "Cylinder": {"radius": 0.2, "inside": False},
    "Cone": {"angle": 0.4, "inside": False},
    "Box": {"half": np.array([0.1, 0.2, 0.3]), "edge": 0.01},
    "Hole": {"radius": 0.2, "chamfer": 0.02, "depth": 0.03, "edge": 1e-3},
    "Rod": {"radius": 0.2, "half_length": 0.3, "edge": 1e-3},
    "HeightField": {"heights": 0.1 * np.ones((5, 4)), "spacing": 0.2},
    "ConvexMesh": {"vertices": np.vstack([np.eye(3), np.zeros((1, 3))])},
}
CIRCLE = {"centre": np.array([0, 0, -0.1]), "axis": np.array([0, 0, 1.0]), "radius": 0.1, "thickness": 0.01}
FREE = hf.HeldObject.box(1.0, 0.2, 0.2, 0.2)


def answered(touching: Any) -> Any:
    """Return what a free object that may touch something answers at rest."""
    chain = hf.ClosedChain({}, FREE, {}, touching=touching)
    state = hf.State([], [], hf.Pose.translation(0.05, 0.0, 3.0))
    found = hf.forward_dynamics(chain, state, [])
    return found.object_acceleration, found.touch_gap


def _shape(kind: str, **given: Any) -> Any:
    made = getattr(world, kind)(**given)
    return repr(made), answered(world.Touching({"tip": [0.0, 0.0, -0.1], "rim": world.Circle(**CIRCLE)}, {"it": made}))


for kind, own in SHAPES.items():
    call(f"world.{kind}", **OF_EVERY, **own)(partial(_shape, kind))


@call("world.Sphere", centre=np.array([0, 0, -0.1]), radius=0.1)
def _sphere(**given: Any) -> Any:
    return answered(world.Touching({"ball": world.Sphere(**given)}, {"floor": world.HalfSpace()}))


@call("world.Circle", **CIRCLE)
def _circle(**given: Any) -> Any:
    return answered(world.Touching({"rim": world.Circle(**given)}, {"floor": world.HalfSpace()}))


@call("world.corners", x=0.1, y=0.2, z=0.3)
def _corners(**given: Any) -> Any:
    return answered(world.Touching(world.corners(**given), {"floor": world.HalfSpace()}))


@call(
    "world.Touching",
    points={"tip": np.array([0, 0, -0.1]), "rim": CIRCLE},
    world={"floor": {"offset": -1.0}, "wall": {"normal": np.array([1.0, 0, 0]), "offset": -3.0}},
    pairs=[["tip", "floor"], ["rim", "wall"], ["edge", "peg"]],
    solids={"peg": {"radius": 0.1, "half_length": 0.2}},
    edges={"edge": {"centre": np.array([0, 0, -2.0]), "axis": np.array([0, 0, 1.0]), "radius": 0.3}},
)
def _touching(**given: Any) -> Any:
    def made(of: str, kind: Any) -> Any:
        parts = given.get(of)
        if not isinstance(parts, dict):
            return parts
        return {name: kind(**x) if named(x, kind) else x for name, x in parts.items()}

    kinds = {"points": world.Circle, "world": world.HalfSpace, "solids": world.Rod, "edges": world.Circle}
    return answered(world.Touching(**{**given, **{of: made(of, kind) for of, kind in kinds.items() if of in given}}))


@call(
    "world.scene",
    world=[
        {"name": "floor", "type": "half_space", "offset": -1.0, "friction": 0.3, "normal": [0.0, 0.0, 1.0]},
        {"name": "block", "type": "box", "half": [0.1, 0.2, 0.3], "pose": {"position": [3.0, 0.0, 0.0]}},
        {"name": "bore", "type": "hole", "radius": 0.3, "chamfer": 0.02, "restitution": 0.5},
        {"name": "hill", "type": "height_field", "heights": [[0.1] * 4] * 4, "spacing": 0.2},
    ],
    touching={
        "points": {"tip": [0.0, 0.0, -0.1]},
        "radius": 0.01,
        "pairs": [["tip", "floor"], ["rim", "bore"], ["edge", "peg"]],
        "circles": {"rim": {"centre": [0.0, 0.0, -0.1], "axis": [0.0, 0.0, 1.0], "radius": 0.1, "thickness": 0.01}},
        "solids": [{"name": "peg", "type": "rod", "radius": 0.1, "half_length": 0.2}],
        "edges": {"edge": {"centre": [0.0, 0.0, -2.0], "axis": [0.0, 0.0, 1.0], "radius": 0.3}},
    },
    simulation={"duration": 0.02, "step": 0.01, "contacts": "steps"},
)
def _scene(**given: Any) -> Any:
    body = {"mass": 1.0, "box": [0.2, 0.2, 0.1], "pose": {"position": [0.0, 0.0, 3.0]}}
    body |= {"touching": given.pop("touching")} if "touching" in given else {}
    text = toml_text(in_toml({"arms": [], "object": body, **given}))
    made = parse_scene(text.encode(), "scene", "scene", RobotFiles())
    found = hf.forward_dynamics(made.chain, made.state, [])
    return found.object_acceleration, found.touch_gap


def in_toml(x: Any) -> Any:
    """Return what a file can say of an argument."""
    if isinstance(x, dict):
        return {str(key): in_toml(one) for key, one in x.items()}
    if isinstance(x, list | tuple):
        return [in_toml(one) for one in x]
    if isinstance(x, bool | float) or (isinstance(x, int) and abs(x) < 2**63):
        return x
    return str(x)[:100]
