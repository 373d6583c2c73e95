"""A forest in a run whose steps are traced as a whole, by the functions that the reference runs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.forest_schedule import forward_outputs, traced_solution, with_constant_arms, with_constants
from holdfast.compiled.result import SINGULAR
from holdfast.dynamics.tree.forest_balance import power_into
from holdfast.dynamics.tree.forest_inverse import (
    MISSING,
    CarryingForces,
    InverseAt,
    carrying_forces,
    inverse_terms,
    loads_for,
    nearest_accelerations,
)
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_projection import closing_round
from holdfast.dynamics.tree.forest_rows import forest_rows, least_forces
from holdfast.dynamics.tree.forest_simulate import ForestInstant
from holdfast.dynamics.tree.varied_forest import ForestArguments, position_rates
from holdfast.forces.margins import contact_margin, limited
from holdfast.model.forest import Forest
from holdfast.questions.arrays import contact_of
from holdfast.spatial.scalar import Array, Scalar, array, maximum, scan, where
from holdfast.spatial.spatial_vector import unrotate

AGREEING = 1e-9  # relative: what rows leave over that agree
CLOSING_ROUNDS = 2  # of a traced step: the first removes gaps, the second what the curvature of the closures has left


class TracedForest:
    """A forest in a step that is traced; see `StepEngine`.

    Attributes:
        forest: the forest, whose numbers are constants of the code, but for those that are traced.
        rank: rank of its constraint; an instant with another one has the status SINGULAR.
        worst: (2,) largest condition and status of all instants so far.
    """

    def __init__(self, forest: Forest, rank: int, made: Forest) -> None:
        """Store the forest with its own numbers, and as it is `made` of constants and traced numbers."""
        self.forest, self.rank, self.worst = made, rank, np.zeros(2)
        self._numbers, self._arms = forest, with_constant_arms(forest)

    @property
    def unique(self) -> bool:
        """Whether forces are unique."""
        return self.rank == self.forest.constraint_row_count

    def instant(self, given: ForestArguments) -> ForestInstant:
        """See `StepEngine`."""
        x = traced_instant(self._numbers, given, self.forest)
        status = where(abs(x["rank"] - float(self.rank)) < 0.5, x["status"], float(SINGULAR))
        self.worst = maximum(self.worst, array([x["condition"], status]))
        found = {name: x[name] for name in ForestInstant._fields if name in x}
        return ForestInstant(**found, unique=self.unique)

    def closed(self, q: Array, qd: Array) -> tuple[Array, Array, tuple[Scalar, Scalar]]:
        """See `StepEngine`; gaps that two rounds do not close are left."""
        forest, arms = self.forest, self._arms

        def taken(at: tuple[Array, Array], _: Scalar) -> tuple[tuple[Array, Array], tuple[Scalar, Scalar]]:
            now = closing_round(forest, *at, arms)
            return (now.q, now.qd), (now.position_gap, now.velocity_gap)

        (q, qd), gaps = scan(taken, (q, qd), [0.0] * CLOSING_ROUNDS)
        return q, qd, gaps[0]

    def margins(self, given: ForestArguments, now: ForestInstant, contacts: Array) -> Array:
        """Return the margins of the closures, (closures,), infinite without a limit; of the smallest forces [N].

        Args:
            given: the forest's arguments.
            now: its forces.
            contacts: (closures, 7) numbers of `contact_of`.
        """
        return closure_margins(self._numbers, given.motion({}), now, contacts, self.rank)


def traced_instant(forest: Forest, given: ForestArguments, made: Forest | None = None) -> dict[str, Any]:
    """Return what a step needs of a forest at one time, and the status of its forward dynamics.

    Args:
        forest: the forest.
        given: its traced arguments, with constants as its numbers.
        made: as for `traced_solution`.
    """
    arguments = {"q": given.q, "qd": given.qd, "tau": given.tau, "link_wrench": given.wrenches}
    rates, power = position_rates(given.forest, given.q, given.qd), array(power_into(given, given.motion({})))
    return forward_outputs(traced_solution(forest, arguments, made)) | {"q_rates": rates, "power": power}


def limited_closures(forest: Forest) -> list[bool]:
    """Return whether each closure has friction or a rating."""
    return [bool(limited(contact_of(closure.grasp)) < np.inf) for closure in forest.closures]


class ClosureForces(NamedTuple):
    """Forces of closures and couplings, as in `ForestInstant`."""

    closure_wrench: Array
    coupling_force: Array


def closure_margins(
    forest: Forest, motion: ForestMotion, now: ClosureForces | ForestInstant, contacts: Array, rank: int
) -> Array:
    """Return the margins of the closures, (closures,), infinite without a limit [N].

    Args:
        forest: the forest.
        motion: its motion.
        now: its forces; the smallest ones with the same motion count.
        contacts: (closures, 7) numbers of `contact_of`.
        rank: rank of the constraint.
    """
    has, wrenches = limited_closures(forest), [*now.closure_wrench]
    if any(has) and rank != forest.constraint_row_count:
        wrenches, _ = least_forces(motion, forest_rows(motion), wrenches, [*now.coupling_force], rank)
    rows: Sequence[Any] = [*zip(motion.closures, contacts, wrenches, has, strict=True)]
    return array(
        [contact_margin(c.contact.grasp.kind, x, unrotate(c.contact.R, f)) if own else np.inf for c, x, f, own in rows]
    )


def traced_inverse(given: ForestArguments) -> InverseAt:
    """Return inverse dynamics of traced arguments: what no forces can carry, or no accelerations agree with, is NaN."""
    forest = with_constants(given.forest)
    motion = given._replace(forest=forest, tau=0.0 * given.tau).motion({})
    terms = inverse_terms(motion)

    def carrying(needed: Array, asked: Array) -> CarryingForces:
        found = carrying_forces(forest, terms, needed, asked)
        return found._replace(left=where(found.missing <= MISSING, found.left, np.nan))

    def nearest(qdd: Array, free: Array) -> Array:
        found, apart = nearest_accelerations(terms, qdd, free.astype(float))
        return where(apart <= AGREEING, found, np.nan)

    return InverseAt(terms, partial(loads_for, motion), carrying, nearest, motion)
