"""Arms out of URDF files: own reader on the standard library.

The way of a file: `source` (text, file, xacro) -> `document` (XML elements with lines) ->
`vocabulary`, `links`, `joints` (typed, nothing passed over) -> `tree` -> `tips`, `locking`
(what the caller chose) -> `folding`, `inertia` (bodies) -> `chain` (arms).
"""

from __future__ import annotations

from holdfast.robots.urdf.chain import UrdfChain, urdf_chain
from holdfast.robots.urdf.listing import urdf_tree
from holdfast.robots.urdf.load import load_urdf, load_urdf_arms
from holdfast.robots.urdf.reading import read_urdf
from holdfast.robots.urdf.robot import UrdfJoint, UrdfLink, UrdfRobot
from holdfast.robots.urdf.several import urdf_chains
from holdfast.robots.urdf.visuals import Box, Capsule, Cylinder, Mesh, Shape, Sphere, Visual, urdf_visuals

__all__ = [
    "Box",
    "Capsule",
    "Cylinder",
    "Mesh",
    "Shape",
    "Sphere",
    "UrdfChain",
    "UrdfJoint",
    "UrdfLink",
    "UrdfRobot",
    "Visual",
    "load_urdf",
    "load_urdf_arms",
    "read_urdf",
    "urdf_chain",
    "urdf_chains",
    "urdf_tree",
    "urdf_visuals",
]
