"""Positions and velocities that satisfy a forest's closures and couplings, and impulses when it becomes closed.

A gap in velocity is removed by the smallest change in the kinetic metric, which is the forest at rest with the gaps as
right-hand sides of its rows: the elimination in the order of its plan, as for accelerations (docs/theory/tree.md).
Positions are closed beforehand by damped steps of least norm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE
from holdfast.dynamics.result import Status
from holdfast.dynamics.tree.forest_balance import kinetic_energy
from holdfast.dynamics.tree.forest_dynamics import finite_by_plan, forest_arguments
from holdfast.dynamics.tree.forest_gaps import ForestGaps, position_gaps, require_closed, velocity_gaps
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_rows import forest_rows, least_forces, reach, turning
from holdfast.dynamics.tree.outward import ForestSolution
from holdfast.dynamics.tree.varied_forest import ForestArguments, displaced
from holdfast.errors import ClosureError, StateError
from holdfast.model.forest import Forest
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

FOREST_CLOSED = 1e-13  # m and rad: the iteration stops below this gap
NEARLY_CLOSED = 1e-10  # a state with a gap below this is closed, if rounding allows no smaller one
MOST_CLOSING_STEPS = 100
LONGEST_CLOSING_STEP = 0.5  # rad and m
FIRST_DAMPING, WEAKEST_DAMPING, STRONGEST_DAMPING = 1e-2, 1e-6, 1e6  # of the largest squared singular value, per gap


@called
@dataclass(frozen=True, eq=False)
class ForestState(Frozen):
    """Positions and rates of a forest.

    Attributes:
        q: (n_q,) positions.
        qd: (n_v,) rates.
    """

    q: Array
    qd: Array


@called
@dataclass(frozen=True, eq=False)
class ForestImpulse(Frozen):
    """Rates of a forest after impulses at its closures and couplings. SI units, world axes.

    Attributes:
        qd: (n_v,) rates afterwards.
        closure_impulse: (closures, 6) [moment; force] impulse of body a on body b about the contact point [N m s, N s].
        coupling_impulse: (couplings,) multipliers; a coupling acts on each of its joints with c times this.
        energy_change: change of the kinetic energy, which is not positive [J].
        status: whether the impulses are unique; if not, they are the smallest, as forces are. Rates are always unique.
    """

    qd: Array
    closure_impulse: Array
    coupling_impulse: Array
    energy_change: float
    status: Status


@np.errstate(all="ignore")  # what overflows is refused
def forest_close(
    forest: Forest, q: ArrayLike, qd: ArrayLike | None = None, *, held: ArrayLike | None = None
) -> ForestState:
    """Return the state near a given one that satisfies all closures and couplings, O(n^3) per step.

    Damped Gauss-Newton steps of least norm, with lengths in units of the forest's reach, close the position rows and
    the couplings with offsets; then the rates are changed once, by the smallest change in the kinetic metric, or with
    some held, by that of least norm in the same lengths.

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions to start from.
        qd: (n_v,) rates to stay near; zero by default.
        held: (n_v,) booleans, True for coordinates of qd that do not move and keep their rates; none by default.

    Raises:
        StateError: a shape is wrong.
        ClosureError: the closures cannot be closed from there; the message names the gaps.
    """
    given = forest_arguments(forest, q, ... if qd is None else qd)
    if held is None:
        there = given._replace(q=closed_positions(forest, given.q))
        return ForestState(there.q, given.qd + _velocity_change(there)[0])
    fixed = np.asarray(held, dtype=bool)
    if fixed.shape != (forest.velocity_count,):
        raise StateError(f"held: expected {forest.velocity_count} booleans, got an array of shape {fixed.shape}")
    there = given._replace(q=closed_positions(forest, given.q, fixed))
    return ForestState(there.q, given.qd + _velocity_step(there, fixed))


@np.errstate(all="ignore")  # what overflows is refused
def forest_impulse(forest: Forest, q: ArrayLike, qd: ArrayLike) -> ForestImpulse:
    """Return the rates after the impulses that make them agree at all closures and couplings. O(n).

    M dqd = G^T p with G (qd + dqd) = 0: perfectly plastic, as when a hand grips or a foot lands.

    Args:
        forest: bodies, closures and couplings, the new ones among them.
        q: (n_q,) positions, which satisfy them.
        qd: (n_v,) rates before.

    Raises:
        StateError: a shape is wrong, or the positions violate a closure.
    """
    given = forest_arguments(forest, q, qd)
    still = given._replace(qd=0.0 * given.qd)
    require_closed(still.motion({}), still.q, still.qd)
    return impulse_of(given)


def impulse_of(given: ForestArguments) -> ForestImpulse:
    """Return the rates of a forest after impulses that make them agree; see `forest_impulse`."""
    forest = given.forest
    change, found, motion = _velocity_change(given)
    rank, wrenches, multipliers = int(found.rank), found.wrenches, found.multipliers
    unique = rank == forest.constraint_row_count
    if not unique:
        wrenches, multipliers = least_forces(motion, forest_rows(motion), wrenches, multipliers, rank)
    after = given._replace(qd=given.qd + change)
    return ForestImpulse(
        after.qd,
        np.array(wrenches).reshape(-1, 6),
        np.array(multipliers),
        float(kinetic_energy(after.motion({}), after.qd) - kinetic_energy(motion, given.qd)),
        Status.OK if unique else Status.INDETERMINATE_FORCES,
    )


def closed_positions(forest: Forest, q: Array, held: Array | bool = False) -> Array:
    """Return positions near some with closures and couplings satisfied; see `forest_close`.

    Rows that follow from others are independent while closures are open, if weakly, and would lead astray: singular
    values below the damping are left out, which is adapted as the gaps become smaller or not (Levenberg and Marquardt).
    """
    motion, gaps = _gaps_at(forest, q)
    damping = FIRST_DAMPING
    for _ in range(MOST_CLOSING_STEPS):
        if gaps.largest <= FOREST_CLOSED:
            break
        step = _damped_step(motion, gaps, damping, held)
        there = displaced(forest, q, step * min(1.0, LONGEST_CLOSING_STEP / max(float(np.abs(step).max()), 1e-300)))
        moved, left = _gaps_at(forest, there)
        if left.size < gaps.size:
            damping = max(0.3 * damping, WEAKEST_DAMPING)
            q, motion, gaps = there, moved, left
        elif damping > (1.0 if gaps.largest <= NEARLY_CLOSED else STRONGEST_DAMPING):
            break  # rounding allows no smaller gap, or the iteration has stalled
        else:
            damping *= 10.0
    if not gaps.largest <= NEARLY_CLOSED:
        open_ones = [
            f"{x:.3g} at closure {i}" for i, gap in enumerate(gaps.closures) if (x := _largest(gap)) > NEARLY_CLOSED
        ]
        open_ones += [f"{abs(x):.3g} at coupling {i}" for i, x in enumerate(gaps.couplings) if abs(x) > NEARLY_CLOSED]
        raise ClosureError(
            f"cannot close the forest: gaps (m or rad) of {', '.join(open_ones)} are left; try positions nearer to a"
            " closed posture, or other frames of the closures"
        )
    return q


def _velocity_change(given: ForestArguments) -> tuple[Array, ForestSolution, ForestMotion]:
    """Return the change of rates that removes velocity gaps, the solution at rest, and the motion before."""
    motion = given.motion({})
    gaps = velocity_gaps(motion, given.qd)
    found = finite_by_plan(motion.at_rest_with([-x for x in gaps.closures], [-x for x in gaps.couplings]))
    change = [body.of_frame(x) for body, x in zip(motion.bodies, found.qdd, strict=True)]
    return np.concatenate(change), found, motion


def _velocity_step(given: ForestArguments, held: Array) -> Array:
    """Return the least change of the rates that are not held, with lengths in units of the forest's reach, (n_v,)."""
    motion = given.motion({})
    gaps = velocity_gaps(motion, given.qd)
    unit = np.where(held, 0.0, np.where(turning(motion), 1.0, reach(motion)))
    rows = forest_rows(motion).on_qd(motion) * unit
    step = np.linalg.lstsq(rows, -np.concatenate([*gaps.closures, gaps.couplings]), NULL_SINGULAR_VALUE)[0]
    return unit * step


def _damped_step(motion: ForestMotion, gaps: ForestGaps, damping: float, held: Array | bool) -> Array:
    """Return the smallest step, with lengths in units of the forest's reach, in the coordinates of qd, (n_v,)."""
    unit = np.where(held, 0.0, np.where(turning(motion), 1.0, reach(motion)))
    U, s, Vt = np.linalg.svd(forest_rows(motion).on_qd(motion) * unit, full_matrices=False)
    apart = np.concatenate([*gaps.closures, gaps.couplings])
    return unit * (Vt.T @ (s / (s * s + damping * gaps.size * s[0] ** 2) * (U.T @ -apart)))


def _gaps_at(forest: Forest, q: Array) -> tuple[ForestMotion, ForestGaps]:
    """Return the forest at rest with its position rows, and the gaps along them."""
    none = np.zeros(forest.velocity_count)
    motion = ForestArguments(forest, q, none, none, np.zeros((len(forest.bodies), 6))).motion({})
    return motion._replace(closures=[c.in_position() for c in motion.closures]), position_gaps(motion, q)


def _largest(gap: Array) -> float:
    return float(np.abs(gap).max(initial=0.0))
