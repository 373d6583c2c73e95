"""The response of a chain at rest: the object's filter without torques, velocities or gravity."""

from __future__ import annotations

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.object_filter import ObjectSolution, object_filter
from holdfast.dynamics.closed.tip_response import tip_response
from holdfast.dynamics.trunk.trunk_dynamics import filtered
from holdfast.spatial.scalar import each


def rest_response(motion: ChainMotion) -> ObjectSolution:
    """Return the mobility of the chain, and the rank and pivots of the constraint, at a configuration. O(n) + O(l).

    Args:
        motion: the chain at rest.
    """
    tips = each(lambda arm: tip_response(arm, "auto"), motion.holding)
    if motion.trunk is None:
        return object_filter(motion.contacts, tips, motion.body.free)
    lone = each(lambda arm: tip_response(arm, "auto"), [motion.arms[name] for name in motion.lone_on_trunk])
    return filtered(motion, tips, lone).found
