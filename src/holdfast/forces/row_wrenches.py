"""The wrenches at the grasps and loops of a chain that is answered as a forest, in contact axes.

They are those of body a on body b, which carries the contact frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from holdfast.dynamics.tree.mechanism_terms import flat_state
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import GraspRow
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import unrotate
from holdfast.state import State


def contact_wrenches(chain: ClosedChain, state: State, wrench: Array, rows: Mapping[int, GraspRow]) -> dict[int, Array]:
    """Return wrenches (6,) in contact axes, by their places. O(rows), and O(bodies) with loops between links.

    Args:
        chain: the chain.
        state: positions.
        wrench: (places, 6) wrenches about the contact points, world axes.
        rows: closed grasps and loops, by their places.
    """
    R = attitudes(chain, state, [row.body for row in rows.values()])
    axes = {i: E @ row.grasp.frame.R for (i, row), E in zip(rows.items(), R, strict=True) if row.grasp is not None}
    return {i: unrotate(frame, wrench[i]) for i, frame in axes.items()}


def attitudes(chain: ClosedChain, state: State, bodies: Sequence[int]) -> list[Array]:
    """Return the attitudes (3, 3) of bodies of a chain's forest; O(1) each if all are objects."""
    first = len(chain.as_forest.forest.bodies) - len(chain.free_objects)
    if min(bodies, default=first) < first:
        poses = chain.as_forest.forest.poses(flat_state(chain, state)[0])
        return [poses[body].R for body in bodies]
    of_objects = np.reshape(state.object_pose, (-1, 7))
    return [rotation.from_quaternion(of_objects[body - first, :4]) for body in bodies]
