"""Inverse dynamics of a forest: torques of the joints with drives, and the least loads that carry all else.

Joints without a drive and free bodies are passive. Their part of M qdd + h - G^T lambda = tau has tau = 0, so that the
forces of closures and couplings must satisfy

    G_P^T lambda = (M qdd + h)_P,    lambda the smallest in the metric of forces,    tau_A = (M qdd + h - G^T lambda)_A

M qdd + h is the derivative of the virtual power by the joint rates (`virtual_power`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.stacked import block_diagonal
from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE
from holdfast.dynamics.grasp_gap import VELOCITY_TOLERANCE
from holdfast.dynamics.tree.forest_dynamics import forest_arguments
from holdfast.dynamics.tree.forest_gaps import require_closed
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_rows import forest_rows, reach, turning, weighed_rows
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.dynamics.tree.virtual_power import ForestUnknowns, along_rows, carried, outputs, residual
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.forest import Forest
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

TRANSMITTED = 1e-9  # largest part of a wanted wrench, relative to it, that its closure does not transmit
MISSING = 1e-8  # a passive load that is left over, relative to all passive loads, cannot be carried


@called
@dataclass(frozen=True, eq=False)
class ForestTorques(Frozen):
    """Torques for given accelerations. SI units, world axes.

    Attributes:
        tau: (n_v,) torques; 0 for joints without a drive and for free bodies.
        closure_wrench: (closures, 6) [moment; force] of body a on body b about the contact point [N m, N].
        coupling_force: (couplings,) multipliers; a coupling acts on each of its joints with c times this.
    """

    tau: Array
    closure_wrench: Array
    coupling_force: Array


@np.errstate(all="ignore")  # what overflows is refused
def forest_inverse_dynamics(
    forest: Forest,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    wrenches: ArrayLike | None = None,
    *,
    closure_wrench: ArrayLike | None = None,
    check: bool = True,
) -> ForestTorques:
    """Return the torques of the drives for given accelerations, and the least forces that carry all passive parts.

    The forces of closures and couplings are the smallest that accelerate free bodies and joints without a drive
    (`BodyJoint.actuated`) as asked, in the metric of `forest_dynamics`, which gives the accelerations back for these
    torques. O(n^3).

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions.
        qd: (n_v,) rates.
        qdd: (n_v,) accelerations, the time derivatives of qd, which satisfy the closures.
        wrenches: (bodies, 6) external wrenches about the origins of the bodies' frames; zero by default.
        closure_wrench: (closures, 6) wanted wrenches of the closures; the forces are then those that are closest to
            them. Zero by default.
        check: if False, it is not checked whether state and accelerations satisfy closures and couplings.

    Raises:
        StateError: a shape is wrong, the state or the accelerations violate a closure or a coupling, a wanted wrench is
            not one of its closure, or no forces of closures and couplings can carry a passive part; the message says
            what is missing.
    """
    given = forest_arguments(forest, q, qd, wrenches=wrenches)
    shape = len(forest.closures), 6
    near = np.zeros(shape) if closure_wrench is None else closure_wrench
    return torques_for(given, qdd, checks.numbers(near, shape, "closure_wrench", StateError), check)


def torques_for(given: ForestArguments, qdd: ArrayLike, near: Array, check: bool) -> ForestTorques:
    """Return the torques for given accelerations; see `forest_inverse_dynamics`.

    Args:
        given: the forest's arguments, of which the torques are not used.
        qdd: (n_v,) accelerations.
        near: (closures, 6) wanted wrenches.
        check: whether state and accelerations must satisfy closures and couplings.
    """
    forest = given.forest
    wanted = checks.numbers(qdd, (forest.velocity_count,), "qdd", StateError)
    motion = given._replace(tau=0.0 * given.tau).motion({})
    rates = _at_points(motion, wanted)
    if check:
        require_closed(motion, given.q, given.qd)
        _require_possible(motion, rates)
    none = ForestUnknowns(rates, [np.zeros(len(c.K)) for c in motion.closures], np.zeros(len(motion.coupled)))
    needed = checks.finite(residual(motion, none)[: forest.velocity_count], "inverse dynamics")
    rows = forest_rows(motion)
    weighed = weighed_rows(motion, rows)
    passive = ~driven(forest)
    asked = _along(motion, near)
    load = _least(motion, weighed.E.T[passive], (needed - rows.G.T @ asked)[passive])
    C = block_diagonal(weighed.factors)
    force = asked + (np.linalg.solve(C.T, load) if len(C) else load)
    left = needed - rows.G.T @ force
    _require_carried(motion, passive, needed, left)
    ends = np.cumsum([len(c.K) for c in motion.closures]).tolist()
    *along, coupled = np.split(force, ends) if ends else [force]
    z = none._replace(closures=along, couplings=coupled)
    return ForestTorques(
        np.where(passive, 0.0, left), outputs(motion, z, carried(motion, z.rates)).closure_wrench, coupled
    )


def smallest_accelerations(motion: ForestMotion, given: Array, free: Array) -> Array:
    """Return the smallest accelerations of some joints that agree with those of all else, (free,).

    If none do, those that come closest are returned.

    Args:
        motion: the forest's motion.
        given: (n_v,) accelerations, zero for these joints.
        free: (n_v,) mask of these joints.
    """
    rates = _at_points(motion, given)
    closed, coupled = along_rows(motion, rates, carried(motion, rates))
    left = [c.r - x for c, x in zip(motion.closures, closed, strict=True)]
    missing = np.concatenate([*left, [r - x for r, x in zip(motion.coupled, coupled, strict=True)]])
    return np.linalg.pinv(forest_rows(motion).on_qd(motion)[:, free], rcond=NULL_SINGULAR_VALUE) @ missing


def _at_points(motion: ForestMotion, qdd: Array) -> list[Array]:
    """Return accelerations per body, of free bodies those of their mass centres."""
    rates = [qdd[part] for part in motion.forest.velocities]
    return [b.point_acceleration(x) if b.floats else x for b, x in zip(motion.bodies, rates, strict=True)]


def _along(motion: ForestMotion, near: Array) -> Array:
    """Return wanted wrenches along the rows of the closures, and zeros for couplings."""
    parts = [c.K @ f for c, f in zip(motion.closures, near, strict=True)]
    for i, (c, f, along) in enumerate(zip(motion.closures, near, parts, strict=True)):
        if not np.abs(f - along @ c.K).max() <= TRANSMITTED * max(1.0, float(np.abs(f).max())):
            closure = motion.forest.closures[i]
            raise StateError(
                f"wrench of {closure.name or f'closure {i}'}: expected one that a {closure.grasp.kind} grasp transmits,"
                f" got {checks.place(f)}; try {checks.place(along @ c.K)}"
            )
    return np.concatenate([*parts, np.zeros(len(motion.coupled))])


def driven(forest: Forest) -> Array:
    """Return for every component of qd whether it has a drive, (n_v,)."""
    has = [body.joint.actuated and not body.joint.of_kind.floats for body in forest.bodies]
    return np.repeat(has, [body.joint.of_kind.freedoms for body in forest.bodies])


def _least(motion: ForestMotion, columns: Array, needed: Array) -> Array:
    """Return the smallest z with columns z = needed, once more for what rounding leaves."""
    unit = np.where(np.array(turning(motion)), reach(motion), 1.0)[~driven(motion.forest)]
    inverse = np.linalg.pinv(columns / unit[:, None], rcond=NULL_SINGULAR_VALUE) / unit
    found = inverse @ needed
    return found + inverse @ (needed - columns @ found)


def _require_possible(motion: ForestMotion, rates: list[Array]) -> None:
    """Refuse accelerations that violate closures or couplings."""
    closed, coupled = along_rows(motion, rates, carried(motion, rates))
    limit = VELOCITY_TOLERANCE * max(1.0, *(float(np.abs(x).max()) for x in rates))
    gaps = [float(np.abs(x - c.r).max(initial=0.0)) for x, c in zip(closed, motion.closures, strict=True)]
    names = [closure.name or f"closure {i}" for i, closure in enumerate(motion.forest.closures)]
    apart = [f"{name}: {gap:.3g}" for name, gap in zip(names, gaps, strict=True) if not gap <= limit]
    names = [coupling.name or f"coupling {i}" for i, coupling in enumerate(motion.forest.couplings)]
    apart += [f"{name}: {abs(x):.3g}" for name, x in zip(names, coupled, strict=True) if not abs(x) <= limit]
    if apart:
        raise StateError(
            f"qdd: the accelerations do not satisfy the forest: {', '.join(apart)} (m/s^2, rad/s^2), expected <="
            f" {limit:.3g}; try those of forest_dynamics, or check=False"
        )


def _require_carried(motion: ForestMotion, passive: Array, needed: Array, left: Array) -> None:
    """Refuse accelerations of passive parts for which there are no forces."""
    forest = motion.forest
    limit = MISSING * max(1.0, float(np.abs(needed).max()))
    for k, (body, part) in enumerate(zip(forest.bodies, forest.velocities, strict=True)):
        if passive[part].any() and not np.abs(left[part]).max() <= limit:
            name = f"body {k}" + (f" '{body.link.name}'" if body.link.name else "")
            what = "about its mass centre (N m, N)" if body.joint.of_kind.floats else "at its joint (N m or N)"
            raise StateError(
                f"qdd: no wrench can carry {name}, which has no drive: {checks.place(left[part])} is missing {what}."
                " Try other accelerations, a drive (actuated=True), or another closure"
            )
