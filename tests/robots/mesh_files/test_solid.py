"""Held objects out of closed surfaces: mass, mass centre and inertia against formulas and laws."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.robots.mesh_files.mesh import MeshFault
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
    with pytest.raises(hf.errors.SceneError, match=f"solid.obj: .*{message}"):
        hf.HeldObject.from_mesh(written(tmp_path, mesh), mass=1.0)


def test_wrong_calls(tmp_path):
    """Mass and density, neither, and files that are not there."""
    path = written(tmp_path, BOX)
    for given in ({}, {"mass": 1.0, "density": 1.0}):
        with pytest.raises(hf.errors.ModelError, match="expected one of mass and density"):
            hf.HeldObject.from_mesh(path, **given)
    with pytest.raises(hf.errors.SceneError, match="no such file"):
        hf.HeldObject.from_mesh(tmp_path / "other.obj", mass=1.0)
    (tmp_path / "solid.txt").write_text("")
    with pytest.raises(hf.errors.SceneError, match=r"expected a file of \.stl"):
        hf.HeldObject.from_mesh(tmp_path / "solid.txt", mass=1.0)


CUBE, HALF = meshes.box((1.0, 1.0, 1.0)), meshes.box((0.5, 0.5, 0.5))
BALL = Mesh(meshes.sphere(0.5).vertices.round(9), meshes.sphere(0.5).faces)
TURNS = [hf.Pose.identity(), hf.Pose.from_rpy(0.3, 0.5, -0.7, [20.0, -5.0, 3.0])]


def moved(mesh, *p):
    return mesh.at(hf.Pose.translation(*p))


def reversed_(mesh):
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def split(mesh):
    """Return the same surface with each face divided into three at its centre."""
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    apex = len(mesh.vertices) + np.arange(len(middle))
    faces = [np.column_stack([mesh.faces[:, i], mesh.faces[:, (i + 1) % 3], apex]) for i in range(3)]
    return Mesh(np.vstack([mesh.vertices, middle]), np.vstack(faces))


def crossing_itself():
    """Return one closed shell, a prism over a bow tie: half of it is inside out."""
    corners = np.array([[0.0, 0], [1, 0.5], [1, 0], [0, 1]])
    vertices = np.vstack([np.column_stack([corners, np.full(4, z)]) for z in (0.0, 1.0)])
    sides = [[i, (i + 1) % 4, 4 + i] for i in range(4)] + [[(i + 1) % 4, 4 + (i + 1) % 4, 4 + i] for i in range(4)]
    return Mesh(vertices, np.array([*sides, [2, 1, 0], [3, 2, 0], [4, 5, 6], [4, 6, 7]]))


# volume, if every place is enclosed at most once, else what the error says
SURFACES = {
    "beside": ([CUBE, moved(CUBE, 1.5, 0, 0)], 2.0),
    "touching": ([CUBE, moved(CUBE, 1.0, 0.3, -0.2)], 2.0),
    "touching in an edge": ([CUBE, moved(CUBE, 1.0, 1.0, 0)], 2.0),
    "a cavity": ([CUBE, reversed_(HALF)], 0.875),
    "a cavity, and a body in it": ([CUBE, reversed_(HALF), meshes.box((0.2, 0.2, 0.2))], 0.883),
    "a cavity that is filled": ([CUBE, reversed_(HALF), HALF], 1.0),
    "overlapping": ([CUBE, moved(CUBE, 0.5, 0.2, 0.1)], "twice"),
    "overlapping in a corner": ([CUBE, moved(CUBE, 0.99, 0.99, 0.99)], "twice"),
    "overlapping a little": ([CUBE, moved(CUBE, 0.9999, 0, 0)], "twice"),
    "bars that cross": ([meshes.box((1.0, 0.1, 0.1)), meshes.box((0.1, 1.0, 0.1))], "twice"),
    "within, in one plane": ([CUBE, moved(meshes.box((1.0, 1.0, 0.5)), 0, 0, 0.25)], "twice"),
    "within": ([CUBE, HALF], "reversing it"),
    "far within": ([CUBE, meshes.box((0.01, 0.01, 0.01))], "twice"),
    "twice": ([CUBE, CUBE], "occur twice"),
    "twice, with other faces": ([CUBE, split(CUBE)], "twice"),
    "faces twice": ([Mesh(CUBE.vertices, np.vstack([CUBE.faces, CUBE.faces]))], "twice"),
    "spheres": ([BALL, moved(BALL, 0.3, 0, 0)], "twice"),
    "one inside out": ([CUBE, moved(reversed_(HALF), 3.0, 0, 0)], "inside out in parts"),
    "a cavity that breaks through": ([CUBE, moved(reversed_(HALF), 0.4, 0, 0)], "inside out in parts"),
    "crossing itself": ([crossing_itself()], "inside out in parts"),
}


@pytest.mark.parametrize("name", SURFACES)
def test_surfaces(name, tmp_path):
    """Also turned, moved away, and rounded to float32 by an STL."""
    shells, expected = SURFACES[name]
    for turn in TURNS:
        mesh = meshes.joined(shells).at(turn)
        rounded = mesh.vertices.astype(np.float32).astype(float)
        if isinstance(expected, float):
            assert solid(Mesh(rounded, mesh.faces)).volume == pytest.approx(expected, rel=1e-5)
            continue
        (tmp_path / "part.stl").write_bytes(stl_bytes(rounded[mesh.faces]))
        with pytest.raises(hf.errors.SceneError, match=f"part.stl: .*{expected}"):
            hf.HeldObject.from_mesh(tmp_path / "part.stl", mass=1.0)


def test_random_pairs_of_boxes():
    """Refused if and only if the boxes overlap, however they are turned together."""
    rng = np.random.default_rng(5)
    outcomes = []
    for _ in range(40):
        edges, middle = rng.uniform(0.1, 1.0, (2, 3)), rng.uniform(-0.8, 0.8, 3)
        depth = (edges.sum(axis=0) / 2 - np.abs(middle)).min()  # of the overlap, along the axis where it is least
        both = meshes.joined([meshes.box(tuple(edges[0])), moved(meshes.box(tuple(edges[1])), *middle)])
        turned = both.at(hf.Pose.from_rpy(*rng.uniform(-3, 3, 3), rng.uniform(-2, 2, 3)))
        outcomes.append(depth)
        if depth < 0.0:
            assert solid(turned).volume == pytest.approx(edges.prod(axis=1).sum(), rel=1e-12)
        elif depth > 0.005:  # smaller overlaps may pass between the lines
            with pytest.raises(MeshFault, match="twice"):
                solid(turned)
    assert 5 < np.count_nonzero(np.array(outcomes) < 0.0) < 35


def test_the_place_that_is_told_lies_in_both():
    """The example in the message is in the overlap."""
    shells = [moved(CUBE, 5.0, 0, 0), moved(CUBE, 5.6, 0.7, 0.0)]
    with pytest.raises(MeshFault) as caught:
        solid(meshes.joined(shells))
    place = np.array(str(caught.value).split("(")[1].split(")")[0].split(","), dtype=float)
    for middle in ([5.0, 0, 0], [5.6, 0.7, 0]):
        assert (np.abs(place - middle) < 0.501).all()


def test_valid_surfaces_of_many_faces():
    """Rough closed surfaces, of slivers too, are accepted; their volume is that of their tetrahedra."""
    rng = np.random.default_rng(3)
    sphere = meshes.sphere(1.0)
    for _ in range(6):
        radii = rng.uniform(0.3, 1.0, len(sphere.vertices))
        _, same = np.unique(sphere.vertices.round(9), axis=0, return_inverse=True)
        stretch = 10.0 ** rng.uniform(-2, 2, 3)
        rough = Mesh(sphere.vertices.round(9) * radii[same.ravel()][:, None] * stretch, sphere.faces)
        corners = rough.vertices[rough.faces]
        assert solid(rough).volume == pytest.approx(np.linalg.det(corners).sum() / 6, rel=1e-12)
