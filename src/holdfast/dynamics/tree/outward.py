"""The way outward through the eliminated forest: accelerations of bodies, forces of closures and couplings.

With the acceleration of a part's root known, its steps are taken in reverse, for all right-hand sides together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.tree.belief import Belief
from holdfast.dynamics.tree.crossing import AllCrossed, back_cross, back_cross_all
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.leaves import back_leaves
from holdfast.dynamics.tree.order import Cross, CrossAll, MeasureLeaves
from holdfast.dynamics.tree.plan import Condense, EliminationPlan, Settle
from holdfast.dynamics.tree.settled import SettledBody
from holdfast.dynamics.tree.steps import STEPS, Back, Inward, PartMotion
from holdfast.model.forest import GROUND
from holdfast.spatial.scalar import Array, Scalar, minimum
from holdfast.spatial.spatial_vector import shift_twist


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


class Outward(NamedTuple):
    """Accelerations and forces for one right-hand side, by body, closure and coupling; without bodies of limbs."""

    qdd: dict[int, Array]
    beta: dict[int, Array]
    wrenches: dict[int, Array]
    multipliers: dict[int, Scalar]


class Condensed(NamedTuple):
    """A part after its steps.

    Attributes:
        of: what its steps needed.
        belief: the last state, without open frames.
        factors: per step, its factors.
    """

    of: PartMotion
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
    motion, plan = factors.motion, factors.plan
    count, backs = len(sides), [{} for _ in sides]
    beta: list[dict[int, Array]] = [{GROUND: np.zeros(6)} for _ in sides]
    qdd: list[dict[int, Array]] = [{} for _ in sides]
    for step in reversed(plan.inward):
        if isinstance(step, Condense):
            condensed, root = factors.parts[step.part], plan.parts[step.part].root
            width = 0 if root == GROUND else 6
            now = [Back(side.rhs, beta[i][root][:width]) for i, side in enumerate(sides)]
            kinds = zip(plan.steps[step.part], condensed.factors, strict=True)
            for j, (one, found) in reversed(list(enumerate(kinds))):
                kept = [side.kept[step.part][j] for side in sides]
                if isinstance(one, MeasureLeaves):
                    back_leaves(now, one, found, kept)
                    continue
                if isinstance(one, CrossAll):
                    for i, back in enumerate(now):
                        _with_rates(one.bodies, found, back_cross_all(back, found, kept[i]), qdd[i], beta[i])
                    continue
                if isinstance(one, Cross):
                    for i, back in enumerate(now):
                        below = beta[i][motion.topology.parents[one.body]]
                        k, nu = one.body, sides[i].nu[one.body]
                        qdd[i][k], beta[i][k] = back_cross(back, found, nu, below)
                    continue
                for back, of_side in zip(now, kept, strict=True):
                    STEPS[type(one)].back(back, one, found, of_side)
            for i, back in enumerate(now):
                backs[i][step.part] = back
        elif step.body in factors.settled:
            for i in range(count):
                _accelerate(factors, step, sides[i], backs[i], beta[i], qdd[i])
    solutions = []
    for i in range(count):
        wrenches = {j: f for one in backs[i].values() for j, f in one.wrenches.items()}
        multipliers = {j: x for one in backs[i].values() for j, x in one.multipliers.items()}
        solutions.append(Outward(qdd[i], beta[i], wrenches, multipliers))
    return solutions


def _with_rates(bodies: Sequence[int], of: AllCrossed, a: Array, qdd: dict[int, Array], beta: dict[int, Array]) -> None:
    """Note the accelerations of joints that have been crossed together, and of their bodies, from the world outward."""
    under = np.zeros(6)
    for j, (k, body) in enumerate(zip(bodies, of.motions, strict=True)):
        under = shift_twist(body.reach, under) + a[j] * body.H[:, 0]
        qdd[k], beta[k] = a[[j]], under


def _accelerate(
    factors: ForestFactors,
    step: Settle,
    side: Inward,
    backs: Mapping[int, Back],
    beta: dict[int, Array],
    qdd: dict[int, Array],
) -> None:
    """Find the acceleration of a body whose parent's is known."""
    k, body = step.body, factors.settled[step.body]
    if body.motion.floats:
        if step.part is None:
            qdd[k] = beta[k] = side.nu[k] + body.pushed(side.rhs.bodies[k].wrench)
        else:
            qdd[k] = beta[k] = backs[step.part].beta[k]
        return
    assert step.part is not None  # only free bodies are roots
    moved = body.moved(beta[factors.motion.topology.parents[k]][:, None])[:, 0]
    qdd[k] = side.nu[k] + backs[step.part].extra.get(k, 0.0) - body.G.T @ moved
    beta[k] = moved + body.motion.H @ qdd[k]
