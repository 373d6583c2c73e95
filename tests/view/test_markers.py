"""The object's box has its inertia, the friction cone is the one meant, and arrows are of a handy length."""

import numpy as np
import pytest

from holdfast import ClosedChain, Grasp, HeldObject, Pose
from holdfast.robots import panda
from holdfast.robots.visuals import equivalent_box
from holdfast.spatial import rotation
from holdfast.view.figure_style import DANGER, GREEN, rgb
from holdfast.view.markers import arrow_scale, box_lines, cone_colour, cone_lines, contacts_on, struts
from tests.view.runs import played

FRAME = Pose(rotation.exp(np.array([0.3, -0.8, 0.5])), np.array([0.2, -0.1, 0.4]))
EDGES = np.array([0.3, 0.2, 0.1])


def test_a_box_is_itself():
    """Edges in their order, about the mass centre."""
    box = HeldObject.box(3.0, *EDGES)
    held = HeldObject(3.0, box.inertia, np.array([0.1, 0.0, -0.2]))
    edges, pose = equivalent_box(held)
    assert edges == pytest.approx(EDGES)
    assert np.abs(pose.R - np.eye(3)).max() == 0.0
    assert pose.p == pytest.approx([0.1, 0.0, -0.2])


def test_inertia_comes_back():
    """Whatever the axes, the box drawn has the object's inertia."""
    R = rotation.exp(np.array([0.4, 1.0, -0.3]))
    J = R @ HeldObject.box(2.0, *EDGES).inertia @ R.T
    edges, pose = equivalent_box(HeldObject(2.0, (J + J.T) / 2))
    assert np.linalg.det(pose.R) == pytest.approx(1.0)
    assert pose.R @ HeldObject.box(2.0, *edges).inertia @ pose.R.T == pytest.approx(J, abs=1e-12)


def test_edges():
    """Twelve lines, four of each length, along the axes."""
    lines = box_lines(EDGES)
    spans = np.abs(lines[:, 1] - lines[:, 0])
    assert sorted(spans.sum(axis=1)) == pytest.approx(np.repeat(np.sort(EDGES), 4))
    assert (np.count_nonzero(spans, axis=1) == 1).all()


def test_struts_reach_contacts_off_the_box():
    """A contact on the surface needs none; one outside is joined to the middle."""
    held = HeldObject.box(1.0, *EDGES)
    on, off = np.array([0.15, 0.05, 0.0]), np.array([0.0, 0.0, 0.4])
    grasps = {"a": Grasp("ball", Pose(np.eye(3), on)), "b": Grasp("ball", Pose(np.eye(3), off))}
    chain = ClosedChain({"a": panda(), "b": panda()}, held, grasps)
    lines = struts(contacts_on(chain, "object"), *equivalent_box(held))
    assert lines == pytest.approx(np.array([[[0, 0, 0], off]]))
    assert struts(contacts_on(chain.without_grasp("b"), "object"), *equivalent_box(held)).shape == (0, 2, 3)


def test_lines_lie_on_the_cone():
    """Every point is at |tangential| = mu normal, in the contact's axes; spokes begin at the contact."""
    points = (cone_lines(0.6, 0.1, FRAME) - FRAME.p) @ FRAME.R
    tangential, normal = np.linalg.norm(points[..., :2], axis=-1), points[..., 2]
    assert tangential == pytest.approx(0.6 * normal)
    assert normal.max() == pytest.approx(0.1)
    assert (np.linalg.norm(points, axis=-1).min(axis=1) < 1e-15).sum() == 12


def test_cone_colours():
    """Green with half of the hold left and more, vermillion at the edge, no way back in between."""
    assert cone_colour(1.0) == cone_colour(0.5) == rgb(GREEN)
    assert cone_colour(0.0) == cone_colour(0.03) == rgb(DANGER)
    reds = [cone_colour(reserve)[0] for reserve in np.linspace(0.25, 0.5, 9)]
    assert reds == sorted(reds, reverse=True)


def test_scale_is_round():
    """The largest force is 0.1 to 0.25 of an arm long, and 0.1 m are 1, 2 or 5 times a power of ten newtons."""
    playback = played()
    scale = arrow_scale(playback)
    longest = scale.force * np.linalg.norm(playback.wrench[..., 3:], axis=-1).max()
    assert 0.1 < longest < 0.4
    digits = f"{0.1 / scale.force:.6e}".split("e")[0].rstrip("0").rstrip(".")
    assert digits in {"1", "2", "5"}
