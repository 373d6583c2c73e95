"""Mesh files of random solids, and what is done to them."""

from __future__ import annotations

import numpy as np

from holdfast.view import meshes

SOLID = meshes.joined([meshes.box((0.2, 0.3, 0.4)), meshes.sphere(0.1)])
CORNERS = SOLID.vertices[SOLID.faces]  # (F, 3, 3)


def stl_bytes(corners=CORNERS):
    """Return a binary STL."""
    table = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    table["corners"] = corners
    return b"binary".ljust(80) + len(corners).to_bytes(4, "little") + table.tobytes()


def stl_text(corners=CORNERS):
    """Return a text STL."""
    lines = ["solid some name"]
    for triangle in corners:
        lines += ["facet normal 0 0 0", "  outer loop"]
        lines += [f"    vertex {x!r} {y!r} {z!r}" for x, y, z in triangle.tolist()]
        lines += ["  endloop", "endfacet"]
    return "\n".join([*lines, "endsolid some name"]).encode()


def obj_text(vertices=SOLID.vertices, faces=SOLID.faces):
    """Return an OBJ with what others write into it: normals, groups, counting from the end."""
    lines = ["# a comment", "mtllib none.mtl", "o solid"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += ["vn 0 0 1", "usemtl none", "s off"]
    for k, (a, b, c) in enumerate(faces.tolist()):
        lines.append(f"f {a + 1}//1 {b + 1}//1 {c + 1}//1" if k % 2 else f"f {a - len(vertices)} {b + 1} {c + 1}/1/1")
    return "\n".join(lines).encode()


XYZ = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ") + "</accessor></technique_common></source>"


def dae_text(vertices=SOLID.vertices, faces=SOLID.faces, kind="triangles", node="", unit=""):
    """Return a Collada file; each corner has a normal too."""
    corners = " ".join(f"{i} 0" for i in faces.ravel())
    counts = f"<vcount>{' '.join(['3'] * len(faces))}</vcount>" if kind == "polylist" else ""
    p = f"<p>{corners}</p>"
    if kind == "polygons":
        p = "".join(f"<p>{' '.join(f'{i} 0' for i in face)}</p>" for face in faces)
    numbers = " ".join(map(repr, vertices.ravel().tolist()))
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>{unit}<up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="points"><float_array id="a" count="{vertices.size}">{numbers}</float_array>
<technique_common><accessor source="#a" count="{len(vertices)}" stride="3">{XYZ}
<source id="normals"><float_array id="n" count="3">0 0 1</float_array>
<technique_common><accessor source="#n" count="1" stride="3">{XYZ}
<vertices id="v"><input semantic="POSITION" source="#points"/></vertices>
<{kind} count="{len(faces)}"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="NORMAL" source="#normals" offset="1"/>{counts}{p}</{kind}>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n1">{node}<instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>
</COLLADA>""".encode()


FILES = {
    "binary.stl": stl_bytes(),
    "text.stl": stl_text(),
    "solid.obj": obj_text(),
    **{f"{kind}.dae": dae_text(kind=kind) for kind in ("triangles", "polylist", "polygons")},
}
WORDS = (
    b"nan", b"inf", b"1e999", b"-1", b"99999999999", b"4294967295", b"2000001", b"\x00", b"\xff\xfe", b"<", b"&a;",
    b'count="', b'offset="', b'stride="', b"<p>", b"</p>", b"vertex", b"f ", b"v ", b"endloop", b"0 0 0 0", b"#v",
)  # fmt: skip


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Return a file with one to four faults: bytes changed, cut, doubled, moved, or words put in."""
    damaged = bytearray(content)
    for _ in range(rng.integers(1, 5)):
        a, b = sorted(rng.integers(0, len(damaged) + 1, 2).tolist())
        match rng.integers(0, 7):
            case 0:
                damaged[a : a + 1] = bytes([rng.integers(0, 256)])
            case 1:
                del damaged[a:]
            case 2:
                del damaged[a : min(b, a + 200)]
            case 3:
                damaged[a:a] = damaged[a : min(b, a + 1000)]
            case 4 | 5:
                damaged[a:a] = WORDS[rng.integers(len(WORDS))]
            case 6:
                found = [i for i, byte in enumerate(damaged[:400]) if 48 <= byte < 58]
                if found:
                    damaged[found[rng.integers(len(found))]] = 48 + rng.integers(10)
    return bytes(damaged)
