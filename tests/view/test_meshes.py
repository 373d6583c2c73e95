"""Meshes are closed, face outward, and are as large as the bodies they stand for."""

import numpy as np
import pytest

from holdfast import Pose
from holdfast.robots.mesh_files.mesh import TriangleMesh
from holdfast.spatial import rotation
from holdfast.view import meshes

TURNED = Pose(rotation.exp(np.array([0.3, -0.8, 0.5])), np.array([0.2, -0.1, 0.4]))
CIRCLE = meshes.SEGMENTS / 2 * np.sin(2 * np.pi / meshes.SEGMENTS)  # area of the polygon in a unit circle


def frusta(radius: float, length: float) -> float:
    """Return the volume over pi of a capsule whose round ends are stacks of frusta, equal angles apart."""
    quarter = np.linspace(0.0, np.pi / 2, meshes.SEGMENTS // 4 + 1)
    r, z = radius * np.cos(quarter), radius * np.sin(quarter)
    ends = 2 * (np.diff(z) * (r[1:] ** 2 + r[1:] * r[:-1] + r[:-1] ** 2)).sum() / 3
    return float(ends + radius**2 * length)


def volume(mesh: TriangleMesh) -> float:
    """Return the volume inside by the divergence theorem; of an inward or open surface it is another."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


@pytest.mark.parametrize(
    ("mesh", "exact", "tolerance"),
    [
        (meshes.box((0.1, 0.2, 0.3)), 0.006, 1e-12),
        (meshes.cylinder(0.2, 0.5), CIRCLE * 0.04 * 0.5, 1e-12),
        (meshes.sphere(0.2), CIRCLE * frusta(0.2, 0.0), 1e-9),
        (meshes.capsule(0.2, 0.5), CIRCLE * frusta(0.2, 0.5), 1e-9),
    ],
)
def test_volume(mesh, exact, tolerance):
    """Closed and outward: the volume is the body's, wherever it is moved."""
    assert volume(mesh) == pytest.approx(exact, rel=tolerance)
    assert volume(mesh.at(TURNED)) == pytest.approx(volume(mesh), rel=1e-9)
    two = meshes.joined([mesh, mesh.at(TURNED)])
    assert volume(two) == pytest.approx(2 * volume(mesh), rel=1e-9)
    assert len(two.vertices) == 2 * len(mesh.vertices)


def test_where_they_lie():
    """Bodies are centred, along z."""
    assert np.abs(meshes.box((2, 4, 6)).vertices).max(axis=0) == pytest.approx([1, 2, 3])
    assert np.abs(meshes.cylinder(0.1, 2.0).vertices).max(axis=0) == pytest.approx([0.1, 0.1, 1.0])
    reach = np.abs(meshes.capsule(0.1, 2.0).vertices[:, 2]).max()
    assert reach == pytest.approx(1.1)
