"""Import of arms from URDF files, with the standard library only.

A file is processed by `source` (text, file or xacro), `document` (XML elements with line numbers), `reader` and
`attributes` (a tree of typed links and joints), `path` (the choices of the caller: base,
tip, locked joints), `bodies` (links that are welded together), `chain` (arms) and `trunk` (shared joints).
"""

from __future__ import annotations

from holdfast.robots.urdf.chain import UrdfChain, load_urdf, load_urdf_arms, urdf_chain, urdf_chains
from holdfast.robots.urdf.reader import read_urdf
from holdfast.robots.urdf.robot import UrdfRobot, urdf_tree
from holdfast.robots.urdf.trunk import UrdfTrunkChain, load_urdf_trunk, urdf_trunk
from holdfast.robots.urdf.visuals import urdf_visuals

__all__ = [
    "UrdfChain", "UrdfRobot", "UrdfTrunkChain", "load_urdf", "load_urdf_arms", "load_urdf_trunk", "read_urdf",
    "urdf_chain", "urdf_chains", "urdf_tree", "urdf_trunk", "urdf_visuals",
]  # fmt: skip
