"""Held objects out of closed surfaces: mass, mass centre and inertia against formulas and laws."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.robots.mesh_files.mesh import TriangleMesh as Mesh
from holdfast.robots.mesh_files.solid import solid
from holdfast.spatial import rotation
from holdfast.view import meshes
from tests.robots.mesh_files.written import obj_text, stl_bytes

TURN = hf.Pose(rotation.exp(np.array([0.3, -0.5, 0.8])), np.array([0.4, -0.2, 1.1]))
CORNER = Mesh(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))


def written(folder, mesh, name="solid.obj"):
    """Return the path of a mesh written to a file."""
    text = obj_text(mesh.vertices, mesh.faces) if name.endswith("obj") else stl_bytes(mesh.vertices[mesh.faces])
    (folder / name).write_bytes(text)
    return folder / name


def test_box(tmp_path):
    """A box's surface encloses a box; an STL of millimetres agrees to its float32."""
    edges = (0.3, 0.2, 0.4)
    expected = hf.HeldObject.box(2.4, *edges)
    found = hf.HeldObject.from_mesh(written(tmp_path, meshes.box(edges)), density=100.0)
    assert found.mass == pytest.approx(2.4, rel=1e-14)
    np.testing.assert_allclose(found.inertia, expected.inertia, atol=1e-16)
    thousand = meshes.box(tuple(1000 * edge for edge in edges))
    again = hf.HeldObject.from_mesh(written(tmp_path, thousand, "solid.stl"), mass=2.4, scale=0.001)
    np.testing.assert_allclose(again.inertia, expected.inertia, atol=1e-7)
    assert again.mass == 2.4


def test_tetrahedron():
    """The corner x + y + z <= 1: V = 1/6, centre 1/4, int x^2 = 1/60, int x y = 1/120."""
    found = solid(CORNER)
    assert found.volume == pytest.approx(1 / 6, rel=1e-15)
    np.testing.assert_allclose(found.centre, np.full(3, 0.25), rtol=1e-15)
    S = (np.full((3, 3), 1 / 120) + np.eye(3) / 120) - np.full((3, 3), 1 / 16) / 6  # about the centre
    np.testing.assert_allclose(found.inertia, S.trace() * np.eye(3) - S, atol=1e-16)


def test_motion():
    """A solid that is turned and shifted by 100 m keeps volume and principal moments; its centre goes along."""
    body = meshes.joined([meshes.box((0.2, 0.3, 0.4)), meshes.capsule(0.1, 0.2).at(TURN)])
    far = hf.Pose(TURN.R, 100.0 * TURN.p)
    before, after = solid(body), solid(body.at(far))
    assert after.volume == pytest.approx(before.volume, rel=1e-13)
    np.testing.assert_allclose(after.centre, far.R @ before.centre + far.p, atol=1e-12)
    np.testing.assert_allclose(after.inertia, far.R @ before.inertia @ far.R.T, atol=1e-13)


def test_sum():
    """Solids beside each other add up; a cavity, whose surface looks inward, is taken away."""
    outer, inner = meshes.box((1.0, 1.0, 1.0)), meshes.box((0.5, 0.5, 0.5))
    found = solid(meshes.joined([outer, Mesh(inner.vertices, inner.faces[:, ::-1])]))
    assert found.volume == pytest.approx(0.875, rel=1e-14)
    np.testing.assert_allclose(found.inertia, (1 - 0.5**5) / 6 * np.eye(3), atol=1e-15)


BOX = meshes.box((1.0, 2.0, 3.0))
FAULTS = {
    "open": (Mesh(BOX.vertices, BOX.faces[:-1]), "is open: 3 edges"),
    "one face turned": (Mesh(BOX.vertices, np.vstack([BOX.faces[:1, ::-1], BOX.faces[1:]])), "is open: 3 edges"),
    "inside out": (Mesh(BOX.vertices, BOX.faces[:, ::-1]), "is inside out"),
    "flat": (Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 1]])), "no volume"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_refused(name, tmp_path):
    """What encloses no solid is refused with the file's name."""
    mesh, message = FAULTS[name]
    with pytest.raises(hf.SceneError, match=f"solid.obj: .*{message}"):
        hf.HeldObject.from_mesh(written(tmp_path, mesh), mass=1.0)


def test_wrong_calls(tmp_path):
    """Mass and density, neither, and files that are not there."""
    path = written(tmp_path, BOX)
    for given in ({}, {"mass": 1.0, "density": 1.0}):
        with pytest.raises(hf.ModelError, match="expected one of mass and density"):
            hf.HeldObject.from_mesh(path, **given)
    with pytest.raises(hf.SceneError, match="no such file"):
        hf.HeldObject.from_mesh(tmp_path / "other.obj", mass=1.0)
    (tmp_path / "solid.txt").write_text("")
    with pytest.raises(hf.SceneError, match=r"expected a file of \.stl"):
        hf.HeldObject.from_mesh(tmp_path / "solid.txt", mass=1.0)
