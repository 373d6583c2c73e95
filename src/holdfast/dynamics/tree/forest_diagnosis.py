"""Rank of a forest part by part, in words, and its comparison with closed postures nearby.

Null forces, ranks and singular postures of a forest are those of its parts with locked roots (docs/theory/tree.md), so
each part is judged by itself: in a forest whose other closures are open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.rank import NEIGHBOUR_DISTANCE, NEIGHBOURS, SHORTER, STRAYED
from holdfast.dynamics.tree.branches import ForestPart
from holdfast.dynamics.tree.forest_closing import closed_positions
from holdfast.dynamics.tree.forest_dynamics import finite_by_plan, forest_arguments
from holdfast.dynamics.tree.forest_gaps import require_closed
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_rows import forest_rows, reach, turning
from holdfast.dynamics.tree.plan import plan_of
from holdfast.dynamics.tree.undetermined_forces import UndeterminedForces, undetermined_forces
from holdfast.dynamics.tree.varied_forest import ForestArguments, displaced, displacement
from holdfast.errors import ClosureError, SingularChainError
from holdfast.model.forest import GROUND, Forest, JointCoupling
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, changed
from holdfast.spatial.scalar import Array

STEPS_TAKEN_BACK = (5e-3, 5e-4, 5e-5)  # rad, or fractions of the forest's reach: near a singular posture short ones
DIRECTIONS = 3  # velocities that are tried
TAKEN_BACK = 0.1  # fraction of a step that closing changes if no motion begins

PartStatus = Literal["regular", "indeterminate", "singular"]


@called
@dataclass(frozen=True, eq=False)
class PartDiagnosis(Frozen):
    """The constraint of one part of a forest, whose loops settle together.

    Attributes:
        name: its bodies and closures, in words.
        bodies: indices of its bodies, without the root on which they hang.
        closures: indices of its closures.
        couplings: indices of its couplings.
        rank: number of independent rows.
        generic_rank: the rank at closed postures nearby.
        rows: number of rows.
        status: "regular", "indeterminate" (the rank is low here and nearby) or "singular" (lower than nearby).
        words: what that means.
    """

    name: str
    bodies: tuple[int, ...]
    closures: tuple[int, ...]
    couplings: tuple[int, ...]
    rank: int
    generic_rank: int
    rows: int
    status: PartStatus
    words: str


@called
@dataclass(frozen=True, eq=False)
class ForestDiagnosis(Frozen):
    """Mobility and rank of a forest in a posture, part by part.

    Attributes:
        mobility: dimension of the space of rates that closures and couplings allow.
        rank: number of independent rows of the constraint.
        generic_rank: the rank at closed postures nearby.
        rows: number of rows.
        condition: dimensionless condition number, as in `ForestResult`; infinite in a singular posture.
        parts: the parts with closures or couplings.
    """

    mobility: int
    rank: int
    generic_rank: int
    rows: int
    condition: float
    parts: tuple[PartDiagnosis, ...]

    @property
    def status(self) -> PartStatus:
        """The worst of the parts."""
        found = {part.status for part in self.parts}
        return "singular" if "singular" in found else "indeterminate" if "indeterminate" in found else "regular"

    def __repr__(self) -> str:
        """Return the report."""
        return f"<ForestDiagnosis: {self.report()}>"

    def report(self) -> str:
        """Return the diagnosis as text, a line for every part that is not regular."""
        head = (
            f"{self.status}: rank {self.rank} of {self.rows} (nearby {self.generic_rank}), mobility {self.mobility},"
            f" condition {self.condition:.3g}"
        )
        return "\n".join([head, *(f"  {part.name}: {part.words}" for part in self.parts if part.status != "regular")])


@np.errstate(all="ignore")  # what overflows is refused
def forest_diagnose(forest: Forest, q: ArrayLike) -> ForestDiagnosis:
    """Return rank and mobility of a forest, and which of its parts are over-constrained or in a singular posture.

    Every part with a low rank is compared with closed postures about 0.1 rad away. O(n) where all rows are independent,
    O(n^2) otherwise.

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions, which satisfy them.

    Raises:
        StateError: a shape is wrong, or the positions violate a closure.
    """
    return diagnosed(forest_arguments(forest, q))


def diagnosed(given: ForestArguments) -> ForestDiagnosis:
    """Return rank and mobility of a forest at rest; see `forest_diagnose`."""
    forest, motion = given.forest, given.motion({})
    require_closed(motion, given.q, given.qd)
    parts = tuple(
        judged(forest, part, given.q) for part in plan_of(forest.topology).parts if part.closures or part.couplings
    )
    rank, singular = sum(part.rank for part in parts), any(part.status == "singular" for part in parts)
    return ForestDiagnosis(
        mobility=forest.velocity_count - rank,
        rank=rank,
        generic_rank=sum(part.generic_rank for part in parts),
        rows=forest.constraint_row_count,
        condition=np.inf if singular else 1.0 / float(finite_by_plan(motion).weakest),
        parts=parts,
    )


def require_regular(forest: Forest, q: Array) -> None:
    """Refuse a posture in which a part has a lower rank than nearby.

    Raises:
        SingularChainError: naming the parts.
    """
    found = (judged(forest, part, q) for part in plan_of(forest.topology).parts if part.closures or part.couplings)
    singular = [f"{part.name}: {part.words}" for part in found if part.status == "singular"]
    if singular:
        raise SingularChainError(
            f"a singular posture, where nothing has derivatives: {'; '.join(singular)}. Try another posture;"
            " forest_diagnose names all parts"
        )


def judged(forest: Forest, part: ForestPart, q: Array) -> PartDiagnosis:
    """Return the rank of one part, and how it compares with closed postures nearby.

    Args:
        forest: the forest.
        part: one of the parts of its plan.
        q: (n_q,) closed positions.
    """
    couplings = [_as_it_stands(forest, forest.couplings[i], q) for i in part.couplings]
    own = Forest(forest.bodies, [forest.closures[i] for i in part.closures], couplings)
    rows, motion = own.constraint_row_count, _at_rest(own, q)
    rank = generic = int(finite_by_plan(motion).rank)
    status: PartStatus = "regular"
    words = f"rank {rank} of {rows}"
    if rank < rows:
        alone = _Alone(own, part, q, motion)
        generic = alone.generic_rank(rank)
        status = "indeterminate"
        words = f"{_count(rows - rank, 'force')} of closures or couplings that nothing determines, here and nearby"
        words += _where(own, undetermined_forces(motion, rank))
        if rank < generic:
            status, words = "singular", f"{_count(generic - rank, 'motion')} more than nearby"
        elif not alone.velocities_are_motions(rank):
            status, words = "singular", "some velocities that its closures allow begin no motion"
    bodies = tuple(sorted(part.members))
    return PartDiagnosis(_name(forest, part), bodies, part.closures, part.couplings, rank, generic, rows, status, words)


def _as_it_stands(forest: Forest, coupling: JointCoupling, q: Array) -> JointCoupling:
    """Return a coupling that keeps its sum of positions in postures nearby, where they add up."""
    joints = [forest.bodies[body].joint.of_kind for body, _, _ in coupling.terms]
    if coupling.offset is not None or any(joint.pose for joint in joints):
        return coupling
    total = sum(c * float(q[forest.positions[body].start + component]) for body, component, c in coupling.terms)
    return changed(coupling, offset=total)


class _Alone:
    """One part of a forest, the other closures being open, and closed postures near to one."""

    def __init__(self, forest: Forest, part: ForestPart, q: Array, motion: ForestMotion) -> None:
        self.forest, self.q, self.motion = forest, q, motion
        self.own = np.zeros(forest.velocity_count, dtype=bool)
        for k in part.members:
            self.own[forest.velocities[k]] = True
        self.unit = np.where(turning(motion), 1.0, reach(motion))

    def closed(self, step: Array) -> Array | None:
        """Return the displacement from here, in units, to the closed posture near a step; None if there is none."""
        try:
            there = closed_positions(self.forest, displaced(self.forest, self.q, self.unit * step))
        except ClosureError:
            return None
        return displacement(self.forest, self.q, there) / self.unit

    def generic_rank(self, rank: int) -> int:
        """Return the largest rank at closed postures nearby; that of here if there are none."""
        for seed in range(NEIGHBOURS):
            step = np.where(self.own, np.random.default_rng(seed).uniform(-1, 1, len(self.own)), 0.0)
            for shorter in SHORTER:
                distance = shorter * NEIGHBOUR_DISTANCE
                moved = self.closed(distance * step)
                if moved is not None and np.abs(moved[self.own]).max() <= STRAYED * distance:
                    there = displaced(self.forest, self.q, self.unit * moved)
                    rank = max(rank, int(finite_by_plan(_at_rest(self.forest, there)).rank))
                    break
            if rank == self.forest.constraint_row_count:
                break
        return rank

    def velocities_are_motions(self, rank: int) -> bool:
        """Return whether the velocities of the part that its closures allow begin motions.

        Steps along a few of them are closed again. At a regular point, a short step persists; in a posture that is
        singular to second order (two bars stretched between two pins), closing changes it in proportion to its length.
        """
        basis = np.linalg.svd(forest_rows(self.motion).on_qd(self.motion)[:, self.own] * self.unit[self.own])[2][
            rank:
        ].T
        ways = [basis @ np.random.default_rng(seed).normal(size=basis.shape[1]) for seed in range(DIRECTIONS)]
        return not basis.shape[1] or all(any(self._leads_on(way, step) for step in STEPS_TAKEN_BACK) for way in ways)

    def _leads_on(self, way: Array, length: float) -> bool:
        """Return whether a step of a given length persists when it is closed again."""
        step = np.zeros(len(self.own))
        step[self.own] = length * way / np.linalg.norm(way)
        moved = self.closed(step)
        return moved is not None and bool(np.linalg.norm((moved - step)[self.own]) <= TAKEN_BACK * length)


def _at_rest(forest: Forest, q: Array) -> ForestMotion:
    none = np.zeros(forest.velocity_count)
    return ForestArguments(forest, q, none, none, np.zeros((len(forest.bodies), 6))).motion({})


def _name(forest: Forest, part: ForestPart) -> str:
    """Return closures and couplings of a part, and its bodies by the names of their links or else their indices."""
    names = [(k, forest.bodies[k].link.name) for k in sorted(part.members)]
    bodies = [name for _, name in names if name]
    unnamed = [k for k, name in names if not name]
    bodies += [_listed("body", "bodies", unnamed)] if unnamed else []
    by = _closing(forest, part.closures, part.couplings)
    listed = " and ".join(by) if len(by) < 3 else ", ".join(by)
    return f"{listed} ({', '.join(bodies)}{' on the ground' if part.root == GROUND else ''})"


def _closing(forest: Forest, closures: Sequence[int], couplings: Sequence[int]) -> list[str]:
    """Return closures and couplings by their names or else their numbers."""
    by = _named("closure", "closures", closures, [c.name for c in forest.closures])
    return by + _named("coupling", "couplings", couplings, [c.name for c in forest.couplings])


def _named(one: str, several: str, numbers: Sequence[int], names: Sequence[str]) -> list[str]:
    """Return the names of closures or couplings, or else their numbers with what they are."""
    known = [names[i] for i in numbers]
    return known if all(known) else [_listed(one, several, numbers)]


def _listed(one: str, several: str, numbers: Sequence[int]) -> str:
    """Return numbers with what they count, two or more in a row as "0 .. 3"."""
    rows: list[list[int]] = []
    for k in numbers:
        if rows and k == rows[-1][-1] + 1:
            rows[-1].append(k)
        else:
            rows.append([k])
    shown = [f"{row[0]} .. {row[-1]}" if len(row) > 2 else ", ".join(map(str, row)) for row in rows]
    return f"{one if len(numbers) == 1 else several} {', '.join(shown)}"


def _where(forest: Forest, groups: Sequence[UndeterminedForces]) -> str:
    """Return which closures and couplings share the forces that nothing determines; nothing if all share all."""
    if len(groups) == 1 and len(groups[0].closures + groups[0].couplings) == len([*forest.closures, *forest.couplings]):
        return ""
    found = []
    for group in groups:
        *most, last = _closing(forest, group.closures, group.couplings)
        count = f"{group.number} " if len(groups) > 1 else ""
        found.append(f"{count}among {', '.join(most)} and {last}" if most else f"{count}in {last}")
    return f": {', '.join(found)}"


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
