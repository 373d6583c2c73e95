"""The elimination of a forest in the order of its plan, inward and outward again; O(bodies) for a bounded front.

Inward, every body settles at its parent, and every part condenses at its root to an inertia N and a load n. Outward,
with the acceleration of the root known, the steps of the part are taken in reverse. The root of a tree is the world or
a free body, whose acceleration is I^-1 (w - z) in the end.

The factors do not depend on the loads; with them, any right-hand side is solved (`solve`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from types import MappingProxyType
from typing import Any

import numpy as np

from holdfast.dynamics.tree.belief import empty_belief
from holdfast.dynamics.tree.branches import ForestPart
from holdfast.dynamics.tree.crossing import columns_of
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.leaf import leaves_of
from holdfast.dynamics.tree.order import Cross, CrossAll, MeasureLeaves, PlanStep
from holdfast.dynamics.tree.outward import STEPS, Condensed, ForestFactors, ForestSolution, outward
from holdfast.dynamics.tree.plan import EliminationPlan, Settle
from holdfast.dynamics.tree.right_hand_sides import ForestLoads, Inward, Outward
from holdfast.dynamics.tree.settled import Settling
from holdfast.dynamics.tree.steps import PartMotion
from holdfast.model.forest import GROUND
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar, maximum
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.spatial.symmetric import symmetric6

Accelerations = Mapping[int, Array] | Sequence[Array]
Tips = Mapping[tuple[int, bool], Array]


def solved(motion: ForestMotion, plan: EliminationPlan) -> ForestSolution:
    """Return the accelerations and forces of a forest, after taking back what rounding left of its closures.

    A joint's acceleration is found from the forces on it, of which large ones that nearly balance leave few digits. The
    same factors, with what is left of the rows as their right-hand sides, bring them back.

    Args:
        motion: its motion.
        plan: the order.
    """
    factors, (found,) = factorised(motion, plan)
    first = factors.solution(found)
    (rest,) = solve(factors, [right_hand_side(motion.at_rest_with(*left_over(motion, first.qdd, first.beta)))])
    again = factors.solution(rest)

    def both(x: list[Any], y: list[Any]) -> list[Any]:
        return [a + b for a, b in zip(x, y, strict=True)]

    return first._replace(
        qdd=both(first.qdd, again.qdd),
        beta=both(first.beta, again.beta),
        wrenches=both(first.wrenches, again.wrenches),
        multipliers=both(first.multipliers, again.multipliers),
    )


def left_over(
    motion: ForestMotion, qdd: Accelerations, beta: Accelerations, tips: Tips = MappingProxyType({})
) -> tuple[list[Array], list[Scalar]]:
    """Return what accelerations leave of the rows of closures, (rows,) each, and of couplings: r - G qdd.

    Args:
        motion: the forest's motion.
        qdd: by body, (m,) joint accelerations.
        beta: by body, (6,) acceleration that the joints add; none of bodies within limbs.
        tips: by closure, and whether its body b ends a limb, the acceleration of the limb's tip, (6,).
    """
    gaps = []
    for i, c in enumerate(motion.closures):
        a, b = (_at_contact(motion, beta, tips, i, is_b=is_b) for is_b in (False, True))
        gaps.append(c.r - b if motion.topology.ends[i][0] == GROUND else c.r - (b - a))
    rows = zip(motion.couplings, motion.coupled, strict=True)
    return gaps, [r - sum(c * qdd[k][component] for k, component, c in terms) for terms, r in rows]


def contradictions(
    motion: ForestMotion, qdd: Accelerations, beta: Accelerations, tips: Tips = MappingProxyType({})
) -> list[Scalar]:
    """Return what is left of every closure and then of every coupling, relative to its terms; see `left_over`."""
    gaps, coupled = left_over(motion, qdd, beta, tips)
    relative = []
    for i, (c, gap) in enumerate(zip(motion.closures, gaps, strict=True)):
        size = reduce(maximum, map(abs, [*_at_contact(motion, beta, tips, i, is_b=True), *c.r]), 1.0)
        relative.append(reduce(maximum, map(abs, gap), 0.0) / size)
    for terms, gap in zip(motion.couplings, coupled, strict=True):
        size = reduce(maximum, (abs(c * qdd[k][component]) for k, component, c in terms), 1.0)
        relative.append(abs(gap) / size)
    return relative


def _at_contact(motion: ForestMotion, beta: Accelerations, tips: Tips, i: int, *, is_b: bool) -> Array:
    """Return K phi^T beta of a body of a closure, (rows,), 0 of the world; that of a limb has its free part."""
    c, k = motion.closures[i], motion.topology.ends[i][is_b]
    if (i, is_b) in tips:
        return c.contact.transmitted(tips[i, is_b])
    if k == GROUND:
        return np.zeros(len(c.contact.rows))
    return c.contact.transmitted(shift_twist(c.l_b if is_b else c.l_a, beta[k]))


def eliminated(motion: ForestMotion, plan: EliminationPlan) -> ForestSolution:
    """Return the accelerations and forces of a forest, as the elimination leaves them; see `solved`."""
    factors, (found,) = factorised(motion, plan)
    return factors.solution(found)


def right_hand_side(motion: ForestMotion) -> ForestLoads:
    """Return the loads and the right-hand sides of a forest's motion."""
    free = {k: body for k, body in enumerate(motion.bodies) if body is not None and body.free is not None}
    return ForestLoads(
        motion.bodies,
        {k: body.free.acceleration - body.at.zeta for k, body in free.items()},
        motion.closures,
        motion.coupled,
        motion.all_limbs,
    )


