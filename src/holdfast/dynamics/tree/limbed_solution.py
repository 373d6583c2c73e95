"""The solution of a forest with limbs, by its elimination and then limb by limb, also for other right-hand sides."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.arm.motion import ArmMotion, at_rest
from holdfast.dynamics.closed.tip_response import TipResponse, responded
from holdfast.dynamics.tree.elimination import Tips, contradictions, factorised, left_over, right_hand_side, solve
from holdfast.dynamics.tree.limbs import LimbedMotion, LimbMotion
from holdfast.dynamics.tree.order import AddFree, CloseFrame, MeasureLeaves
from holdfast.dynamics.tree.outward import ForestFactors
from holdfast.dynamics.tree.plan import EliminationPlan
from holdfast.dynamics.tree.right_hand_sides import Outward
from holdfast.model.forest import GROUND
from holdfast.spatial.scalar import Array, Scalar, concatenate, each


class LimbedAccelerations(NamedTuple):
    """Accelerations and forces by body, closure and coupling, and accelerations of limbs' tips; see `left_over`."""

    qdd: Mapping[int, Array]
    beta: Mapping[int, Array]
    wrenches: Mapping[int, Array]
    multipliers: Mapping[int, Scalar]
    tips: Tips

    def plus(self, other: LimbedAccelerations) -> LimbedAccelerations:
        """Return the sum with another solution."""

        def summed(own: Mapping[Any, Any], more: Mapping[Any, Any]) -> dict[Any, Any]:
            return {key: x + more[key] for key, x in own.items()}

        return LimbedAccelerations(*map(summed, self, other))


class LimbedSolution(NamedTuple):
    """Accelerations and forces of a forest with limbs, in world axes; names as in `ForestSolution`.

    Attributes:
        qdd: per body, (m,) joint accelerations; of a free body, (6,) the true acceleration of its frame's origin.
        wrenches: per closure, (6,).
        multipliers: per coupling.
        rank, weakest: as in `ForestSolution`.
        left: per closure, and then per coupling, what accelerations leave of its rows, relative to their terms.
        pivots: articulated inertias of the joints outside limbs, > 0 if the mass matrix is regular.
        factors: the factors, for other right-hand sides.
        accelerations: as the elimination leaves them; see `LimbedAccelerations`.
    """

    qdd: list[Array]
    wrenches: list[Array]
    multipliers: list[Scalar]
    rank: Scalar
    weakest: Scalar
    left: list[Scalar]
    pivots: Array
    factors: ForestFactors
    accelerations: LimbedAccelerations


def solved_with_limbs(limbed: LimbedMotion, plan: EliminationPlan) -> LimbedSolution:
    """Return the accelerations and forces of a forest, after taking back what rounding left of its closures.

    Nothing need be taken back if all loops consist of limbs and free bodies, as in a chain; see `elimination.solved`.

    Args:
        limbed: its motion.
        plan: the order.
    """
    motion, limbs = limbed
    factors, (found,) = factorised(motion, plan)
    both = _accelerations(found, limbs, [(m.arm, m.tip) for m in limbs.values()])
    if not _all_in_limbs(plan, limbs):
        both = both.plus(_of_what_is_left(limbed, factors, both))
    free = {k: body for k, body in enumerate(motion.bodies) if body is not None and body.floats}
    gravity = motion.forest.gravity
    return LimbedSolution(
        [
            free[k].true_acceleration(both.beta[k], gravity) if k in free else both.qdd[k]
            for k in range(len(motion.bodies))
        ],
        [both.wrenches[i] for i in range(len(motion.closures))],
        [both.multipliers[i] for i in range(len(motion.couplings))],
        factors.rank,
        factors.weakest,
        contradictions(motion, both.qdd, both.beta, both.tips),
        concatenate([np.zeros(0), *(one.factors.pivots for one in factors.settled.values() if not one.motion.floats)]),
        factors,
        both,
    )


def _all_in_limbs(plan: EliminationPlan, limbs: Container[int]) -> bool:
    """Return whether every closure ends a limb, and no joint is in a loop besides."""
    steps = [step for steps in plan.steps for step in steps]
    leaves = [leaf for step in steps if isinstance(step, MeasureLeaves) for leaf in step.leaves]
    simple = all(isinstance(step, AddFree | MeasureLeaves | CloseFrame) for step in steps)
    return simple and all(leaf.closure in limbs for leaf in leaves)


def _of_what_is_left(limbed: LimbedMotion, factors: ForestFactors, first: LimbedAccelerations) -> LimbedAccelerations:
    """Return the solution at rest for what accelerations leave of the rows."""
    return _at_rest_with(limbed, factors, *left_over(limbed.motion, first.qdd, first.beta, first.tips))


