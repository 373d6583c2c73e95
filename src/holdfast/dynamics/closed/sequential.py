"""Algorithm `sequential`: the paper's Kalman filter extended across the arms, O(n) + O(l).

It handles every chain and every grasp. The paper solves Omega f = ... in O(l^3); here each arm is one more measurement
of alpha(C), and the arms are processed one after the other, in a forward and a backward pass.
"""

from __future__ import annotations

from collections.abc import Callable

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.held_rows import with_strongest_rows
from holdfast.dynamics.closed.object_filter import object_filter
from holdfast.dynamics.closed.tip_response import Route, TipResponse, responded, tip_response
from holdfast.dynamics.trunk.trunk_dynamics import trunk_dynamics
from holdfast.spatial.scalar import Array, each

Second = Callable[[list[TipResponse]], tuple[list[Array], Array]]


def sequential(motion: ChainMotion, route: Route = "auto", second: Second | None = None) -> Solution:
    """Return the closed-chain accelerations, by tip responses, the object's filter and back-substitution.

    Args:
        motion: the chain's motion.
        route: method for the tip responses, see `tip_response`.
        second: function of the tip responses that returns a second right-hand side, see `object_filter`. It is allowed
            only without a trunk and without a choice of rows.
    """
    if motion.trunk is not None:
        return trunk_dynamics(motion, route)
    tips = each(lambda arm: tip_response(arm, route), motion.holding)
    if motion.generic_rank is None:
        more = None if second is None else second(tips)
        found, held = object_filter(motion.contacts, tips, motion.body.free, second=more), None
    else:
        found, held = with_strongest_rows(motion, tips, motion.generic_rank)
    responses = each(responded, tips, found.wrenches)
    return Solution(
        qdd=[qdd for qdd, _ in responses],
        wrenches=found.wrenches,
        object_acceleration=found.object_acceleration,
        base_wrenches=[base for _, base in responses],
        pivots=[tip.pivots for tip in tips],
        rank=found.rank,
        weakest_pivot=found.weakest_pivot,
        held=held,
        tips=tips,
        solve_with_factors=found.solve_with_factors,
        second=found.second,
    )
