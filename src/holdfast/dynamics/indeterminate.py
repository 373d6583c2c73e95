"""Grasp forces that the dynamics does not determine, and the choice of the smallest."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.stacked import block_diagonal
from holdfast.dynamics.constraint import constraint_rows, length_scale
from holdfast.spatial.scalar import Array

NULL_SINGULAR_VALUE = 1e-9
WORTH_A_WORD = 0.05  # smaller wrenches, relative to the largest of a pattern, are not mentioned


class WrenchDirections(NamedTuple):
    """Patterns of grasp wrenches, in order of decreasing effect on the joints and the object.

    Attributes:
        columns: (6l, rows) stacked wrenches f = K^T lambda about the contact points, world axes;
            orthonormal in the metric sum |moment / length|^2 + |force|^2.
        rank: number of patterns that have an effect; the others have none.
    """

    columns: Array
    rank: int


def wrench_directions(motion: ChainMotion, length: float, *, by_joints: bool = True) -> WrenchDirections:
    """Return the left singular vectors of K [J, -A], with moments divided by `length` [m].

    Args:
        motion: the chain's motion.
        length: length of the metric [m].
        by_joints: whether to include the columns K J of the joints. Without them, the patterns beyond the rank are the
            internal wrenches, A^T K^T lambda = 0.
    """
    rows = constraint_rows(motion)
    K = block_diagonal([c.K for c in motion.contacts])
    metric = np.tile(np.r_[np.full(3, 1 / length), np.ones(3)], len(motion.contacts))
    # angular unknowns are in units of 1/length, so that all entries are lengths
    scale = np.r_[np.full(3, 1.0), np.full(3, length)]
    used = slice(None if by_joints else 0)
    by_base = rows.base * scale if rows.base.size else rows.base
    matrix = np.hstack([rows.joints[:, used], rows.object * scale, by_base[:, used]])
    # each column (a joint) is scaled to unit length, so that the effect on a joint has no unit
    matrix = (K.T @ matrix) / metric[:, None]  # maps velocities to wrenches in metric units
    sizes = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, sizes > 0] / sizes[sizes > 0]
    basis, _ = np.linalg.qr((K * metric).T)  # transmitted wrenches in metric units
    U, s, _ = np.linalg.svd(basis.T @ matrix)
    rank = int((s > NULL_SINGULAR_VALUE * max(s.max(initial=0.0), 1e-300)).sum())
    return WrenchDirections((basis @ U) / metric[:, None], rank)


def free_wrenches(motion: ChainMotion, length: float, rank: int | None = None) -> Array:
    """Return a basis of the grasp wrenches without effect on any joint or on the object.

    ker (K Omega K^T) = {lambda: J^T K^T lambda = 0 and A^T K^T lambda = 0}, with moments
    divided by `length` [m].

    Args:
        motion: the chain's motion.
        length: length of the metric [m].
        rank: rank of the constraint, if known. It is needed if the grasps are slightly open, because then the effect of
            these wrenches is small but not zero.

    Returns:
        (6l, k): columns of `WrenchDirections`.
    """
    directions = wrench_directions(motion, length)
    freedoms = motion.chain.contact_freedom_count
    return directions.columns[:, directions.rank if rank is None else rank - freedoms :]


def pattern(motion: ChainMotion, wrenches: Array, length: float) -> str:
    """Return the description of a pattern of grasp wrenches, in world axes.

    Args:
        motion: the chain's motion.
        wrenches: (grasps, 6) about the contact points, world axes, scaled so that the largest is 1.
        length: length by which moments are divided [m].
    """
    parts = []
    metric = np.r_[np.full(3, 1 / length), np.ones(3)]
    for name, c, f in zip(motion.chain.grasps, motion.contacts, wrenches, strict=True):
        size = np.abs(f * metric)
        if size.max() < WORTH_A_WORD:
            continue
        kind = "force" if size[3:].max() >= size[:3].max() else "moment"
        axis = f[3:] if kind == "force" else f[:3]
        x, y, z = axis / np.linalg.norm(axis)
        parts.append(f"{kind} ({x:+.2f}, {y:+.2f}, {z:+.2f}) at '{name}' ({c.grasp.kind})")
    return " against ".join(parts) + " (world axes)"


def with_smallest_forces(motion: ChainMotion, found: Solution) -> Solution:
    """Return the solution with the grasp forces of least norm, sum |moment/L|^2 + |force|^2."""
    length = length_scale([c.offset for c in motion.contacts])
    N = free_wrenches(motion, length, None if found.rank is None else int(found.rank))
    metric = np.tile(np.r_[np.full(3, 1 / length), np.ones(3)], len(motion.contacts))
    f = np.concatenate(found.wrenches)
    smallest = f - N @ ((N * metric[:, None]).T @ (metric * f))
    return replace(found, wrenches=list(smallest.reshape(-1, 6)), base_wrenches=None)  # they belong to other forces
