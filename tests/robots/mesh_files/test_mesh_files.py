"""Mesh files: the surface that was written comes back, and whatever else a file holds is a named error."""

import re
import subprocess
import sys
import time
import warnings

import numpy as np
import pytest

from holdfast.model.visuals import Mesh as MeshFile
from holdfast.model.visuals import Visual
from holdfast.robots.mesh_files import mesh
from holdfast.robots.mesh_files.mesh import MeshFault
from holdfast.robots.mesh_files.read import read_mesh
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.view.link_meshes import meshes_of_urdf
from tests.robots.mesh_files.written import CORNERS, FILES, dae_text, stl_bytes, stl_text


@pytest.fixture
def read(tmp_path):
    """Return the surface of a file with some content."""

    def written(content, name="mesh.dae"):
        (tmp_path / name).write_bytes(content)
        return read_mesh(name, tmp_path)

    return written


def corners(mesh):
    """Return the corners of all triangles, (F, 3, 3)."""
    return mesh.vertices[mesh.faces]


@pytest.mark.parametrize("name", FILES)
def test_what_was_written(name, read):
    """Every triangle, in order, its corners turning as they did."""
    mesh = read(FILES[name], name)
    assert corners(mesh) == pytest.approx(CORNERS, abs=1e-7 if name == "binary.stl" else 0.0)


@pytest.mark.parametrize("name", FILES)
def test_as_trimesh(name, read, tmp_path):
    """An independent reader finds the same area, volume and extent."""
    trimesh = pytest.importorskip("trimesh", reason="needs viser: pip install 'holdfast[view]'")
    pytest.importorskip("collada", reason="needs pycollada")
    mine = read(FILES[name], name)
    with warnings.catch_warnings(action="ignore"):  # pycollada makes normals of triangles without area
        other = trimesh.load_mesh(tmp_path / name)
    ours = trimesh.Trimesh(mine.vertices, mine.faces)
    assert (ours.area, ours.volume) == pytest.approx((other.area, other.volume), rel=1e-6)
    assert ours.bounds == pytest.approx(other.bounds, abs=1e-7)


def test_shared_vertices(read):
    """Corners of an STL at one point are one vertex, so that its page is no larger than it must be."""
    assert len(read(FILES["text.stl"], "a.stl").vertices) == len(np.unique(CORNERS.reshape(-1, 3), axis=0))


def test_polygons_are_fans(read):
    """A square in OBJ and in Collada; corners before the first and after the last are refused."""
    square = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
    assert read(square, "a.obj").faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    text = dae_text(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), "polylist")
    text = text.replace(b"<vcount>3", b"<vcount>4").replace(b"<p>0 0 1 0 2 0", b"<p>0 0 1 0 2 0 3 0")
    assert read(text).faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_where_collada_nodes_stand(read):
    """Transformations apply in order, outermost first, then the unit; a mirrored surface still faces outward."""
    node = "<translate>1 2 3</translate><rotate>0 0 1 90</rotate><scale>2 2 2</scale>"
    within = f'{node}<node><matrix>1 0 0 0  0 -1 0 0  0 0 1 5  0 0 0 1</matrix><instance_geometry url="#g"/></node>'
    mesh = read(dae_text(node=within, unit='<unit meter="0.1"/>'))
    R, own = rotation.exp(np.array([0.0, 0.0, np.pi / 2])), CORNERS
    inner = own[:, ::-1] * [1, -1, 1] + [0, 0, 5]
    expected = [0.1 * (2 * part @ R.T + [1, 2, 3]) for part in (own, inner)]
    order = [1, 0] if np.allclose(corners(mesh)[0], expected[1][0]) else [0, 1]
    assert corners(mesh) == pytest.approx(np.concatenate([expected[i] for i in order]), abs=1e-12)