def _at_rest_with(
    limbed: LimbedMotion,
    factors: ForestFactors,
    gaps: list[Array],
    coupled: list[Scalar],
    torques: list[Array] | None = None,
) -> LimbedAccelerations:
    """Return the solution of the forest at rest with other right-hand sides; see `ForestMotion.at_rest_with`."""
    motion, limbs = limbed
    rest = motion.at_rest_with(gaps, coupled, torques)
    of_gaps = {i: (-gaps[i] if m.limb.is_b else gaps[i]) @ m.closure.K for i, m in limbs.items()}
    arms, tips = [m.arm for m in limbs.values()], [m.tip for m in limbs.values()]
    if torques is None:
        still = each(_at_rest, arms, tips)
        rest = rest._replace(limbs={})
    else:
        still = each(_driven, arms, tips, [concatenate([torques[k] for k in m.limb.joints]) for m in limbs.values()])
        loaded = dict(zip(limbs, (tip for _, tip in still), strict=True))
        rest = rest._replace(limbs={i: motion.limbs[i]._replace(tip=tip) for i, tip in loaded.items()})
        of_gaps = {i: gap + loaded[i].free_acceleration for i, gap in of_gaps.items()}
    (again,) = solve(factors, [right_hand_side(rest)._replace(gaps=of_gaps)])
    return _accelerations(again, limbs, still)


def solved_again(
    limbed: LimbedMotion, factors: ForestFactors, gaps: list[Array], coupled: list[Scalar], torques: list[Array]
) -> LimbedAccelerations:
    """Return the solution of the forest at rest with torques and right-hand sides of its rows, by the same factors.

    Args:
        limbed: its motion.
        factors: its factors.
        gaps: per closure, (rows,) right-hand sides.
        coupled: per coupling, the right-hand side.
        torques: per body, (m,) torques, of a free body (6,) a wrench about its mass centre.
    """
    first = _at_rest_with(limbed, factors, gaps, coupled, torques)
    if _all_in_limbs(factors.plan, limbed.limbs):
        return first
    rest = limbed._replace(motion=limbed.motion.at_rest_with(gaps, coupled))
    return first.plus(_of_what_is_left(rest, factors, first))


def changes_with_limbs(
    limbed: LimbedMotion, plan: EliminationPlan, sides: Sequence[tuple[list[Array], list[Scalar]]]
) -> tuple[ForestFactors, list[LimbedAccelerations]]:
    """Return the factors, and the smallest changes of rates in the kinetic metric with given effects on the rows.

    Args:
        limbed: the forest's motion, of which only the configuration matters.
        plan: the order.
        sides: per change, its effect on the rows of closures, (rows,) each, and of couplings.

    Returns:
        The factors, and the changes, those of free bodies at their mass centres.
    """
    factors, _ = factorised(limbed.motion, plan)
    return factors, [_at_rest_with(limbed, factors, gaps, coupled) for gaps, coupled in sides]


def _accelerations(
    found: Outward, limbs: Mapping[int, LimbMotion], loaded: Sequence[tuple[ArmMotion, TipResponse]]
) -> LimbedAccelerations:
    """Return a solution with the joints of limbs, whose motions and tip responses are those of its loads."""
    forces = [-found.wrenches[i] if m.limb.is_b else found.wrenches[i] for i, m in limbs.items()]
    bases = [None if m.limb.on == GROUND else found.beta[m.limb.on] for m in limbs.values()]
    moved = each(_moved, [arm for arm, _ in loaded], [tip for _, tip in loaded], forces, bases)
    qdd, tips = dict(found.qdd), {}
    for (i, m), (rates, tip) in zip(limbs.items(), moved, strict=True):
        qdd |= {k: rates[j : j + 1] for j, k in enumerate(m.limb.joints)}
        tips[i, m.limb.is_b] = tip
    return LimbedAccelerations(qdd, found.beta, found.wrenches, found.multipliers, tips)


def _moved(arm: ArmMotion, tip: TipResponse, f: Array, beta: Array | None) -> tuple[Array, Array]:
    """Return the joint accelerations of a limb, and that of its tip."""
    qdd, _ = responded(tip, f, beta)
    base = None if beta is None or arm.base_columns is None else arm.base_columns @ beta
    return qdd, tip_acceleration(arm, qdd, base)


def _at_rest(arm: ArmMotion, tip: TipResponse) -> tuple[ArmMotion, TipResponse]:
    still = at_rest(arm)
    assert tip.for_load is not None
    return still, tip.for_load(still)


def _driven(arm: ArmMotion, tip: TipResponse, torque: Array) -> tuple[ArmMotion, TipResponse]:
    still = replace(at_rest(arm), torque=torque)
    assert tip.for_load is not None
    return still, tip.for_load(still)
