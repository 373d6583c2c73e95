"""Signed distances of world shapes: derivatives by differences, feet of perpendiculars, distances sampled directly."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import holdfast as hf
from holdfast.errors import HoldfastError, ModelError
from holdfast.world import (
    Ball,
    Box,
    Circle,
    Cone,
    ConvexMesh,
    Cylinder,
    HalfSpace,
    HeightField,
    Hole,
    Rod,
    Sphere,
    Touching,
    corners,
)

TILTED = hf.Pose.from_wxyz_xyz([0.5, 0.5, -0.5, 0.5, 0.1, -0.2, 0.3])
SHAPES = {
    "half-space": HalfSpace(normal=[0.6, 0.0, 0.8], offset=0.4, pose=TILTED),
    "ball": Ball(radius=0.3, pose=TILTED),
    "rod": Cylinder(radius=0.2, pose=TILTED),
    "hole": Cylinder(radius=0.7, inside=True, pose=TILTED),
    "cone": Cone(angle=0.4, pose=TILTED),
    "funnel": Cone(angle=0.9, inside=True, pose=TILTED),
    "box": Box(half=[0.3, 0.2, 0.1], edge=0.02, pose=TILTED),
    "chamfered hole": Hole(radius=0.4, chamfer=0.2, depth=0.1, edge=0.05, pose=TILTED),
    "short rod": Rod(radius=0.2, half_length=0.3, edge=0.05, pose=TILTED),
    "height field": HeightField(
        heights=0.003 * np.random.default_rng(3).normal(size=(8, 9)),
        spacing=0.25,
        pose=hf.Pose.translation(-0.8, -1, 0),
    ),
}


def near(shape, rng):
    """Return a point outside the solid and off its edges of curvature."""
    while True:
        x = rng.uniform(-0.8, 0.8, 3)
        if shape.from_world(x).phi > 0.05:
            return x


@pytest.mark.parametrize("name", SHAPES)
def test_gradient_and_hessian(name):
    """n and S are the derivatives of phi; |n| = 1 and S n = 0, since phi is a distance."""
    shape, rng, h = SHAPES[name], np.random.default_rng(5), 1e-6
    for _ in range(40):
        x = near(shape, rng)
        phi, n, S = shape.from_world(x)
        by_differences = [(shape.from_world(x + d).phi - shape.from_world(x - d).phi) / (2 * h) for d in h * np.eye(3)]
        np.testing.assert_allclose(n, by_differences, atol=1e-8)
        rows = np.array([(shape.from_world(x + d).n - shape.from_world(x - d).n) / (2 * h) for d in h * np.eye(3)])
        if np.abs(rows - rows.T).max() < 1e-6:  # not across a kink of S, such as that between a face and an edge
            np.testing.assert_allclose(S, rows, atol=1e-5 * max(1.0, np.abs(S).max()))
        assert abs(n @ n - 1.0) < 1e-14
        np.testing.assert_allclose(S @ n, 0.0, atol=1e-12)
        foot = shape.from_world(x - phi * n)
        assert abs(foot.phi) < 1e-14  # phi is the distance to the surface along n
        if np.linalg.norm(x - phi * n - shape.pose.p) > 1e-9:  # but at an apex, which has no normal
            np.testing.assert_allclose(foot.n, n, atol=1e-12)


def test_height_field_against_a_spline():
    """The surface is SciPy's bicubic spline with flat borders, and its distance is that of mpmath's minimum."""
    mpmath = pytest.importorskip("mpmath")
    heights = 0.05 * np.random.default_rng(4).normal(size=(6, 5))
    field, grid = HeightField(heights=heights, spacing=0.2), 0.2 * np.arange(6)
    flat = [(1, np.zeros(5))]
    along = make_interp_spline(grid, heights, bc_type=(flat, flat), axis=0)
    for a in np.linspace(0.0, 1.0, 7):
        across = make_interp_spline(grid[:5], along(a), bc_type=([(1, 0.0)], [(1, 0.0)]))
        for b in np.linspace(0.0, 0.8, 6):
            assert field.surface(a, b)[0] == pytest.approx(float(across(b)), abs=1e-15)
    x = np.array([0.43, 0.37, 0.09])
    found = field.distance(x)

    def normal_at(a, b):
        h, g, _ = field.surface(float(a), float(b))
        return [a - x[0] + (h - x[2]) * g[0], b - x[1] + (h - x[2]) * g[1]]

    a, b = (float(v) for v in mpmath.findroot(normal_at, (x[0], x[1]), tol=1e-24, verify=False))
    foot = np.array([a, b, field.surface(a, b)[0]])
    assert abs(found.phi) == pytest.approx(np.linalg.norm(x - foot), abs=1e-13)
    assert field.surface(-3.0, 0.4)[0] == field.surface(0.0, 0.4)[0]  # flat beyond the border


def test_convex_mesh_against_a_box():
    """A hull of a box's corners has the distance of that box, outside and within, by coal."""
    pytest.importorskip("coal")
    half = np.array([0.3, 0.2, 0.1])
    mesh = ConvexMesh(vertices=[half * [a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], pose=TILTED)
    box, rng = Box(half=half, edge=1e-12, pose=TILTED), np.random.default_rng(0)
    for x in rng.uniform(-0.6, 0.6, (100, 3)):
        one, other = mesh.from_world(x), box.from_world(x)
        assert one.phi == pytest.approx(other.phi, abs=1e-8)
        assert not one.S.any()
        if other.phi > 0.01:
            np.testing.assert_allclose(one.n, other.n, atol=1e-6)
    assert Touching({"a": [0, 0, 0]}, {"mesh": mesh}).without_machine_code == ("mesh",)


def test_box_against_sampled_distance():
    """The rounded box's distance is the least over its surface, sampled finely."""
    box = Box(half=[0.3, 0.2, 0.1], edge=0.05)
    rng = np.random.default_rng(1)
    inner = np.array([0.25, 0.15, 0.05])
    for _ in range(30):
        x = near(box, rng)
        nearest = np.clip(x, -inner, inner)
        assert abs(box.from_world(x).phi - (np.linalg.norm(x - nearest) - 0.05)) < 1e-15
    assert abs(box.from_world(np.array([0.0, 0.0, 0.06])).phi + 0.04) < 1e-15  # within: the nearest face


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: HalfSpace(normal=[0.0, 0.0, 2.0]), "unit vector"),
        (lambda: HalfSpace(friction=-0.1), "friction"),
        (lambda: Ball(radius=0.0), "radius"),
        (lambda: Ball(), "radius"),
        (lambda: Ball(radius=1.0, restitution=1.5), "restitution"),
        (lambda: Cone(angle=2.0), "half angle"),
        (lambda: Box(half=[0.1, 0.1, 0.1], edge=0.2), "smaller edge"),
        (lambda: Cylinder(radius=0.1, inside="yes"), "True or False"),
        (lambda: HalfSpace(ofset=0.4), "offset"),
        (lambda: HalfSpace(twist=[0, 0, 1]), "HalfSpace: twist"),
        (lambda: Hole(radius=0.1, chamfer=1e-5), "smaller edge"),
        (lambda: Hole(radius=0.1), "chamfer"),
        (lambda: Rod(radius=0.1, half_length=1e-5), "smaller edge"),
        (lambda: HeightField(heights=[[0.0, 1.0]], spacing=0.1), r"rows, columns"),
        (lambda: HeightField(heights=np.zeros((4, 4)), spacing=0.0), "spacing"),
        (lambda: ConvexMesh(vertices=np.zeros((3, 3))), r"\(m, 3\)"),
        (lambda: ConvexMesh(vertices=np.eye(4)[:, :3] * [1, 1, 0]), "one plane"),
        (lambda: Circle([0, 0, 0], [0, 0, 2.0], 0.1), "unit vector"),
        (lambda: Circle([0, 0, 0], [0, 0, 1.0], -0.1), "radius"),
        (lambda: Touching({}, {}, solids={"a": Rod(radius=1, half_length=1)}), "at least one"),
        (lambda: Touching({"a": [0, 0, 0]}, {"b": HalfSpace()}, edges={"a": [0, 0, 0]}), "every name once"),
        (lambda: Touching({"a": [0, 0, 0]}, {"b": HalfSpace()}, solids={"c": 3}), "expected a shape"),
        (lambda: Touching({"a": [0, 0, 0]}, {"b": HalfSpace()}, pairs=3), "pairs"),
        (lambda: Touching({"a": [0, 0, 0]}, {"b": HalfSpace()}, pairs=[[["a"], "b"]]), "pairs"),
        (lambda: Touching(points={}, world={"table": HalfSpace()}), "at least one"),
        (lambda: Touching(points={"tip": [0, 0]}, world={"table": HalfSpace()}), "tip"),
        (lambda: Touching(points={"tip": [0, 0, 0]}, world={"table": 3}), "expected a shape"),
        (lambda: Sphere([0, 0, 0], -1.0), "radius"),
        (lambda: corners(0.1, 0.0, 0.1), "y"),
        (lambda: hf.ClosedChain({}, hf.HeldObject.box(1.0, 1, 1, 1), {}, touching=3), "Touching"),
    ],
)
def test_wrong_shapes_are_named(make, says):
    """A wrong shape, point or value raises an error of the package that names it."""
    with pytest.raises(HoldfastError, match=says):
        make()


def test_chains_with_branches_are_refused():
    """Contacts with the world need serial arms that hold one object."""
    box, touching = (
        hf.HeldObject.box(1.0, 0.1, 0.1, 0.1),
        Touching(points=corners(0.1, 0.1, 0.1), world={"t": HalfSpace()}),
    )
    with pytest.raises(ModelError, match="touching: expected none in a chain with objects"):
        hf.ClosedChain({}, box, {}, objects={"lid": box}, touching=touching)


def test_fingerprints_know_touching():
    """Without touching the fingerprint is that of before; every number of a shape counts."""
    from holdfast.model.fingerprint import fingerprint

    box = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)
    plain = hf.ClosedChain({}, box, {})
    found = {fingerprint(plain)}
    for offset, mu in ((0.0, 0.1), (0.0, 0.2), (0.1, 0.1)):
        table = HalfSpace(offset=offset, friction=mu)
        found.add(
            fingerprint(hf.ClosedChain({}, box, {}, touching=Touching(points={"a": [0, 0, 0]}, world={"t": table})))
        )
    assert len(found) == 4
