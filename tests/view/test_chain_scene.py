"""What is drawn is where the library's own kinematics has it, as what it is; arrows are the wrenches."""

import contextlib
import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from holdfast import HeldObject, Pose, Spring, interop
from holdfast.dynamics import link_poses
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.errors import ModelError
from holdfast.io.model_data import model_data, model_of
from holdfast.model.fingerprint import fingerprint
from holdfast.view.chain_scene import ChainScene, drawn_object
from holdfast.view.markers import ArrowScale, cone_colour
from tests.simulation.test_run_outputs import CORNERS, stl
from tests.view.runs import lifted, played

BALL, TUBE = HeldObject.sphere(1.0, 0.07), HeldObject.cylinder(1.0, 0.05, 0.3)


class Notebook:
    """Takes down what a scene writer is told."""

    def __init__(self):
        self.drawn, self.poses, self.pointed, self.colours = {}, {}, {}, {}

    def frame(self, name, at, axes=0.0):
        self.drawn[name], self.poses[name] = "frame", at

    def mesh(self, name, mesh, colour, opacity=None):
        self.drawn[name] = "mesh"

    def lines(self, name, segments, colour, thickness):
        self.drawn[name], self.colours[name] = "lines", colour

    def redraw(self, name, segments):
        assert self.drawn[name] == "lines"
        self.pointed[name] = segments

    def grid(self, name, at, width, cell):
        self.drawn[name] = "grid"

    def label(self, name, text, position):
        self.drawn[name] = text

    def arrows(self, name, count, colour, shaft):
        self.drawn[name], self.colours[name] = count, colour

    def point(self, name, segments):
        assert len(segments) == self.drawn[name]
        self.pointed[name] = segments

    def place(self, name, wxyz, position):
        assert self.drawn[name] == "frame"
        self.poses[name] = Pose.from_wxyz_xyz(np.concatenate([wxyz, position]))

    def paint(self, name, colour):
        self.colours[name] = colour

    def set_camera(self, camera, up):
        self.camera = camera

    at_once = contextlib.nullcontext

    def world_pose(self, name):
        """Return the pose of a node through all that it is named under."""
        pose, parts = Pose.identity(), name.split("/")
        for k in range(2, len(parts) + 1):
            pose = pose @ self.poses.get("/".join(parts[:k]), Pose.identity())
        return pose


@pytest.fixture(scope="module")
def shown():
    playback, notebook = played(), Notebook()
    return playback, notebook, ChainScene(notebook, playback)


@pytest.mark.parametrize("k", [0, 3])
def test_links_and_object(shown, k):
    """Composed along their names, the nodes' poses are those of configuration; so at any moment, in any order."""
    playback, notebook, scene = shown
    scene.show(k)
    for i, (name, arm) in enumerate(playback.chain.arms.items()):
        joints = [joint.name for joint in arm.joints]
        at = forward_kinematics(arm, playback.q[k, playback.chain.joints[name]])
        for j in range(arm.joint_count):
            node = notebook.world_pose("/".join(["/arms", name, *joints[: j + 1]]))
            assert np.abs(node.R - at.R[j]).max() < 1e-12
            assert node.p == pytest.approx(at.tip.p - at.reach[j], abs=1e-12)
        assert (node @ arm.tip).p == pytest.approx(playback.tip[k, i], abs=1e-12)
    contact = notebook.world_pose("/object/contacts/left")
    assert contact.p == pytest.approx(playback.tip[k, 0], abs=1e-9)


def test_arrows(shown):
    """Forces and moments go out from the tips, to scale; the internal force beside them; a moment has two heads."""
    playback, notebook, scene = shown
    scene.show(2)
    for i, name in enumerate(playback.chain.names):
        tip, wrench = playback.tip[2, i], playback.wrench[2, i]
        assert notebook.pointed[f"/forces/{name}"] == pytest.approx(
            np.array([[tip, tip + scene.scale.force * wrench[3:]]])
        )
        heads = notebook.pointed[f"/moments/{name}"][:, 1]
        assert heads[0] == pytest.approx(tip + scene.scale.moment * wrench[:3])
        (internal_force,) = notebook.pointed[f"/internal_force/{name}"]
        internal = playback.internal[2, i, 3:]
        assert internal_force[1] - internal_force[0] == pytest.approx(scene.scale.force * internal)
        assert (internal_force[0] - tip) @ internal == pytest.approx(0.0, abs=1e-9)
        assert 0.01 < np.linalg.norm(internal_force[0] - tip) < 0.1


def test_arrow_length_can_change(shown):
    """A longer scale, longer arrows."""
    _, notebook, scene = shown
    usual = scene.scale
    scene.show(2)
    before = notebook.pointed["/forces/left"]
    scene.scale = ArrowScale(3 * usual.force, 3 * usual.moment)
    scene.show(2)
    after = notebook.pointed["/forces/left"]
    scene.scale = usual
    assert after[0, 1] - after[0, 0] == pytest.approx(3 * (before[0, 1] - before[0, 0]))


