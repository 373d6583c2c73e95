"""Algorithm `sequential`: the paper's Kalman filter extended across the arms, O(n) + O(l).

It handles every chain and every grasp. The paper solves Omega f = ... in O(l^3); here each arm is one more measurement
of alpha(C), and the arms are processed one after the other, in a forward and a backward pass: the elimination of the
chain's forest, in which every arm is a leaf (`tree.of_chain`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.held_rows import strongest_rows
from holdfast.dynamics.closed.tip_response import Route, TipResponse, responded, tip_response
from holdfast.dynamics.tree.of_chain import (
    ChainElimination,
    ChainLoads,
    RestResponse,
    chain_elimination,
    object_response,
)
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import each

Second = Callable[[Mapping[str, TipResponse]], ChainLoads]


def sequential(
    motion: ChainMotion,
    route: Route = "auto",
    second: Second | None = None,
    tips: Mapping[str, TipResponse] | None = None,
) -> Solution:
    """Return the closed-chain accelerations, by tip responses, the elimination of the object, and back-substitution.

    Args:
        motion: the chain's motion.
        route: method for the tip responses, see `tip_response`.
        second: function of the tip responses that returns a second right-hand side, see `chain_elimination`. It is not
            called for a choice of rows.
        tips: the tip responses as `tips_of` returns them, if they are known.
    """
    chain, tips = motion.chain, tips_of(motion, route) if tips is None else tips
    held, holding = None, [tips[name] for name in chain.grasps]

    def solve(
        contacts: list[Contact], tolerance: float = RANK_TOLERANCE, more: ChainLoads | None = None
    ) -> ChainElimination:
        return chain_elimination(chain, contacts, tips, motion.body.free, motion.trunk, tolerance, more)

    if motion.generic_rank is None:
        whole = solve(motion.contacts, more=None if second is None else second(tips))
    else:
        whole, held = strongest_rows(solve, motion.contacts, motion.generic_rank)
    bases = [whole.columns.get(name) for name in chain.grasps]
    responses = each(responded, holding, whole.wrenches, bases)
    return Solution(
        qdd=[qdd for qdd, _ in responses],
        wrenches=whole.wrenches,
        object_acceleration=whole.object_acceleration,
        base_wrenches=[base for _, base in responses],
        pivots=[tip.pivots for tip in holding],
        rank=whole.rank,
        weakest_pivot=whole.weakest_pivot,
        held=held,
        trunk=whole.trunk,
        trunk_pivots=whole.pivots,
        tips=holding,
        factors=whole.factors,
        second=whole.second,
    )


def tips_of(motion: ChainMotion, route: Route = "auto") -> dict[str, TipResponse]:
    """Return the tip responses of the arms with a grasp, and of those on the trunk without one."""
    names = [*motion.chain.grasps, *motion.lone_on_trunk]
    tips = each(lambda arm: tip_response(arm, route), motion.holding)
    lone = each(lambda arm: tip_response(arm, route), [motion.arms[name] for name in motion.lone_on_trunk])
    return dict(zip(names, [*tips, *lone], strict=True))


def tips_under(motion: ChainMotion, tips: Mapping[str, TipResponse]) -> dict[str, TipResponse]:
    """Return the tip responses of a motion by those of another one at the same configuration, with their factors."""
    arms = [motion.arms[name] for name in tips]
    return dict(zip(tips, each(_under_load, [*tips.values()], arms), strict=True))


def _under_load(tip: TipResponse, arm: ArmMotion) -> TipResponse:
    assert tip.for_load is not None
    return tip.for_load(arm)


def rest_response(motion: ChainMotion, tips: Mapping[str, TipResponse] | None = None) -> RestResponse:
    """Return the mobility of the chain, and the rank and pivots of the constraint, at a configuration. O(n) + O(l).

    Args:
        motion: the chain at rest, without torques, velocities or gravity.
        tips: the tip responses as `tips_of` returns them, if they are known.
    """
    known = tips_of(motion) if tips is None else tips
    return object_response(motion.chain, motion.contacts, known, motion.body.free, motion.trunk)
