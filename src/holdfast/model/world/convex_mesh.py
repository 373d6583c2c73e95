"""Convex meshes, by the library coal (https://github.com/coal-library/coal); for the reference only."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from holdfast.errors import MissingExtra, ModelError
from holdfast.model import checks
from holdfast.model.world.shape import Distance, WorldShape
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, ArrayField, frozen_property
from holdfast.spatial.scalar import Array

MOST_HULL_POINTS = 100_000


@called
@dataclass(frozen=True, eq=False, kw_only=True)
class ConvexMesh(WorldShape):
    """The convex hull of vertices, whose signed distance the library coal finds (GJK and EPA), for the reference only.

    S = 0: the curvature of its edges and corners is left out. Features that roll on a face are exact; across an edge,
    the normal jumps. Machine code does not have this shape, and says so.

    Attributes:
        vertices: (m, 3) points, at least four that do not lie in one plane, own axes [m].

    Raises:
        ModelError: the vertices have no volume.
        MissingExtra: coal is not installed (`pip install "holdfast[mesh]"`); at the first distance.
    """

    traceable: ClassVar[bool] = False
    vertices: ArrayField = REQUIRED

    def __post_init__(self) -> None:
        super().__post_init__()
        vertices = checks.numbers(self.vertices, None, f"{self.what}: vertices")
        if vertices.ndim != 2 or vertices.shape[1:] != (3,) or not 4 <= len(vertices) <= MOST_HULL_POINTS:
            raise ModelError(
                f"{self.what}: vertices: expected shape (m, 3) of 4 to {MOST_HULL_POINTS} points, got shape"
                f" {vertices.shape}"
            )
        object.__setattr__(self, "vertices", vertices)
        assert len(self.hull)

    @frozen_property
    def hull(self) -> tuple[Array, Array]:
        """The corners (c, 3) of the hull and its triangles (f, 3), counter-clockwise seen from outside."""
        from scipy.spatial import ConvexHull, QhullError  # imported here because it takes half a second

        try:
            found = ConvexHull(self.vertices)
        except QhullError as cause:
            raise ModelError(
                f"{self.what}: vertices: expected points that do not lie in one plane, got a hull without volume"
            ) from cause
        corners = found.vertices
        number = np.full(len(self.vertices), -1)
        number[corners] = np.arange(len(corners))
        places, triangles = np.asarray(self.vertices)[corners], number[found.simplices].astype(np.int64)
        a, b, c = (places[triangles[:, i]] for i in range(3))
        inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), found.equations[:, :3]) < 0.0
        triangles[inward] = triangles[inward][:, ::-1]
        return places, triangles

    def distance(self, x: Array) -> Distance:
        """Return phi, n and S = 0 at x (3,), in own axes."""
        coal = _coal()
        x = np.asarray(x, dtype=float)
        asked, found = coal.DistanceRequest(), coal.DistanceResult()
        asked.gjk_tolerance = 1e-12
        hull = _hull(*(part.tobytes() for part in self.hull))
        phi = coal.distance(hull, coal.Transform3s(), coal.Sphere(0.0), coal.Transform3s(np.eye(3), x), asked, found)
        n = np.array(found.normal, dtype=float)  # from the first solid to the second
        return Distance(float(phi), n / np.linalg.norm(n), np.zeros((3, 3)))


def _coal() -> Any:
    """Return the library.

    Raises:
        MissingExtra: it is not installed.
    """
    try:
        return importlib.import_module("coal")
    except ImportError as cause:
        raise MissingExtra("ConvexMesh needs coal for distances; try pip install 'holdfast[mesh]'") from cause


@lru_cache(maxsize=32)
def _hull(places: bytes, triangles: bytes) -> Any:
    """Return a hull as coal has it, from the bytes of its corners and triangles."""
    coal = _coal()
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for p in np.frombuffer(places).reshape(-1, 3):
        points.append(p)
    for f in np.frombuffer(triangles, dtype=np.int64).reshape(-1, 3).tolist():
        faces.append(coal.Triangle(*f))
    return coal.Convex(points, faces)
