"""The way outward through the eliminated forest: accelerations of bodies, forces of closures and couplings.

With the acceleration of a part's root known, its steps are taken in reverse, for all right-hand sides together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

from holdfast.dynamics.tree.belief import Belief
from holdfast.dynamics.tree.crossing import CROSSING_STEPS
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.leaves import LEAF_STEPS
from holdfast.dynamics.tree.plan import Condense, EliminationPlan
from holdfast.dynamics.tree.right_hand_sides import Inward, Outward
from holdfast.dynamics.tree.settled import SettledBody
from holdfast.dynamics.tree.steps import FRAME_STEPS, StepKind
from holdfast.model.forest import GROUND
from holdfast.spatial.scalar import Array, Scalar, minimum

STEPS: dict[type, StepKind] = {**FRAME_STEPS, **LEAF_STEPS, **CROSSING_STEPS}


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
        width: number of columns of its root at first.
        belief: the last state, without open frames.
        factors: per step, its factors.
    """

    width: int
    belief: Belief
    factors: list[Any]


class ForestFactors(NamedTuple):
    """The factors of a forest's equations.

    Attributes:
        motion: the forest's motion.
        plan: the order.
        settled: by body, the response of its joint.
        parts: by part.
    """

    motion: ForestMotion
    plan: EliminationPlan
    settled: Mapping[int, SettledBody]
    parts: Mapping[int, Condensed]

    @property
    def rank(self) -> Scalar:
        """Number of independent rows of the constraint on qd."""
        return sum(one.belief.kept for one in self.parts.values())

    @property
    def weakest(self) -> Scalar:
        """The smallest pivot of these rows, relative to its size."""
        return reduce(minimum, [one.belief.weakest for one in self.parts.values()], 1.0)

    def solution(self, found: Outward) -> ForestSolution:
        """Return a solution as lists; only without limbs."""
        motion = self.motion
        order = range(len(motion.bodies))
        return ForestSolution(
            [found.qdd[k] for k in order],
            [found.beta[k] for k in order],
            [found.wrenches[i] for i in range(len(motion.closures))],
            [found.multipliers[i] for i in range(len(motion.couplings))],
            self.rank,
            self.weakest,
            [self.settled[k].factors.pivots for k in order],
        )


def outward(factors: ForestFactors, sides: Sequence[Inward]) -> list[Outward]:
    """Return the solutions, from the world outward."""
    plan, found = factors.plan, [Outward(side) for side in sides]
    for step in reversed(plan.inward):
        if isinstance(step, Condense):
            root, steps = plan.parts[step.part].root, plan.steps[step.part]
            for one in found:
                one.columns = one.beta[root][: 0 if root == GROUND else 6]
            for j in reversed(range(len(steps))):
                kept = [side.kept[step.part][j] for side in sides]
                STEPS[type(steps[j])].back(found, steps[j], factors.parts[step.part].factors[j], kept)
        elif step.body in factors.settled:
            for one in found:
                _accelerate(factors, step.body, one)
    return found


def _accelerate(factors: ForestFactors, k: int, of: Outward) -> None:
    """Find the acceleration of a body whose parent's is known, unless a step has found it."""
    body, nu = factors.settled[k], of.inward.nu[k]
    if body.motion.floats:
        if k not in of.beta:
            free = nu + body.pushed(of.rhs.bodies[k].wrench)
            of.moves(k, free, free)
        return
    moved = body.moved(of.beta[factors.motion.topology.parents[k]][:, None])[:, 0]
    qdd = nu + of.extra.get(k, 0.0) - body.G.T @ moved
    of.moves(k, qdd, moved + body.motion.H @ qdd)
