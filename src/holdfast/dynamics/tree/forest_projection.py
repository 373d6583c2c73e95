"""The return of a motion to its closures after a step, by the smallest changes in the kinetic metric.

    M dq = G^T p,   G dq = -gap of positions,       M dqd = G^T p',   G dqd = -gap of rates

Both are the forest at rest with the gaps as right-hand sides of its rows, for which one elimination is enough; a
further round removes what the curvature of the closures has left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.tree.forest_closing import FOREST_CLOSED
from holdfast.dynamics.tree.forest_gaps import ForestGaps, position_gaps, velocity_gaps
from holdfast.dynamics.tree.forest_motion import ClosureMotion, ForestMotion, forest_motion
from holdfast.dynamics.tree.limbed_solution import LimbedAccelerations, changes_with_limbs
from holdfast.dynamics.tree.limbs import LimbArm, LimbedMotion, limbed_motion
from holdfast.dynamics.tree.outward import ForestFactors
from holdfast.dynamics.tree.plan import plan_of
from holdfast.dynamics.tree.varied_forest import displaced
from holdfast.model.forest import Forest
from holdfast.spatial.scalar import Array, Scalar, array, concatenate

MOST_CLOSING_ROUNDS = 8


class ClosingRound(NamedTuple):
    """Positions and rates after a round.

    Attributes:
        q: (n_q,) positions.
        qd: (n_v,) rates.
        position_gap: the largest gap in position before [m and rad].
        velocity_gap: the largest gap in velocity before.
        rank: rank of the rows before.
    """

    q: Array
    qd: Array
    position_gap: Scalar
    velocity_gap: Scalar
    rank: Scalar


class ClosingChanges(NamedTuple):
    """What a round changes.

    Attributes:
        limbed: the forest's motion at rest before.
        factors: the factors of its elimination.
        found: the changes of positions and of rates, those of free bodies at their mass centres.
        position_gap, velocity_gap: as of `ClosingRound`.
    """

    limbed: LimbedMotion
    factors: ForestFactors
    found: list[LimbedAccelerations]
    position_gap: Scalar
    velocity_gap: Scalar

    @property
    def changes(self) -> list[Array]:
        """The changes of positions and of rates in the coordinates of qd, (n_v,) each."""
        bodies = self.limbed.motion.bodies
        return [
            concatenate([one.qdd[k] if body is None else body.of_frame(one.qdd[k]) for k, body in enumerate(bodies)])
            for one in self.found
        ]


def closing_round(forest: Forest, q: Array, qd: Array, arms: Sequence[LimbArm] = ()) -> ClosingRound:
    """Return positions and rates nearer to closures and couplings, O(bodies) as forward dynamics.

    Positions move along nonholonomic closures only as these allow.

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions with unit quaternions.
        qd: (n_v,) rates.
        arms: limbs that are solved as arms (`limb_arms`).
    """
    now = closing_changes(forest, q, qd, arms)
    step, change = now.changes
    return ClosingRound(displaced(forest, q, step), qd + change, now.position_gap, now.velocity_gap, now.factors.rank)


def closing_changes(forest: Forest, q: Array, qd: Array, arms: Sequence[LimbArm]) -> ClosingChanges:
    """Return what a round changes; see `closing_round`."""
    still = np.zeros(forest.velocity_count)
    motion = forest_motion(forest, q, qd, still, np.zeros((len(forest.bodies), 6)))
    apart, speeds = position_gaps(motion, q), velocity_gaps(motion, qd)
    limbed = limbed_motion(forest, arms, q, still, still)
    factors, found = changes_with_limbs(limbed, plan_of(forest.topology), closing_sides(motion, apart, speeds))
    return ClosingChanges(limbed, factors, found, apart.largest, speeds.largest)


def closing_sides(
    motion: ForestMotion, apart: ForestGaps, speeds: ForestGaps
) -> list[tuple[list[Array], list[Scalar]]]:
    """Return the right-hand sides of closures and couplings that close positions, and those that close rates."""
    of_positions = [_on_all_rows(c, gap) for c, gap in zip(motion.closures, apart.closures, strict=True)]
    return [
        ([-x for x in closures], [-x for x in couplings])
        for closures, couplings in ((of_positions, apart.couplings), (speeds.closures, speeds.couplings))
    ]


def closing_rounds(closing: Callable[[Array, Array], ClosingRound], q: Array, qd: Array) -> Iterator[ClosingRound]:
    """Yield rounds, the last of which begins with closed positions, so that it closes the rates there.

    If the last one does not, positions cannot be closed from there.

    Args:
        closing: takes a round, `closing_round` or its machine code.
        q: (n_q,) positions with unit quaternions.
        qd: (n_v,) rates.
    """
    for _ in range(MOST_CLOSING_ROUNDS):
        now = closing(q, qd)
        yield now
        if now.position_gap <= FOREST_CLOSED:
            return
        q, qd = now.q, now.qd


def _on_all_rows(c: ClosureMotion, gap: Array) -> Array:
    """Return a gap in position along all rows of a closure, (rows,); nonholonomic ones have none."""
    known = dict(zip(c.contact.grasp.of_kind.position_rows, gap, strict=True))
    return array([known.get(row, 0.0) for row in c.contact.rows])
