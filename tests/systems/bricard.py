"""Bricard's mechanism: a spatial loop of five bars and six hinges that moves although it should not.

One row of its constraint follows from the others, in every configuration. IFToMM benchmark A04; geometry and masses as
in its definition (RehabEngGroup/MBSbenchmarksInOpenSim, help/benchmarks/A04_BricardsMechanism.rst).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Joint, Link, Pose, State
from holdfast.dynamics import motion_basis

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]], dtype=float)  # m
AXES = np.eye(3)[[1, 2, 0, 1, 2, 0]]
MASS, LENGTH, WIDTH = 1.0, 1.0, 0.1


def bricard(turns: tuple[float, float] = (0.0, 0.0)) -> tuple[ClosedChain, State]:
    """Return the mechanism at rest: two arms of two bars from the ground, and the middle bar on two hinges.

    Args:
        turns: of the contact frames about the hinges [rad]; the motion does not depend on them.
    """
    left, right = (_across(axis, turn) for axis, turn in zip(AXES[2:4], turns, strict=True))
    centre = (POINTS[2] + POINTS[3]) / 2
    arms = {"left": _arm((0, 1, 2), left), "right": _arm((5, 4, 3), right)}
    grasps = {
        "left": Grasp("hinge", Pose(left, POINTS[2] - centre)),
        "right": Grasp("hinge", Pose(right, POINTS[3] - centre)),
    }
    chain = ClosedChain(arms, HeldObject(MASS, _inertia(2, 3)), grasps, gravity=(0.0, -9.81, 0.0))
    return chain, State(np.zeros(4), np.zeros(4), [1, 0, 0, 0, *centre], np.zeros(6))


def line_symmetric(seed: int) -> tuple[ClosedChain, State]:
    """Return another loop of six hinges that moves, at random, in motion.

    Where a half turn about a line takes every hinge to the one opposite, the loop has a freedom (Bricard 1927).
    """
    random = np.random.default_rng(seed)
    half_turn = np.diag([-1.0, -1.0, 1.0])
    points, axes = random.normal(scale=0.5, size=(3, 3)), random.normal(size=(3, 3))
    points = np.concatenate([points, points @ half_turn])
    axes = np.concatenate([axes, axes @ half_turn])
    axes = axes / np.linalg.norm(axes, axis=1)[:, None]
    arms, grasps, centre = {}, {}, (points[2] + points[3]) / 2
    for name, order in (("left", (0, 1, 2)), ("right", (5, 4, 3))):
        joints, links, before = [], [], np.zeros(3)
        for i, j in pairwise(order):
            joints.append(Joint("revolute", axes[i], Pose(np.eye(3), points[i] - before)))
            shape = random.uniform(0.05, 0.1, size=3)
            links.append(Link(random.uniform(0.5, 2.0), (points[j] - points[i]) / 2, np.diag(shape)))
            before = points[i]
        across = _across(axes[order[2]], random.uniform(-3, 3))
        arms[name] = Arm(joints, links, tip=Pose(across, points[order[2]] - before))
        grasps[name] = Grasp("hinge", Pose(across, points[order[2]] - centre))
    body = HeldObject(random.uniform(0.5, 2.0), np.diag(random.uniform(0.05, 0.1, size=3)))
    chain = ClosedChain(arms, body, grasps)
    still = State(np.zeros(4), np.zeros(4), [1, 0, 0, 0, *centre], np.zeros(6))
    (way,) = motion_basis(chain, still).T
    way = random.uniform(0.5, 1.5) * way / np.abs(way).max()
    return chain, State(still.q, way[:4], still.object_pose, way[4:])


def bars(chain: ClosedChain, state: State) -> np.ndarray:
    """Return the turns of the five bars from the start as matrices, and where their first ends are, (5, 3, 4)."""
    found = []
    for name, points in (("left", (0, 1)), ("right", (5, 4))):
        R, p, at = np.eye(3), POINTS[points[0]], []
        for point, angle, end in zip(points, state.q[chain.joints[name]], (points[1], None), strict=True):
            R = R @ _turn(AXES[point], angle)
            at.append((R, p, point))
            if end is not None:
                p = p + R @ (POINTS[end] - POINTS[point])
        found.append(at)
    (first, second), (last, fourth) = found
    middle = state.object_frame.R, state.object_frame.p + state.object_frame.R @ (POINTS[2] - POINTS[3]) / 2
    # the right arm's bars begin, for the benchmark, at their other ends
    from_right = [(R, p + R @ (POINTS[k - 1] - POINTS[k])) for R, p, k in (fourth, last)]
    return np.array([np.column_stack(bar) for bar in (first[:2], second[:2], middle, *from_right)])


def _arm(points: Sequence[int], tip: np.ndarray) -> Arm:
    joints, links, before = [], [], np.zeros(3)
    for point, end in pairwise(points):
        joints.append(Joint("revolute", AXES[point], Pose(np.eye(3), POINTS[point] - before)))
        links.append(Link(MASS, (POINTS[end] - POINTS[point]) / 2, _inertia(point, end)))
        before = POINTS[point]
    return Arm(joints, links, tip=Pose(tip, POINTS[points[-1]] - before))


def _inertia(i: int, j: int) -> np.ndarray:
    """Return the inertia of the bar between two points about its mass centre, world axes at the start."""
    along = np.outer(POINTS[j] - POINTS[i], POINTS[j] - POINTS[i]) / LENGTH**2
    return MASS / 12 * ((LENGTH**2 + WIDTH**2) * (np.eye(3) - along) + 2 * WIDTH**2 * along)


def _across(axis: np.ndarray, turn: float) -> np.ndarray:
    """Return a frame whose x axis is a hinge's, turned about it."""
    other = np.roll(axis, 1)
    side = other - (other @ axis) * axis
    side = side / np.linalg.norm(side)
    return np.column_stack([axis, side, np.cross(axis, side)]) @ _turn(np.eye(3)[0], turn)


def _turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return the rotation about a coordinate axis."""
    K = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
