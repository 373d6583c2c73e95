"""Import of arms from URDF files, with the standard library only.

A file is processed by `source` (text, file or xacro), `document` (XML elements with line numbers), `reader` and
`attributes` (a tree of typed links and joints; `planar` joints are split), `path` (the choices of the caller: base,
tip, locked joints), `bodies` (links that are welded together), `chain` (arms) and `trunk` (shared joints).
"""

from __future__ import annotations

from holdfast.model.visuals import Box as Box
from holdfast.model.visuals import Capsule as Capsule
from holdfast.model.visuals import Cylinder as Cylinder
from holdfast.model.visuals import Mesh as Mesh
from holdfast.model.visuals import Shape as Shape
from holdfast.model.visuals import Sphere as Sphere
from holdfast.model.visuals import Visual as Visual
from holdfast.robots.urdf.chain import UrdfChain as UrdfChain
from holdfast.robots.urdf.chain import load_urdf as load_urdf
from holdfast.robots.urdf.chain import load_urdf_arms as load_urdf_arms
from holdfast.robots.urdf.chain import urdf_chain as urdf_chain
from holdfast.robots.urdf.chain import urdf_chains as urdf_chains
from holdfast.robots.urdf.reader import read_urdf as read_urdf
from holdfast.robots.urdf.robot import UrdfJoint as UrdfJoint
from holdfast.robots.urdf.robot import UrdfLink as UrdfLink
from holdfast.robots.urdf.robot import UrdfRobot as UrdfRobot
from holdfast.robots.urdf.robot import urdf_tree as urdf_tree
from holdfast.robots.urdf.trunk import UrdfTrunkChain as UrdfTrunkChain
from holdfast.robots.urdf.trunk import load_urdf_trunk as load_urdf_trunk
from holdfast.robots.urdf.trunk import urdf_trunk as urdf_trunk
from holdfast.robots.urdf.visuals import urdf_visuals as urdf_visuals
