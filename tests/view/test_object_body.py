"""The object is drawn as the box that has its inertia."""

import numpy as np
import pytest

from holdfast import ClosedChain, Grasp, HeldObject, Pose
from holdfast.robots import panda
from holdfast.spatial import rotation
from holdfast.view.object_body import box_lines, equivalent_box, struts

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
    lines = struts(chain, *equivalent_box(held))
    assert lines == pytest.approx(np.array([[[0, 0, 0], off]]))
    assert struts(chain.without_grasp("b"), *equivalent_box(held)).shape == (0, 2, 3)
