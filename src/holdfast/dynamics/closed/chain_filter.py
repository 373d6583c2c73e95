"""The filter of a chain, the object's filter or its extension through a trunk, and the response of a chain at rest."""

from __future__ import annotations

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.object_filter import ObjectSolution, object_filter
from holdfast.dynamics.closed.tip_response import TipResponse, tip_response
from holdfast.dynamics.trunk.trunk_filter import TrunkSolution, trunk_filter
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, each


def chain_filter(
    motion: ChainMotion,
    tips: list[TipResponse],
    lone: list[TipResponse],
    tolerance: float = RANK_TOLERANCE,
    second: tuple[list[Array], Array] | None = None,
) -> TrunkSolution:
    """Return the result of `object_filter` or, with a trunk, of `trunk_filter` for a chain.

    Args:
        motion: the chain's motion.
        tips: tip responses of the arms with a grasp.
        lone: tip responses of the arms on the trunk without one.
        tolerance: relative size of a pivot that counts as zero, if the contacts have masks of rows.
        second: a second right-hand side, see `object_filter`; only without a trunk.
    """
    if motion.trunk is None:
        return TrunkSolution(object_filter(motion.contacts, tips, motion.body.free, tolerance, second))
    grasps = dict(zip(motion.chain.grasps, zip(motion.contacts, tips, strict=True), strict=True))
    alone = dict(zip(motion.lone_on_trunk, lone, strict=True))
    return trunk_filter(motion.trunk, grasps, alone, motion.body.free, tolerance)


def rest_response(motion: ChainMotion) -> ObjectSolution:
    """Return the mobility of the chain, and the rank and pivots of the constraint, at a configuration. O(n) + O(l).

    Args:
        motion: the chain at rest, without torques, velocities or gravity.
    """
    tips = each(lambda arm: tip_response(arm, "auto"), motion.holding)
    lone = each(lambda arm: tip_response(arm, "auto"), [motion.arms[name] for name in motion.lone_on_trunk])
    return chain_filter(motion, tips, lone).found
