"""A chain as plain data and back, number for number: `model.json` of a result folder.

    {"is": "Joint", "kind": "revolute", "axis": [0.0, 0.0, 1.0], ...}

Reading calls the constructors with their checks, so a file cannot contain what a program could not make.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import msgspec
import numpy as np

from holdfast.errors import HoldfastError, ResultError
from holdfast.model.arm import Anchor, Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.closure import Closure
from holdfast.model.coupling import Coupling
from holdfast.model.fingerprint import is_default
from holdfast.model.force_element import SpringEnd
from holdfast.model.grasp import Friction, Grasp, WrenchLimits
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.spring import Spring
from holdfast.model.trunk import Trunk
from holdfast.model.visuals import Box, Capsule, Cylinder, Mesh, Sphere, Visual, Visuals
from holdfast.model.world import convex_mesh, features, height_field, holes, solids, touching
from holdfast.spatial.pose import Pose


def _name_of(kind: type) -> str:
    """Return the name of a class in files: that of a shape of the world says so, as pictures have boxes, too."""
    return f"world.{kind.__name__}" if kind.__module__.startswith(WORLD_MODULES) else kind.__name__


WORLD_MODULES = "holdfast.model.world."
MODEL_CLASSES = {
    _name_of(kind): kind
    for kind in (
        Anchor, Arm, Box, Capsule, ClosedChain, Closure, Coupling, Cylinder, Friction, Grasp, HeldObject, Joint, Link,
        Visuals, Mesh, Pose, Sphere, Spring, SpringEnd, Trunk, Visual, WrenchLimits,
        solids.Ball, solids.Box, solids.Cone, solids.Cylinder, solids.HalfSpace, holes.Hole, holes.Rod,
        height_field.HeightField, convex_mesh.ConvexMesh, features.Sphere, features.Circle, touching.Touching,
    )
}  # fmt: skip
IS = "is"  # the key under which data say what they are
MAPPING = "mapping"
PAIRS = "pairs"  # a mapping with keys such as (arm, frame)
INFINITIES = {"inf": math.inf, "-inf": -math.inf}  # JSON has no infinities


_NO_MODEL = (msgspec.DecodeError, TypeError, ValueError, AttributeError, RecursionError, OverflowError)


def model_data(value: Any) -> Any:
    """Return a part of the model as dicts, lists, numbers and texts, which JSON can hold."""
    if is_dataclass(value) and not isinstance(value, type):
        own = [(f, getattr(value, f.name)) for f in fields(value) if f.init]
        parts = {f.name: x for f, x in own if not (f.metadata.get("omitted") and is_default(x, f.default))}
        return {IS: _name_of(type(value)), **{name: model_data(part) for name, part in parts.items()}}
    if isinstance(value, Mapping) and any(isinstance(key, tuple) for key in value):
        return {IS: PAIRS, "of": [[model_data(key), model_data(part)] for key, part in value.items()]}
    if isinstance(value, Mapping):
        return {IS: MAPPING, "of": {name: model_data(part) for name, part in value.items()}}
    if isinstance(value, list | tuple):
        return [model_data(part) for part in value]
    if isinstance(value, np.ndarray | np.generic):
        return model_data(value.tolist())
    if isinstance(value, float) and math.isinf(value):
        return {IS: "inf" if value > 0 else "-inf"}
    return value


def model_text(chain: ClosedChain) -> bytes:
    """Return a chain as the JSON text that `model_of` reads."""
    return msgspec.json.encode(model_data(chain)) + b"\n"


def model_of(text: bytes, source: str) -> ClosedChain:
    """Return the chain of a JSON text.

    Args:
        text: JSON text of `model_data`.
        source: the file's name, for messages.

    Raises:
        ResultError: the text does not describe a valid chain.
    """
    try:
        chain = _made(msgspec.json.decode(text))
    except HoldfastError as cause:
        raise ResultError(f"{source}: {cause}") from cause
    except _NO_MODEL as cause:
        raise ResultError(f"{source}: not a chain: {cause}") from cause
    if not isinstance(chain, ClosedChain):
        raise ResultError(f"{source}: expected a ClosedChain, got a {type(chain).__name__}")
    return chain


def _made(data: Any) -> Any:
    if isinstance(data, list):
        return [_made(part) for part in data]
    if not isinstance(data, dict):
        return data
    kind, parts = data.get(IS), {name: part for name, part in data.items() if name != IS}
    if kind == MAPPING:
        return {name: _made(part) for name, part in parts.get("of", {}).items()}
    if kind == PAIRS:
        pairs = [(tuple(key) if isinstance(key, list) else key, part) for key, part in parts.get("of", [])]
        return {key: _made(part) for key, part in pairs}
    if kind in INFINITIES:
        return INFINITIES[kind]
    if kind not in MODEL_CLASSES:
        raise ResultError(f"expected one of {', '.join(MODEL_CLASSES)}, got {str(kind)[:60]!r}")
    return MODEL_CLASSES[kind](**{name: _made(part) for name, part in parts.items()})
