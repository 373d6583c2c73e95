"""Arms are drawn with their looks; a URDF's own surfaces are taken if every file of theirs is there."""

import numpy as np

from holdfast import Pose
from holdfast.model.visuals import Box, Sphere, Visual
from holdfast.model.visuals import Mesh as MeshFile
from holdfast.robots import panda
from holdfast.robots.primitive import LINK_COLOURS
from holdfast.robots.urdf import urdf_chain, urdf_visuals
from holdfast.robots.visuals import visuals_of
from holdfast.view.link_meshes import SHRINK, meshes_of, meshes_of_urdf
from tests.robots.two_armed import TWO_ARMED

CORNER = """solid corner
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 2 0
endloop
endfacet
endsolid corner
"""
AT = Pose.translation(0.1, 0.0, 0.3)


def test_pieces_of_an_arm():
    """A piece for each solid, where it is, in its colour, at most 2 % smaller than it is."""
    arm = panda()
    for link_meshes, solids in zip(meshes_of(visuals_of(arm)), visuals_of(arm), strict=True):
        for piece, solid in zip(link_meshes, solids, strict=True):
            assert piece.colour == LINK_COLOURS[solid.colour]
            local = np.abs((piece.mesh.vertices - solid.pose.p) @ solid.pose.R).max(axis=0)
            radius, length = solid.size
            half = np.array([radius, radius, length / 2 + (radius if solid.kind == "capsule" else 0.0)])
            assert ((1 - 6 * SHRINK) * half - 1e-12 <= local).all()
            assert (local <= half + 1e-12).all()


def test_mesh_files(tmp_path):
    """Scaled, placed, coloured; a mirrored surface still faces outward; package names are found above the file."""
    (tmp_path / "arm" / "meshes").mkdir(parents=True)
    (tmp_path / "arm" / "meshes" / "corner.stl").write_text(CORNER)
    here = tmp_path / "arm" / "urdf"
    here.mkdir()
    mirrored = MeshFile("package://arm/meshes/corner.stl", (0.1, -0.1, 0.1))
    found = meshes_of_urdf([[Visual("link", AT, mirrored, (1.0, 0.5, 0.0, 1.0))]], here)
    assert found.missing == ()
    ((piece,),) = found.link_meshes
    assert piece.colour == (255, 128, 0)
    a, b, c = piece.mesh.vertices[piece.mesh.faces[0]]
    corners = sorted(map(tuple, (piece.mesh.vertices - AT.p).round(9).tolist()))
    assert corners == [(0.0, -0.2, 0.0), (0.0, 0.0, 0.0), (0.1, 0.0, 0.0)]
    assert np.cross(b - a, c - a)[2] > 0


def test_all_or_nothing(tmp_path):
    """An arm of which one surface is missing is better drawn with simple solids."""
    whole = [[Visual("a", AT, Box((1.0, 2.0, 3.0)), None)], [Visual("b", AT, Sphere(0.1), None)]]
    found = meshes_of_urdf(whole, tmp_path).link_meshes
    assert found is not None
    assert [len(link) for link in found] == [1, 1]
    missing = [*whole, [Visual("c", AT, MeshFile("nowhere.stl", (1.0, 1.0, 1.0)), None)]]
    assert meshes_of_urdf(missing, tmp_path) == (None, ("nowhere.stl: no such file",))
    assert meshes_of_urdf([[], []], tmp_path) == (None, ())
    (tmp_path / "torn.stl").write_text("solid")
    torn = meshes_of_urdf([[Visual("c", AT, MeshFile("torn.stl", (1.0, 1.0, 1.0)), None)]], tmp_path)
    assert torn.link_meshes is None
    assert torn.missing[0].startswith(f"{tmp_path}/torn.stl: ")
    arm = urdf_chain(TWO_ARMED, base="torso", tip="left_grasp", lock_others=True)
    assert meshes_of_urdf(urdf_visuals(arm), tmp_path).link_meshes is None  # its finger is in a file
