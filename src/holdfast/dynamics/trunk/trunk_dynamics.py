"""Algorithm `sequential` for arms on a trunk: tip responses, the filter through the trunk, and back-substitution."""

from __future__ import annotations

from dataclasses import replace

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.held_rows import holding, strongest_rows
from holdfast.dynamics.closed.object_filter import ObjectSolution
from holdfast.dynamics.closed.tip_response import Route, TipResponse, responded, tip_response
from holdfast.dynamics.trunk.trunk_filter import TrunkSolution, trunk_filter
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import each


def trunk_dynamics(motion: ChainMotion, route: Route = "auto") -> Solution:
    """Return the closed-chain accelerations of a chain with arms on a trunk. O(n) + O(l).

    Args:
        motion: the motion of a chain with a trunk.
        route: method for the tip responses, see `tip_response`.
    """
    trunk = motion.trunk
    assert trunk is not None
    tips = each(lambda arm: tip_response(arm, route), motion.holding)
    lone = each(lambda arm: tip_response(arm, route), [motion.arms[name] for name in motion.lone_on_trunk])
    held = None
    if motion.generic_rank is not None:

        def solve(contacts: list[Contact], tolerance: float) -> ObjectSolution:
            return filtered(replace(motion, contacts=contacts), tips, lone, tolerance).found

        _, held = strongest_rows(solve, motion.contacts, motion.generic_rank)
        motion = holding(motion, held)
    whole = filtered(motion, tips, lone)
    betas = [trunk.of_columns(name, whole.trunk, whole.betas) for name in motion.chain.grasps]
    responses = each(responded, tips, whole.found.wrenches, betas)
    return Solution(
        qdd=[qdd for qdd, _ in responses],
        wrenches=whole.found.wrenches,
        object_acceleration=whole.found.object_acceleration,
        base_wrenches=[base for _, base in responses],
        pivots=[tip.pivots for tip in tips],
        rank=whole.found.rank,
        weakest_pivot=whole.found.weakest_pivot,
        trunk=whole.trunk,
        trunk_pivots=whole.pivots,
        held=held,
        tips=tips,
    )


def filtered(
    motion: ChainMotion, tips: list[TipResponse], lone: list[TipResponse], tolerance: float = RANK_TOLERANCE
) -> TrunkSolution:
    """Return the result of `trunk_filter` for a chain.

    Args:
        motion: the motion of a chain with a trunk.
        tips: tip responses of the arms with a grasp.
        lone: tip responses of the arms on the trunk without one.
        tolerance: relative size of a pivot that counts as zero, if the contacts have masks of rows.
    """
    assert motion.trunk is not None
    grasps = dict(zip(motion.chain.grasps, zip(motion.contacts, tips, strict=True), strict=True))
    alone = dict(zip(motion.lone_on_trunk, lone, strict=True))
    return trunk_filter(motion.trunk, grasps, alone, motion.body.free, tolerance)