CUT = FILES["binary.stl"][:-40]
LAUGHS = dae_text().replace(
    b"<COLLADA", b'<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]><COLLADA', 1
)
LOOP = dae_text(node='<instance_node url="#n1"/>')
DOUBLED = "".join(
    f'<node id="d{k}"><instance_node url="#d{k + 1}"/><instance_node url="#d{k + 1}"/></node>' for k in range(40)
)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.stl", b"", "expected STL: a header of 84 bytes, got 0"),
        ("a.stl", b"solid", "has no surface"),
        ("a.stl", CUT, f"is cut off: expected {len(CORNERS)} triangles as its header says, got {len(CORNERS) - 1}"),
        ("a.stl", CUT[:80] + b"\xff\xff\xff\xff" + CUT[84:], "expected at most 2,000,000 triangles, got 4,294,967,295"),
        ("a.stl", stl_bytes(CORNERS * np.nan), "expected vertices within 1e+06 m, got one beyond, or not a number"),
        ("a.stl", stl_text(CORNERS * 1e300), "expected vertices within 1e+06 m"),
        ("a.stl", stl_text()[:-300], "is damaged"),
        ("a.stl", stl_text().replace(b"vertex 0.1", b"vertex one", 1), "vertex: expected numbers"),
        ("a.obj", b"v 0 0 0\nf 1 1 2\n", "expected faces of its 1 vertices, got one of others"),
        ("a.obj", b"v 0 0\n", "line 1: expected a vertex or a face"),
        ("a.obj", b"v 0 0 0\nf 1 -2 1\n", "line 2: expected a vertex or a face"),
        ("a.obj", b"v 0 0 0\nf 1 0 1\n", "line 2: expected a vertex or a face"),
        ("a.obj", b"# nothing\n", "has no surface"),
        ("a.obj", b"f " + b"1 " * 60_000, "line 1: expected at most 100,000 characters"),
        ("a.dae", b"PK\x03\x04", "line 1: not well-formed XML"),
        ("a.dae", b"<robot/>", "expected <COLLADA> as the outermost element, got <robot>"),
        ("a.dae", LAUGHS, "expected no DOCTYPE"),
        ("a.dae", b"<COLLADA>" * 300, "elements in 200 levels"),
        ("a.dae", LOOP, "nodes in 50 levels"),
        ("a.dae", dae_text(node=DOUBLED + '<node id="d40"/>'), "nodes in 50 levels"),
        ("a.dae", dae_text().replace(b'count="1080"', b'count="4000000000"'), "float_array"),
        ("a.dae", dae_text().replace(b"<triangles count=", b"<triangles count=\"7000000000\" c="), "got 7,000,000,000"),
        ("a.dae", dae_text().replace(b'offset="1"', b'offset="999999"'), "offset: expected a whole number up to 64"),
        ("a.dae", dae_text().replace(b"<p>3 0", b"<p>9999 0"), "vertices, got one of others"),
        ("a.dae", dae_text().replace(b"<p>3 0", b"<p>-1 0"), "vertices, got one of others"),
        ("a.dae", dae_text().replace(b"<p>3 0", b"<p>0.5 0"), "p: expected numbers"),
        ("a.dae", dae_text(kind="polylist").replace(b"<vcount>3", b"<vcount>1000000000"), "is damaged"),
        ("a.dae", dae_text(node="<matrix>1 0</matrix>"), "matrix: expected 16 numbers, got 2"),
        ("a.dae", dae_text(node="<scale>1e200 1e200 1e200</scale>" * 2), "expected vertices within"),
        ("a.dae", dae_text(unit='<unit meter="0"/>'), "unit: expected a length > 0"),
        ("a.dae", dae_text().replace(b"utf-8", b"utf-99"), "cannot be"),
        ("a.zae", b"PK\x03\x04", "expected a file of .stl, .obj, .dae"),
        ("a.stl.gz", b"\x1f\x8b", "expected a file of .stl, .obj, .dae"),
        ("a.glb", b"glTF", "expected a file of .stl, .obj, .dae"),
    ],
)  # fmt: skip
def test_damaged(name, content, message, read, tmp_path):
    """The file, and what is wrong with it, within seconds."""
    began = time.monotonic()
    with pytest.raises(MeshFault, match=re.escape(f"{tmp_path / name}: cannot be read: ")) as caught:
        read(content, name)
    assert message in str(caught.value)
    assert time.monotonic() - began < 10.0


def test_size_is_looked_at_first(read, monkeypatch):
    """A file that is too large is not read; nor is one surface that stands in too many places made."""
    monkeypatch.setattr("holdfast.robots.mesh_files.read.LARGEST_MESH_FILE", 1000)
    with pytest.raises(MeshFault, match="expected at most 0 MiB, got more"):
        read(FILES["text.stl"], "a.stl")
    monkeypatch.undo()
    monkeypatch.setattr(mesh, "MOST_TRIANGLES", 3 * len(CORNERS))
    assert len(read(dae_text(node='<instance_geometry url="#g"/>' * 2)).faces) == 3 * len(CORNERS)
    with pytest.raises(MeshFault, match="triangles, got"):
        read(dae_text(node='<instance_geometry url="#g"/>' * 3))


