"""Drawn shapes of the world lie on the surfaces that the object touches, and forces start where it does."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.simulation.summary import summarise
from holdfast.view.chain_scene import ChainScene, drawn_object
from holdfast.view.live import readout
from holdfast.view.markers import common_scale
from holdfast.view.page import panel_data
from holdfast.view.playback import playback_of_run
from holdfast.view.plots import figures
from holdfast.view.scene_writer import SceneWriter, viewer_server
from holdfast.view.summary_table import rows
from holdfast.view.world_drawing import placed_mesh, solids_of, touching_points
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
)

AT = hf.Pose.from_rpy(0.3, -0.5, 1.1, xyz=[0.4, -0.2, 0.7])
NEAR = np.array([0.5, 0.1, 0.6])


@pytest.mark.parametrize(
    "shape",
    [
        HalfSpace(normal=[0, 0.6, 0.8], offset=0.2, pose=AT),
        Ball(radius=0.3, pose=AT),
        Cylinder(radius=0.2, inside=True, pose=AT),
        Cone(angle=0.4, pose=AT),
        Box(half=[0.1, 0.2, 0.3], edge=1e-9, pose=AT),
        Hole(radius=0.1, chamfer=0.05, edge=0.02, pose=AT),
        Rod(radius=0.1, half_length=0.3, edge=0.02, pose=AT),
        HeightField(heights=0.05 * np.random.default_rng(1).normal(size=(5, 4)), spacing=0.2, pose=AT),
        ConvexMesh(vertices=np.random.default_rng(2).normal(size=(20, 3)), pose=AT),
    ],
    ids=lambda shape: type(shape).__name__,
)
def test_on_the_surface(shape):
    """No vertex is outside of the solid, and those of the surface are on it."""
    at, mesh = placed_mesh(shape, NEAR, 1.0)
    phi = np.array([shape.from_world(at.R @ x + at.p).phi for x in np.asarray(mesh.vertices, dtype=float)])
    assert np.abs(phi).min() < 1e-7
    if isinstance(shape, HalfSpace):
        assert phi.max() < 1e-12 and np.linalg.norm(at.p - NEAR) < abs(shape.from_world(NEAR).phi) + 0.1
    else:
        assert np.abs(phi).max() < 1e-7


@pytest.mark.slow
def test_a_run_without_arms():
    """A ball on a floor is drawn, with an arrow of its weight where it touches."""
    touching = Touching({"tip": Sphere([0, 0, 0], 0.1)}, {"floor": HalfSpace(friction=0.5)})
    chain = hf.ClosedChain({}, hf.HeldObject.sphere(2.0, 0.1), {}, touching=touching)
    start = hf.State([], [], hf.Pose.translation(0.3, 0, 0.1))
    run = hf.simulate(chain, start, lambda t, state, memory: (np.zeros(0), memory), 0.02, 0.01)
    playback = playback_of_run(chain, run)
    assert playback.touch_force is not None
    np.testing.assert_allclose(playback.touch_force[-1], [[0, 0, 19.62]], atol=1e-9)
    np.testing.assert_allclose(touching_points(playback, 0), [[0.3, 0, 0]], atol=1e-12)
    shown = panel_data(playback, common_scale([playback]))
    assert [plot["title"] for plot in shown["plots"]] == ["force of the world on the object [N]"]
    assert [curve["label"] for curve in shown["plots"][0]["curves"]] == ["floor"]
    assert shown["notes"][0].startswith("Dark grey arrows are forces of the world on the object (0.1")
    drawn = figures(chain, run)
    assert list(drawn) == ["world_forces", "closure_and_energy"]
    force, gap = drawn["world_forces"].axes
    np.testing.assert_allclose(force.lines[2].get_ydata()[-1], 19.62, atol=1e-9)
    assert force.get_title() == "floor" and len(gap.lines) == 1
    assert "worst condition of the grasps" not in dict(rows(summarise(chain, run)))
    assert not shown["meters"] and not shown["bars"]  # no grasps, whose condition would say something
    assert "grasps" not in readout(playback, 0) and "t = 0.000 s" in readout(playback, 0)
    with viewer_server() as server:
        ChainScene(SceneWriter(server), playback).show(len(playback) - 1)


def test_moving_shapes_and_circles():
    """A table that moves is drawn where it is in each frame, a rim with its object."""
    touching = Touching({"rim": Circle([0, 0, -0.1], [0, 0, 1], 0.1)}, {"table": HalfSpace()})
    chain = hf.ClosedChain({}, hf.HeldObject.cylinder(1.0, 0.1, 0.2), {}, touching=touching)

    def rising(t):
        return hf.Pose.translation(0, 0, t * t), [0, 0, 0, 0, 0, 2 * t], [0, 0, 0, 0, 0, 2]

    motion = {"table": rising}
    start = hf.State([], [], hf.Pose.translation(0, 0, 0.2))
    law = lambda t, state, memory: (np.zeros(0), memory)  # noqa: E731
    run = hf.simulate(chain, start, law, 0.04, 0.01, base_motion=motion, contacts="steps")
    playback = playback_of_run(chain, run, base_motion=motion)
    assert playback.touching[-1].world["table"].pose.p[2] == pytest.approx(0.04**2)
    np.testing.assert_allclose(touching_points(playback, -1)[:, 2], run.object_pose[-1, 6] - 0.1, atol=1e-12)
    with viewer_server() as server:
        ChainScene(SceneWriter(server), playback).show(len(playback) - 1)


def test_solids_of_the_object():
    """An object of unknown shape is drawn as the solids with which it touches the world, in its own axes."""
    peg = Rod(radius=0.01, half_length=0.03, edge=0.0005, pose=AT)
    edge = Circle([0, 0, 0], [0, 0, 1], 0.0102)
    touching = Touching({}, {}, solids={"peg": peg}, edges={"edge": edge})
    vertices = drawn_object(hf.HeldObject(2.0, 5e-3 * np.eye(3)), solids_of(touching, 1.0))[0].vertices
    inside = (vertices - AT.p) @ AT.R
    assert np.hypot(*inside[:, :2].T).max() == pytest.approx(0.01, abs=1e-6)
    assert np.ptp(inside[:, 2]) == pytest.approx(0.06, abs=1e-6)
    assert np.ptp(drawn_object(hf.HeldObject.sphere(1.0, 0.1), solids_of(touching, 1.0))[0].vertices[:, 0]) > 0.19