def test_cones_turn_red(shown):
    """The cone's colour is that of its reserve; at the end of this run the contacts would slip."""
    playback, notebook, scene = shown
    for k in (0, len(playback) - 1):
        scene.show(k)
        assert notebook.colours["/object/cones/right"] == cone_colour(float(playback.reserve("right")[k]))
    assert notebook.colours["/object/cones/right"] == cone_colour(0.0)
    scene.show(0)
    assert notebook.colours["/object/cones/right"] != cone_colour(0.0)


def test_one_colour_an_arm(shown):
    """Force and moment of an arm share its colour, arms differ, the internal force has its own."""
    _, notebook, _ = shown
    colours = notebook.colours
    assert colours["/forces/left"] == colours["/moments/left"] != colours["/forces/right"]
    assert colours["/internal_force/left"] == colours["/internal_force/right"] not in (
        colours["/forces/left"], colours["/forces/right"],
    )  # fmt: skip
    assert notebook.drawn["/arms/left/(name)"] == "left"


def test_springs(shown):
    """A coil goes from end to end of every spring, wherever these have moved."""
    playback, _, _ = shown
    (name, arm), *_ = playback.chain.arms.items()
    springs = [
        Spring((name, 3, (0, 0, 0)), ("object", (0, 0, 0.1)), 5.0),
        Spring(("world", (0, 0, 1)), ("world", (0, 0, 1)), 5.0),
    ]
    sprung = replace(playback, chain=replace(playback.chain, springs=springs))
    notebook = Notebook()
    scene = ChainScene(notebook, sprung)
    for k in (0, len(playback) - 1):
        scene.show(k)
        lines = notebook.pointed["/springs/0"]
        link = link_poses(arm, playback.q[k, playback.chain.joints[name]])[3]
        frame = Pose.from_wxyz_xyz(playback.object_pose[k])
        assert lines[0, 0] == pytest.approx(link.p)
        assert lines[-1, 1] == pytest.approx(frame.p + 0.1 * frame.R[:, 2])
        assert np.array_equal(lines[1:, 0], lines[:-1, 1])
        assert np.isfinite(notebook.pointed["/springs/1"]).all()


def test_sphere_as_object():
    """Every corner of the surface and every point of the outline is a radius from C."""
    surface, lines, edges, box = drawn_object(BALL)
    assert np.linalg.norm(surface.vertices, axis=1) == pytest.approx(0.07, rel=1e-6)
    assert np.linalg.norm(lines, axis=2) == pytest.approx(0.07)
    assert edges == pytest.approx(0.14, rel=0.02)
    assert box.p == pytest.approx(0, abs=2e-3)


def test_cylinder_as_object():
    """The outline lies on the side, from end to end; so do the surface's corners off the axis."""
    surface, lines, edges, _ = drawn_object(TUBE)
    assert np.linalg.norm(lines[..., :2], axis=2) == pytest.approx(0.05)
    assert np.abs(lines[..., 2]) == pytest.approx(0.15)
    far = np.linalg.norm(surface.vertices[:, :2], axis=1)
    assert far.max() == pytest.approx(0.05)
    assert np.abs(surface.vertices[:, 2]).max() == pytest.approx(0.15)
    assert edges[2] == pytest.approx(0.3)


def test_mesh_and_one_that_is_gone(tmp_path):
    """The file's own corners, scaled; the box of the inertia once the file is no more."""
    (tmp_path / "part.stl").write_text(stl(CORNERS))
    part = HeldObject.from_mesh(tmp_path / "part.stl", mass=1.0, scale=0.5)
    full = HeldObject.from_mesh(tmp_path / "part.stl", mass=1.0)
    assert drawn_object(part)[0].vertices * 2.0 == pytest.approx(drawn_object(full)[0].vertices)
    (tmp_path / "part.stl").unlink()
    expected = drawn_object(replace(part, shape=None))[0].vertices
    assert np.array_equal(drawn_object(part)[0].vertices, expected)


def test_a_shape_is_no_part_of_the_model():
    """A shape is neither in the fingerprint nor anything but kept; what is none is refused."""
    chain, _ = lifted()
    round_one = replace(chain, held_object=replace(chain.held_object, shape=BALL.shape))
    assert fingerprint(round_one) == fingerprint(chain)
    again = model_of(json.dumps(model_data(round_one)).encode(), "model.json")
    assert again.held_object.shape == BALL.shape
    with pytest.raises(ModelError, match="object: shape"):
        replace(BALL, shape="ball")


@pytest.mark.parametrize(("held", "kind", "size"), [(BALL, "sphere", "0.07"), (TUBE, "cylinder", "0.05 0.15")])
def test_object_in_mjcf(held, kind, size):
    """The geom has MuJoCo's sizes: radius, and half the length."""
    chain, run = lifted()
    text = interop.to_mjcf(replace(chain, held_object=held), run.state(0))
    geom = ElementTree.fromstring(text).find(".//body[@name='object']/geom")
    assert geom is not None
    assert (geom.get("type"), geom.get("size")) == (kind, size)
