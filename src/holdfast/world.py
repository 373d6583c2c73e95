"""Shapes of the world, and the points of the object that may touch them."""

from holdfast.model.world.convex_mesh import ConvexMesh as ConvexMesh
from holdfast.model.world.features import Circle as Circle
from holdfast.model.world.features import Sphere as Sphere
from holdfast.model.world.height_field import HeightField as HeightField
from holdfast.model.world.holes import Hole as Hole
from holdfast.model.world.holes import Rod as Rod
from holdfast.model.world.solids import Ball as Ball
from holdfast.model.world.solids import Box as Box
from holdfast.model.world.solids import Cone as Cone
from holdfast.model.world.solids import Cylinder as Cylinder
from holdfast.model.world.solids import HalfSpace as HalfSpace
from holdfast.model.world.touching import Touching as Touching
from holdfast.model.world.touching import corners as corners