def test_all_meshes_of_an_arm(tmp_path, monkeypatch):
    """One mesh on many links counts as often as it is drawn."""
    (tmp_path / "a.obj").write_bytes(FILES["solid.obj"])
    link = [Visual("a", Pose.identity(), MeshFile("a.obj", (1.0, 1.0, 1.0)), None)]
    monkeypatch.setattr(mesh, "MOST_TRIANGLES", 3 * len(CORNERS))
    assert meshes_of_urdf([link] * 3, tmp_path).link_meshes is not None
    assert "triangles, got" in meshes_of_urdf([link] * 4, tmp_path).missing[0]
    far = [Visual("a", Pose.identity(), MeshFile("a.obj", (1e300, 1.0, 1.0)), None)]
    assert "scale: expected vertices within 1e+06 m" in meshes_of_urdf([far], tmp_path).missing[0]


PLACES = [
    ("a.stl", True),
    ("../meshes/a.stl", True),
    ("file://{package}/meshes/a.stl", True),
    ("{package}/meshes/a.stl", True),
    ("package://robot/meshes/a.stl", True),
    ("package://renamed/meshes/a.stl", True),
    ("model://robot/meshes/a.stl", True),
    ("package://beside/a.stl", True),
    ("package://plain/b.stl", False),  # beside it, and no package
    ("../../plain/a.stl", "expected a file in the robot's package, which is {package}"),
    ("{package}/../plain/a.stl", "expected a file in the robot's package"),
    ("file:///etc/hostname", "expected a file in the robot's package"),
    ("/dev/zero", "expected a file in the robot's package"),
    ("package://../plain/a.stl", "without '..'"),
    ("package://robot/../../plain/a.stl", "without '..'"),
    ("package://etc/hostname", False),
    ("package:///etc/hostname", "expected the name of a package"),
    ("package://robot//etc/hostname", False),
    ("http://localhost/a.stl", "expected a file name, file://, package:// or model://"),
    ("a\0.stl", "a\\x00.stl"),
    ("a" * 5000, ""),
    ("../meshes", False),
    ("pipe.stl", False),
]


@pytest.mark.parametrize("manifest", [True, False])
def test_where_meshes_may_be(manifest, tmp_path):
    """In the robot's package, or one beside it; never elsewhere."""
    package = tmp_path / "robot"
    for folder in (package / "urdf", package / "meshes", tmp_path / "plain", tmp_path / "beside"):
        folder.mkdir(parents=True)
        (folder / "a.stl").write_bytes(FILES["binary.stl"])
    (tmp_path / "beside" / "package.xml").touch()
    (tmp_path / "plain" / "b.stl").write_bytes(FILES["binary.stl"])
    if manifest:
        (package / "package.xml").touch()
    subprocess.run(["mkfifo", package / "urdf" / "pipe.stl"], check=True)
    for filename, found in PLACES:
        name = filename.format(package=package)
        if found is True:
            assert len(read_mesh(name, package / "urdf").faces) == len(CORNERS), filename
            continue
        with pytest.raises(MeshFault) as caught:
            read_mesh(name, package / "urdf")
        assert (found or ("no such file" if found is False else "")).format(package=package) in str(caught.value)
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 600


# in a process of its own, whose memory is what it has after its imports and half a GiB more
FUZZ = """
import resource, sys
from pathlib import Path
import numpy as np
from holdfast.robots.mesh_files import mesh
from holdfast.robots.mesh_files.mesh import MeshFault
from holdfast.robots.mesh_files.read import read_mesh
from tests.robots.mesh_files.written import FILES, mutated

first, last, folder = int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2**29, used + 2**29))
read = refused = 0
for seed in range(first, last):
    rng = np.random.default_rng(seed)
    name = list(FILES)[seed % len(FILES)]
    (folder / name).write_bytes(mutated(FILES[name], rng))
    try:
        mesh = read_mesh(name, folder)
        assert np.isfinite(mesh.vertices).all() and 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
        read += 1
    except MeshFault:
        refused += 1
    except BaseException:
        print("seed", seed)
        raise
print(read, refused)
"""


def fuzz(first, last, folder):
    """Return how many of some mutated files were read, and how many refused."""
    command = [sys.executable, "-W", "error", "-c", FUZZ, str(first), str(last), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stdout + done.stderr
    return tuple(map(int, done.stdout.split()))


@pytest.mark.skipif(sys.platform != "linux", reason="needs limits of memory as on Linux")
def test_mutated(tmp_path):
    """300 mutated files: a surface that can be drawn, or a named error, within half a GiB."""
    read, refused = fuzz(0, 300, tmp_path)
    assert read + refused == 300
    assert refused > 100
