"""Rank of the grasp constraint here, and in general (beyond.md 3).

Generic rank is the largest rank over a few closed neighbours. Rank = generic but deficient:
the forces are indeterminate everywhere, the accelerations are right. Rank < generic: this
configuration is singular, and the pointwise answer is not the trajectory's.
"""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.sequential import object_filter
from holdfast.dynamics.closed.tip_response import tip_response
from holdfast.dynamics.closing import close
from holdfast.dynamics.result import Status
from holdfast.errors import ClosureError, SingularChainError
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.state import Inputs, State

NEIGHBOURS = 8
NEIGHBOUR_DISTANCE = 0.1  # rad; metres for a prismatic joint and for the object


def constraint_rank(chain: ClosedChain, state: State) -> int:
    """Return the rank of [J, -A, H^T] at a configuration: the pivots the object filter keeps."""
    still = State(state.q, 0.0 * state.qd, state.object_pose)
    motion = chain_motion(chain, still, np.zeros(chain.joint_count), Inputs().shaped(chain))
    tips = [tip_response(arm, "auto") for arm in motion.holding]
    return int(object_filter(motion.contacts, tips, motion.body).rank)


def generic_constraint_rank(chain: ClosedChain, state: State) -> int:
    """Return the largest rank over 8 seeded closed neighbours about 0.1 rad away.

    A structure without closable neighbours is locked: its own rank is returned.
    """
    best = constraint_rank(chain, state)
    for seed in range(NEIGHBOURS):
        random = np.random.default_rng(seed)
        q = state.q + NEIGHBOUR_DISTANCE * random.uniform(-1, 1, len(state.q))
        turn, shift = NEIGHBOUR_DISTANCE * random.uniform(-1, 1, (2, 3))
        pose = np.concatenate(
            [
                rotation.quaternion_product(rotation.quaternion_exp(turn), state.object_pose[:4]),
                state.object_pose[4:] + shift,
            ]
        )
        try:
            neighbour = close(chain, State(q, 0.0 * q, pose), limits=False)
        except ClosureError:
            continue
        best = max(best, constraint_rank(chain, neighbour))
        if best == chain.constraint_row_count:
            break
    return best


def verdict(chain: ClosedChain, state: State, rank: int, generic: int | None = None) -> Status:
    """Return whether forces are unique at a configuration of the given rank.

    Raises:
        SingularChainError: the rank is below the generic rank.
    """
    rows = chain.constraint_row_count
    if rank == rows:
        return Status.OK
    generic = generic_constraint_rank(chain, state) if generic is None else generic
    if rank < generic:
        raise SingularChainError(
            f"the grasp constraint has rank {rank} of {rows} here but {generic} nearby: a singular configuration, where"
            " forces and accelerations are not those of any trajectory. holdfast.diagnose names the lost directions;"
            " try another posture or another grasp"
        )
    return Status.INDETERMINATE_FORCES
