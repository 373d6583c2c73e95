"""What the links look like: shapes in the frames that a viewer turns."""

import numpy as np
import pytest

from holdfast import SceneError
from holdfast.model.visuals import Box, Capsule, Cylinder, Mesh, Sphere
from holdfast.robots.urdf import urdf_chain, urdf_visuals
from tests.robots.two_armed import TWO_ARMED

ARM = {"base": "torso", "tip": "left_grasp", "lock_others": True}


def shown(text: str = TWO_ARMED, **options):
    """Return the visuals of an arm."""
    return urdf_visuals(urdf_chain(text, **{**ARM, **options}))


def test_one_list_a_body():
    """Base, then arm links; welded links' shapes stand in the arm link's frame."""
    base, upper, lower, hand = shown()
    assert [visual.link for visual in base] == ["torso"]
    assert base[0].shape == Box((0.3, 0.2, 0.4)) and base[0].rgba == (0.5, 0.5, 0.5, 1.0)
    np.testing.assert_allclose(base[0].pose.p, [0.0, 0.0, 0.2])
    assert upper[0].shape == Cylinder(0.05, 0.3) and upper[0].rgba is None
    assert lower == ()
    assert hand[0].shape == Mesh("package://two_armed/finger.stl", (1.0, -1.0, 1.0))
    np.testing.assert_allclose(hand[0].pose.p, [0.0, -0.01, 0.06], atol=1e-15)  # held at 0.01 along its turned y


def test_shapes():
    """Every primitive of the format."""
    for given, shape in {
        '<sphere radius="0.1"/>': Sphere(0.1),
        '<capsule radius="0.1" length="0.2"/>': Capsule(0.1, 0.2),
        '<mesh filename="a.dae"/>': Mesh("a.dae", (1.0, 1.0, 1.0)),
    }.items():
        assert shown(TWO_ARMED.replace('<box size="0.3 0.2 0.4"/>', given))[0][0].shape == shape


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("", r"link 'torso', visual, geometry: expected one of box, .*, got 0 of them"),
        ('<box size="1 2"/>', "geometry, box: size: expected 3 numbers"),
        ('<sphere radius="-1"/>', "sphere: radius: expected >= 0"),
        ("<mesh/>", "mesh: filename: expected a file name, got no such attribute"),
    ],
)
def test_shapes_that_are_none(given, said):
    """A picture's fault is told when the picture is asked for, and not before."""
    text = TWO_ARMED.replace('<box size="0.3 0.2 0.4"/>', given)
    chain = urdf_chain(text, **ARM)
    with pytest.raises(SceneError, match=said):
        urdf_visuals(chain)


def test_colours_by_name():
    """A material that is defined in one place colours all that name it; its own colour goes first."""
    own = '<material name="grey"><color rgba="1 0 0 1"/></material>'
    text = TWO_ARMED.replace('<material name="grey"/>', own)
    assert shown(text)[0][0].rgba == (1.0, 0.0, 0.0, 1.0)
    assert shown(TWO_ARMED.replace('<material name="grey"/>', '<material name="blue"/>'))[0][0].rgba is None
