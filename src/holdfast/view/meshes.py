"""Triangle meshes of simple solids, with sharp edges and with faces that are counter-clockwise from outside."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from holdfast.robots.mesh_files.mesh import TriangleMesh
from holdfast.spatial.scalar import Array

SEGMENTS = 24  # of a circle


def joined(meshes: Iterable[TriangleMesh]) -> TriangleMesh:
    """Return several meshes as one; at least one is needed."""
    parts = list(meshes)
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False)]
    return TriangleMesh(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))


def box(edges: Array | tuple[float, float, float]) -> TriangleMesh:
    """Return a box about the origin with edges of the lengths (x, y, z) [m]."""
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    vertices, faces = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            square = np.insert(corners, axis, side, axis=1)
            # (y, z), (x, z), (x, y) seen along +axis: the middle one is left-handed
            outward = side if axis != 1 else -side
            start = 4 * len(vertices)
            order = (0, 1, 2, 3) if outward > 0 else (3, 2, 1, 0)
            faces += [[start + order[i] for i in triangle] for triangle in ((0, 1, 2), (0, 2, 3))]
            vertices.append(square)
    return TriangleMesh(np.concatenate(vertices) * np.asarray(edges, dtype=float) / 2, np.array(faces))


def cylinder(radius: float, length: float) -> TriangleMesh:
    """Return a cylinder about the z axis, centred at the origin [m]."""
    h = length / 2
    return revolved([(0.0, -h), (radius, -h), (radius, h), (0.0, h)])


def sphere(radius: float) -> TriangleMesh:
    """Return a sphere about the origin [m]."""
    return capsule(radius, 0.0)


def capsule(radius: float, length: float) -> TriangleMesh:
    """Return a cylinder about the z axis with hemispheres at its ends.

    Args:
        radius: radius of cylinder and hemispheres [m].
        length: distance between the centres of the hemispheres [m].
    """
    quarter = np.linspace(0.0, np.pi / 2, SEGMENTS // 4 + 1)
    upper = list(zip(radius * np.cos(quarter), radius * np.sin(quarter) + length / 2, strict=True))
    return revolved([*((r, -z) for r, z in reversed(upper)), *upper], smooth=True)


def revolved(profile: list[tuple[float, float]], smooth: bool = False) -> TriangleMesh:
    """Return the surface of revolution of a profile about the z axis.

    Args:
        profile: points (radius, z) of the profile, from bottom to top [m].
        smooth: whether the bands of the surface share their vertices, so that they are shaded as one curved surface.
    """
    angles = np.linspace(0.0, 2 * np.pi, SEGMENTS, endpoint=False)
    circle = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(SEGMENTS)])

    def ring(point: tuple[float, float]) -> Array:
        return point[0] * circle + [0.0, 0.0, point[1]]

    bands = list(pairwise(profile))
    if smooth:
        vertices = np.concatenate([ring(point) for point in profile])
        starts = [k * SEGMENTS for k in range(len(bands))]
    else:
        vertices = np.concatenate([ring(point) for band in bands for point in band])
        starts = [2 * k * SEGMENTS for k in range(len(bands))]
    here, there = np.arange(SEGMENTS), np.roll(np.arange(SEGMENTS), -1)
    faces = [
        start + np.concatenate([np.stack(t, axis=1) for t in _triangles(here, there, band)])
        for start, band in zip(starts, bands, strict=True)
    ]
    return TriangleMesh(vertices, np.concatenate(faces))


def _triangles(here: Array, there: Array, band: tuple[tuple[float, float], tuple[float, float]]) -> list[list[Array]]:
    """Return the triangles between two rings, without those of zero area if a ring is a point."""
    lower = [[here, there, there + SEGMENTS]] if band[0][0] > 0 else []
    upper = [[here, there + SEGMENTS, here + SEGMENTS]] if band[1][0] > 0 else []
    return lower + upper
