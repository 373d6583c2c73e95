"""What the held object is drawn as: the solid box of its mass and inertia, which for a box is itself."""

from __future__ import annotations

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

SMALLEST_EDGE = 1e-3  # m


def equivalent_box(held: HeldObject) -> tuple[Array, Pose]:
    """Return edges (3,) [m] and pose, in object axes, of the uniform box with the same inertia.

    x^2 = 6 (Jyy + Jzz - Jxx) / m along principal axes, about the mass centre.
    """
    J = held.inertia
    if np.count_nonzero(J - np.diag(np.diag(J))) == 0:  # keep the axes' order
        moments, axes = np.diag(J), np.eye(3)
    else:
        moments, axes = np.linalg.eigh(J)
        axes = axes * np.linalg.det(axes)
    squares = 6.0 * (moments.sum() - 2.0 * moments) / held.mass
    return np.sqrt(np.maximum(squares, SMALLEST_EDGE**2)), Pose(axes, held.com)


def box_lines(edges: Array) -> Array:
    """Return the twelve edges of a box about the origin as lines, (12, 2, 3) [m]."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * edges
    pairs = [(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit]
    return corners[np.array(pairs)]


def struts(chain: ClosedChain, edges: Array, box: Pose) -> Array:
    """Return lines from the box's middle to the contacts that lie off its surface, (N, 2, 3) object axes [m]."""
    lines = []
    for grasp in chain.grasps.values():
        outside = np.abs(box.R.T @ (grasp.frame.p - box.p)) - edges / 2
        if outside.max() > 0.02 * edges.max():
            lines.append([box.p, grasp.frame.p])
    return np.array(lines).reshape(-1, 2, 3)