def factorised(
    motion: ForestMotion,
    plan: EliminationPlan,
    tolerance: float = RANK_TOLERANCE,
    others: Sequence[ForestLoads] = (),
) -> tuple[ForestFactors, list[Outward]]:
    """Return the factors of a forest's equations, and the solutions for its own loads and for others.

    Args:
        motion: its motion.
        plan: the order.
        tolerance: relative size of a pivot that counts as zero.
        others: further right-hand sides.
    """
    factors, sides = inward(motion, plan, tolerance, others)
    return factors, outward(factors, sides)


def inward(
    motion: ForestMotion, plan: EliminationPlan, tolerance: float = RANK_TOLERANCE, others: Sequence[ForestLoads] = ()
) -> tuple[ForestFactors, list[Inward]]:
    """Return the factors, and every right-hand side carried inward; arguments as in `factorised`."""
    sides = [Inward.of(rhs) for rhs in (right_hand_side(motion), *others)]
    settling, parts = Settling.of(motion), dict[int, Condensed]()
    for step in plan.inward:
        if isinstance(step, Settle):
            if step.body in settling.inertia:  # the others are within limbs
                body = settling.settle(step.body)
                for side in sides:
                    side.settle(step.body, motion.topology.parents[step.body], body)
            continue
        part, steps = plan.parts[step.part], plan.steps[step.part]
        now = empty_belief(first_root(motion, part, steps))
        # with columns, leaves share too much with what comes before and after to be functions of their own
        of = PartMotion(motion, settling, part, tolerance, apart=not now.width)
        leaves = [leaf for one in steps if isinstance(one, MeasureLeaves) for leaf in one.leaves]
        of, factors = of._replace(leaves=leaves_of(of, leaves)), []
        width = now.width
        for side in sides:
            side.begin(step.part, width)
        for one in steps:
            now, found, kept = STEPS[type(one)].include(now, sides, one, of)
            factors.append(found)
            for side, of_side in zip(sides, kept, strict=True):
                side.kept[step.part].append(of_side)
        parts[step.part] = Condensed(width, now, factors)
        if part.root != GROUND and steps:
            settling.add(part.root, symmetric6(now.N))
            for side in sides:
                side.load[part.root] = side.load[part.root] + side.on_root
    return ForestFactors(motion, plan, settling.bodies, parts), sides


def solve(factors: ForestFactors, others: Sequence[ForestLoads]) -> list[Outward]:
    """Return the accelerations and forces for other right-hand sides at the same configuration."""
    motion, plan, sides = factors.motion, factors.plan, [Inward.of(rhs) for rhs in others]
    for side in sides:
        for step in plan.inward:
            if isinstance(step, Settle):
                if step.body in factors.settled:
                    side.settle(step.body, motion.topology.parents[step.body], factors.settled[step.body])
                continue
            root, steps, condensed = plan.parts[step.part].root, plan.steps[step.part], factors.parts[step.part]
            side.begin(step.part, condensed.width)
            for one, found in zip(steps, condensed.factors, strict=True):
                side.kept[step.part].append(STEPS[type(one)].forward(side, one, found))
            if root != GROUND and steps:
                side.load[root] = side.load[root] + side.on_root
    return outward(factors, sides)


def first_root(motion: ForestMotion, part: ForestPart, steps: Sequence[PlanStep]) -> Array:
    """Return the acceleration of the root per column with which a part begins, (6, c)."""
    for step in steps:
        if isinstance(step, CrossAll):
            bodies = [motion.bodies[k] for k in step.bodies]
            return columns_of([body.H[:, 0] for body in bodies], [body.reach for body in bodies])
        if isinstance(step, Cross):
            return np.eye(6)
    return np.eye(6)[:, : 0 if part.root == GROUND else 6]
