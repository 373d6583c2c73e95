"""Algorithm `sequential`: the paper's Kalman filter extended across the arms, O(n) + O(l).

It handles every chain and every grasp. The paper solves Omega f = ... in O(l^3); here each arm is one more measurement
of alpha(C), and the arms are processed one after the other, in a forward and a backward pass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.held_rows import holding, strongest_rows
from holdfast.dynamics.closed.object_filter import ObjectSolution, object_filter
from holdfast.dynamics.closed.tip_response import Route, TipResponse, responded, tip_response
from holdfast.dynamics.trunk.trunk_filter import TrunkSolution, trunk_filter
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, each

Second = Callable[[list[TipResponse]], tuple[list[Array], Array]]


def sequential(motion: ChainMotion, route: Route = "auto", second: Second | None = None) -> Solution:
    """Return the closed-chain accelerations, by tip responses, the object's filter and back-substitution.

    Args:
        motion: the chain's motion.
        route: method for the tip responses, see `tip_response`.
        second: function of the tip responses that returns a second right-hand side, see `object_filter`. It is not
            called with a trunk, nor for a choice of rows.
    """
    tips = each(lambda arm: tip_response(arm, route), motion.holding)
    lone = each(lambda arm: tip_response(arm, route), [motion.arms[name] for name in motion.lone_on_trunk])
    if motion.generic_rank is None:
        more = None if second is None or motion.trunk is not None else second(tips)
        whole, held = chain_filter(motion, tips, lone, second=more), None
    else:

        def solve(contacts: list[Contact], tolerance: float) -> ObjectSolution:
            return chain_filter(replace(motion, contacts=contacts), tips, lone, tolerance).found

        found, held = strongest_rows(solve, motion.contacts, motion.generic_rank)
        whole = TrunkSolution(found) if motion.trunk is None else chain_filter(holding(motion, held), tips, lone)
    found, betas = whole.found, [whole.of_columns(motion.trunk, name) for name in motion.chain.grasps]
    responses = each(responded, tips, found.wrenches, betas)
    return Solution(
        qdd=[qdd for qdd, _ in responses],
        wrenches=found.wrenches,
        object_acceleration=found.object_acceleration,
        base_wrenches=[base for _, base in responses],
        pivots=[tip.pivots for tip in tips],
        rank=found.rank,
        weakest_pivot=found.weakest_pivot,
        held=held,
        trunk=whole.trunk,
        trunk_pivots=whole.pivots,
        tips=tips,
        solve_with_factors=found.solve_with_factors,
        second=found.second,
    )


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
