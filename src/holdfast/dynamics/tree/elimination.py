"""The elimination of a forest in the order of its plan, inward and outward again; O(bodies) for a bounded front.

Inward, every body settles at its parent, and every part condenses at its root to an inertia N and a load n. Outward,
with the acceleration of the root known, the steps of the part are taken in reverse. The root of a tree is the world or
a free body, whose acceleration is I^-1 (w - z) in the end.

The factors do not depend on the loads; with them, any right-hand side is solved (`solve`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from holdfast.dynamics.tree.belief import Belief, empty_belief
from holdfast.dynamics.tree.branches import ForestPart
from holdfast.dynamics.tree.crossing import (
    Crossed,
    columns_of,
    cross,
    cross_all,
    forward_cross,
    forward_cross_all,
)
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.leaf import leaves_of
from holdfast.dynamics.tree.leaves import forward_leaves, measure_leaves
from holdfast.dynamics.tree.order import Cross, CrossAll, MeasureLeaves, PlanStep
from holdfast.dynamics.tree.outward import Condensed, ForestFactors, ForestSolution, Outward, outward
from holdfast.dynamics.tree.plan import EliminationPlan, Settle
from holdfast.dynamics.tree.settled import SettledBody, settled_body
from holdfast.dynamics.tree.steps import STEPS, ForestLoads, Inward, PartMotion
from holdfast.model.forest import GROUND
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.spatial.symmetric import Symmetric6, mirrored, symmetric6


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
    (rest,) = solve(factors, [right_hand_side(motion.at_rest_with(*left_over(motion, first)))])
    again = factors.solution(rest)

    def both(x: list[Any], y: list[Any]) -> list[Any]:
        return [a + b for a, b in zip(x, y, strict=True)]

    return first._replace(
        qdd=both(first.qdd, again.qdd),
        beta=both(first.beta, again.beta),
        wrenches=both(first.wrenches, again.wrenches),
        multipliers=both(first.multipliers, again.multipliers),
    )


def left_over(motion: ForestMotion, found: ForestSolution) -> tuple[list[Array], list[Scalar]]:
    """Return what accelerations leave of the rows of closures, (rows,) each, and of couplings: r - G qdd."""
    gaps, coupled = [], []
    for (a, b), c in zip(motion.topology.ends, motion.closures, strict=True):
        left = c.r - c.on_b @ found.beta[b]
        gaps.append(left if a == GROUND else left - c.on_a @ found.beta[a])
    for terms, r in zip(motion.couplings, motion.coupled, strict=True):
        coupled.append(r - sum(c * found.qdd[k][component] for k, component, c in terms))
    return gaps, coupled


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
    sides = [Inward(rhs) for rhs in (right_hand_side(motion), *others)]
    settled: dict[int, SettledBody] = {}
    parts: dict[int, Condensed] = {}
    inertia, alone = _with_limbs(motion, sides)
    for step in plan.inward:
        if isinstance(step, Settle):
            k, parent = step.body, motion.topology.parents[step.body]
            if k not in inertia:
                continue  # within a limb
            settled[k] = settled_body(motion.bodies[k], inertia[k], alone=k in alone)
            if parent != GROUND:
                inertia[parent], alone = inertia[parent].plus(settled[k].inertia_on_parent()), alone - {parent}
            for side in sides:
                _settle(side, k, parent, settled[k])
            continue
        part = plan.parts[step.part]
        steps = plan.steps[step.part]
        of = PartMotion(motion, settled, part, first_columns(motion, part, steps), tolerance)
        of = of._replace(apart=not of.width)  # with columns, they share too much with what comes before and after
        leaves = [leaf for one in steps if isinstance(one, MeasureLeaves) for leaf in one.leaves]
        of = of._replace(leaves=leaves_of(of, leaves))
        now, factors = empty_belief(of.width), []
        for side in sides:
            side.begin(step.part, of.width)
        now = _with_free_joints(now, sides, motion, steps)
        for one in steps:
            if isinstance(one, MeasureLeaves):
                now, found, kept = measure_leaves(now, sides, one, of)
            elif isinstance(one, Cross):
                k, parent = one.body, motion.topology.parents[one.body]
                inertia[k] = inertia[k].plus(symmetric6(now.N))
                settled[k] = settled_body(motion.bodies[k], inertia[k], alone=False)
                now, found = cross(now, settled[k], parent)
                of = of._replace(columns=np.eye(6)[:, : now.X.shape[1]])
                if parent != GROUND:
                    inertia[parent], alone = inertia[parent].plus(settled[k].inertia_on_parent()), alone - {parent}
                kept = [_cross(side, k, parent, found) for side in sides]
            elif isinstance(one, CrossAll):
                now, found = cross_all(now, [motion.bodies[k] for k in one.bodies], [inertia[k] for k in one.bodies])
                of = of._replace(columns=np.zeros((6, 0)))
                kept = [forward_cross_all(side, one.bodies, found) for side in sides]
            else:
                now, found = STEPS[type(one)].factor(now, one, of)
                kept = [STEPS[type(one)].forward(side, one, found) for side in sides]
            factors.append(found)
            for side, kept_of_side in zip(sides, kept, strict=True):
                side.kept[step.part].append(kept_of_side)
        parts[step.part] = Condensed(of, now, factors)
        if part.root != GROUND and steps:
            inertia[part.root], alone = inertia[part.root].plus(symmetric6(now.N)), alone - {part.root}
            for side in sides:
                side.load[part.root] = side.load[part.root] + side.on_root
    return ForestFactors(motion, plan, settled, parts), sides


def solve(factors: ForestFactors, others: Sequence[ForestLoads]) -> list[Outward]:
    """Return the accelerations and forces for other right-hand sides at the same configuration."""
    motion, plan, sides = factors.motion, factors.plan, [Inward(rhs) for rhs in others]
    _with_limbs(motion, sides)
    for step in plan.inward:
        if isinstance(step, Settle):
            if step.body in factors.settled:
                parent = motion.topology.parents[step.body]
                for side in sides:
                    _settle(side, step.body, parent, factors.settled[step.body])
            continue
        part, steps, condensed = plan.parts[step.part], plan.steps[step.part], factors.parts[step.part]
        width = first_columns(motion, part, steps).shape[1]
        for side in sides:
            side.begin(step.part, width)
        _with_free_joints(condensed.belief, sides, motion, steps)
        for one, found in zip(steps, condensed.factors, strict=True):
            for side in sides:
                side.kept[step.part].append(_forward(side, one, found, motion))
        if part.root != GROUND and steps:
            for side in sides:
                side.load[part.root] = side.load[part.root] + side.on_root
    return outward(factors, sides)


def _forward(side: Inward, step: PlanStep, found: Any, motion: ForestMotion) -> Any:
    """Take a right-hand side through a step; return what its way back needs."""
    match step:
        case MeasureLeaves():
            return forward_leaves(side, step, found)
        case Cross():
            return _cross(side, step.body, motion.topology.parents[step.body], found)
        case CrossAll():
            return forward_cross_all(side, step.bodies, found)
    return STEPS[type(step)].forward(side, step, found)


def _with_limbs(motion: ForestMotion, sides: Sequence[Inward]) -> tuple[dict[int, Symmetric6], frozenset[int]]:
    """Return the inertias of the bodies outside limbs with those of the limbs on them, and which bodies have none.

    The loads of the limbs are added to those of the bodies.
    """
    within = {k for limb in motion.all_limbs for k in limb.bodies}
    inertia = {k: body.inertia for k, body in enumerate(motion.bodies) if body is not None and k not in within}
    carrying = set()
    for limb in motion.all_limbs:
        base = limb.tip.base
        if base is not None:
            locked = base.locked.moved(np.eye(3), limb.offset).symmetric()
            inertia[limb.on] = inertia[limb.on].plus(locked)
            if len(base.Y) == 6:
                inertia[limb.on] = inertia[limb.on].plus(symmetric6(base.Y))
            carrying.add(limb.on)
    for side in sides:
        side.load = {k: side.rhs.bodies[k].load for k in inertia}
        for limb in side.rhs.limbs:
            base = limb.tip.base
            if base is not None:
                side.load[limb.on] = side.load[limb.on] + shift_wrench(limb.offset, base.at_rest)
                if len(base.wrench) == 6:
                    side.load[limb.on] = side.load[limb.on] + base.wrench
    return inertia, frozenset(inertia) - carrying


def _settle(side: Inward, k: int, parent: int, body: SettledBody) -> None:
    """Let the load of a body settle at its parent."""
    load, torque = side.load[k], side.rhs.bodies[k].torque
    falling = None if body.free is None else side.rhs.falling.get(k)
    side.nu[k] = body.nu(load, torque) if falling is None else falling
    if parent != GROUND:
        side.load[parent] = side.load[parent] + body.load_on_parent(load, torque)


def _cross(side: Inward, k: int, parent: int, found: Crossed) -> None:
    """Take a right-hand side across the joint of a body, on which it settles first."""
    side.load[k] = side.load[k] + side.on_root - side.rhs.bodies[k].wrench
    _settle(side, k, parent, found.body)
    forward_cross(side, k, found)


def first_columns(motion: ForestMotion, part: ForestPart, steps: Sequence[PlanStep]) -> Array:
    """Return the acceleration of the root per column with which a part begins, (6, c)."""
    for step in steps:
        if isinstance(step, CrossAll):
            return columns_of([motion.bodies[k] for k in step.bodies])
        if isinstance(step, Cross):
            return np.eye(6)
    return np.eye(6)[:, : 0 if part.root == GROUND else 6]


def _with_free_joints(now: Belief, sides: Sequence[Inward], motion: ForestMotion, steps: Sequence[PlanStep]) -> Belief:
    """Return the state with what the joints of limbs add to the equations of joint rates, if these are the columns."""
    rates = {step.bodies[-1] for step in steps if isinstance(step, CrossAll)}
    for limb in motion.all_limbs:
        if limb.on in rates and limb.tip.base is not None:
            now = now._replace(N=mirrored(now.N + limb.tip.base.Y))
    for side in sides:
        for limb in side.rhs.limbs:
            if limb.on in rates and limb.tip.base is not None:
                side.on_root = side.on_root + limb.tip.base.wrench
    return now
