"""Sound calls of shapes of the world, and of what of the object may touch them."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import world
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
