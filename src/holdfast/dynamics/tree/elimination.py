"""The elimination of a forest in the order of its plan, inward and outward again; O(bodies) for a bounded front.

Inward, every body settles at its parent, and every part condenses at its root to an inertia N and a load n. Outward,
with the acceleration of the root known, the steps of the part are taken in reverse. The root of a tree is the world or
a free body, whose acceleration is I^-1 (w - z) in the end.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.tree.belief import Belief, empty_belief
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.plan import Condense, EliminationPlan, Settle
from holdfast.dynamics.tree.settled import SettledBody, settled_body
from holdfast.dynamics.tree.steps import STEPS, Back, PartMotion
from holdfast.model.forest import GROUND
from holdfast.spatial.linalg import ldl_solve
from holdfast.spatial.scalar import Array, Scalar, concatenate, minimum
from holdfast.spatial.symmetric import symmetric6


class ForestSolution(NamedTuple):
    """Accelerations and forces of a forest, in world axes.

    Attributes:
        qdd: per body, (m,) joint accelerations; of a free body, (6,) that of its mass centre.
        beta: per body, (6,) acceleration that the joints add, about the body's point.
        wrenches: per closure, (6,) wrench f of body a on body b about the contact point.
        multipliers: per coupling, lambda.
        rank: number of independent rows of the constraint on qd.
        weakest: the smallest pivot of these rows, relative to its size.
        pivots: per body, (m,) articulated inertias of its joint.
    """

    qdd: list[Array]
    beta: list[Array]
    wrenches: list[Array]
    multipliers: list[Scalar]
    rank: Scalar
    weakest: Scalar
    pivots: list[Array]


class Condensed(NamedTuple):
    """A part after its steps.

    Attributes:
        belief: the last state, without open frames.
        kept: per step, what its way back needs.
    """

    belief: Belief
    kept: list[Any]


def solved(motion: ForestMotion, plan: EliminationPlan) -> ForestSolution:
    """Return the accelerations and forces of a forest, after taking back what rounding left of its closures.

    A joint's acceleration is found from the forces on it, of which large ones that nearly balance leave few digits. The
    same steps, at rest, with what is left of the rows as their right-hand sides, bring them back.

    Args:
        motion: its motion.
        plan: the order.
    """
    first = eliminated(motion, plan)
    again = eliminated(motion.at_rest_with(*left_over(motion, first)), plan)

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
    forest, gaps, coupled = motion.forest, [], []
    for closure, c in zip(forest.closures, motion.closures, strict=True):
        left = c.r - c.on_b @ found.beta[closure.b]
        gaps.append(left if closure.a is None else left - c.on_a @ found.beta[closure.a])
    for coupling, r in zip(forest.couplings, motion.coupled, strict=True):
        coupled.append(r - sum(c * found.qdd[k][component] for k, component, c in coupling.terms))
    return gaps, coupled


def eliminated(motion: ForestMotion, plan: EliminationPlan) -> ForestSolution:
    """Return the accelerations and forces of a forest.

    Args:
        motion: its motion.
        plan: the order.
    """
    settled, condensed = _inward(motion, plan)
    beta: dict[int, Array] = {GROUND: np.zeros(6)}
    qdd: dict[int, Array] = {}
    back: dict[int, Back] = {}
    for step in reversed(plan.inward):
        if isinstance(step, Condense):
            back[step.part] = _outward(motion, settled, plan, condensed[step.part], step.part, beta)
            continue
        body = settled[step.body]
        if body.motion.floats:
            pushed = ldl_solve(body.factors, body.motion.wrench - body.load)
            qdd[step.body] = beta[step.body] = pushed if step.part is None else back[step.part].beta[step.body]
            continue
        assert step.part is not None  # only free bodies are roots
        moved = body.moved(beta[motion.forest.topology.parents[step.body]][:, None])[:, 0]
        extra = back[step.part].extra.get(step.body, 0.0)
        qdd[step.body] = body.nu + extra - body.G.T @ moved
        beta[step.body] = moved + body.motion.H @ qdd[step.body]
    wrenches = {i: f for one in back.values() for i, f in one.wrenches.items()}
    multipliers = {i: x for one in back.values() for i, x in one.multipliers.items()}
    rank: Scalar = 0
    weakest: Scalar = 1.0
    for one in condensed.values():
        rank, weakest = rank + one.belief.kept, minimum(weakest, one.belief.weakest)
    order = range(len(motion.bodies))
    return ForestSolution(
        [qdd[k] for k in order],
        [beta[k] for k in order],
        [wrenches[i] for i in range(len(motion.closures))],
        [multipliers[i] for i in range(len(motion.forest.couplings))],
        rank,
        weakest,
        [settled[k].factors.pivots for k in order],
    )


def _inward(motion: ForestMotion, plan: EliminationPlan) -> tuple[dict[int, SettledBody], dict[int, Condensed]]:
    """Return the settled bodies and the condensed parts."""
    inertia = {k: body.inertia for k, body in enumerate(motion.bodies)}
    load = {k: body.load for k, body in enumerate(motion.bodies)}
    settled: dict[int, SettledBody] = {}
    condensed: dict[int, Condensed] = {}
    for step in plan.inward:
        if isinstance(step, Settle):
            k, parent = step.body, motion.forest.topology.parents[step.body]
            settled[k] = settled_body(motion.bodies[k], inertia[k], load[k])
            if parent != GROUND:
                more, pushed = settled[k].onto_parent()
                inertia[parent], load[parent] = inertia[parent].plus(more), load[parent] + pushed
            continue
        part = plan.parts[step.part]
        of = PartMotion(motion, settled, part, 0 if part.root == GROUND else 6)
        belief, kept = empty_belief(of.width), []
        for one in plan.steps[step.part]:
            belief, remembered = STEPS[type(one)][0](belief, one, of)
            kept.append(remembered)
        condensed[step.part] = Condensed(belief, kept)
        if of.width and plan.steps[step.part]:
            N, n = symmetric6(belief.on_root[:, 1:]), belief.on_root[:, 0]
            inertia[part.root], load[part.root] = inertia[part.root].plus(N), load[part.root] + n
    return settled, condensed


def _outward(
    motion: ForestMotion,
    settled: dict[int, SettledBody],
    plan: EliminationPlan,
    condensed: Condensed,
    index: int,
    beta: dict[int, Array],
) -> Back:
    """Return the forces and accelerations within a part, the acceleration of its root being known."""
    part = plan.parts[index]
    of = PartMotion(motion, settled, part, 0 if part.root == GROUND else 6)
    back = Back(concatenate([np.ones(1), beta[part.root][: of.width]]))
    for step, kept in zip(reversed(plan.steps[index]), reversed(condensed.kept), strict=True):
        STEPS[type(step)][1](back, step, kept, of)
    return back
