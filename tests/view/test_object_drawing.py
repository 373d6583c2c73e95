"""The held object is drawn as what it is: radius, length and surface are those that were given."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import holdfast as hf
from holdfast.io.model_data import model_data, model_of
from holdfast.model.fingerprint import fingerprint
from holdfast.view.chain_scene import drawn_object
from tests.simulation.test_run_outputs import CORNERS, stl
from tests.view.runs import lifted

BALL, TUBE = hf.HeldObject.sphere(1.0, 0.07), hf.HeldObject.cylinder(1.0, 0.05, 0.3)


def test_sphere():
    """Every corner of the surface and every point of the outline is a radius from C."""
    surface, lines, edges, box = drawn_object(BALL)
    assert np.linalg.norm(surface.vertices, axis=1) == pytest.approx(0.07, rel=1e-6)
    assert np.linalg.norm(lines, axis=2) == pytest.approx(0.07)
    assert edges == pytest.approx(0.14, rel=0.02)
    assert box.p == pytest.approx(0, abs=2e-3)


def test_cylinder():
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
    part = hf.HeldObject.from_mesh(tmp_path / "part.stl", mass=1.0, scale=0.5)
    full = hf.HeldObject.from_mesh(tmp_path / "part.stl", mass=1.0)
    assert drawn_object(part)[0].vertices * 2.0 == pytest.approx(drawn_object(full)[0].vertices)
    (tmp_path / "part.stl").unlink()
    expected = drawn_object(replace(part, shape=None))[0].vertices
    assert np.array_equal(drawn_object(part)[0].vertices, expected)


def test_no_part_of_the_model():
    """A shape is neither in the fingerprint nor anything but kept; what is none is refused."""
    chain, _ = lifted()
    round_one = replace(chain, held_object=replace(chain.held_object, shape=BALL.shape))
    assert fingerprint(round_one) == fingerprint(chain)
    again = model_of(json.dumps(model_data(round_one)).encode(), "model.json")
    assert again.held_object.shape == BALL.shape
    with pytest.raises(hf.ModelError, match="object: shape"):
        replace(BALL, shape="ball")


@pytest.mark.parametrize(("held", "kind", "size"), [(BALL, "sphere", "0.07"), (TUBE, "cylinder", "0.05 0.15")])
def test_mjcf(held, kind, size):
    """The geom has MuJoCo's sizes: radius, and half the length."""
    chain, run = lifted()
    text = hf.interop.to_mjcf(replace(chain, held_object=held), run.state(0))
    geom = ElementTree.fromstring(text).find(".//body[@name='object']/geom")
    assert geom is not None
    assert (geom.get("type"), geom.get("size")) == (kind, size)
