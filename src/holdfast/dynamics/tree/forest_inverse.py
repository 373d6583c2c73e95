"""Inverse dynamics of a forest: torques of the joints with drives, and the least loads that carry all else.

Joints without a drive and free bodies are passive. Their part of M qdd + h - G^T lambda = tau has tau = 0, so that the
forces of closures and couplings must satisfy

    G_P^T lambda = (M qdd + h)_P,    lambda the smallest in the metric of forces,    tau_A = (M qdd + h - G^T lambda)_A

M qdd + h is the derivative of the virtual power by the joint rates (`virtual_power`).
"""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial, reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.stacked import block_diagonal
from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE
from holdfast.dynamics.grasp_gap import VELOCITY_TOLERANCE
from holdfast.dynamics.tree.forest_dynamics import forest_arguments
from holdfast.dynamics.tree.forest_gaps import require_closed
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_rows import forest_rows, lever_lengths, weighed_rows
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.dynamics.tree.virtual_power import ForestUnknowns, residual
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closure import Closure
from holdfast.model.forest import Forest
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.linalg import back_substitution, shortest_solution
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum

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
    at = inverse_at(given)
    if check:
        at.require(given, wanted)
    return driving_torques(forest, at, wanted, wanted_forces(forest, at.terms, near))


class InverseTerms(NamedTuple):
    """What inverse dynamics needs to know of a forest besides the loads; rates of free bodies about mass centres.

    Attributes:
        K: (rows of closures, 6) transmitted directions at the contact points.
        G: (rows, n_v) rows of closures and couplings.
        on_qd: (rows, n_v) the same for the rates of frames, qd.
        r: (rows,) right-hand sides, on_qd qdd = r.
        E: (rows, n_v) C^-1 G.
        C: (rows, rows) factor C C^T of the metric of forces.
        unit: (n_v,) `lever_lengths`.
        normals: (closures, 3) normals of the contacts, world axes.
    """

    K: Array
    G: Array
    on_qd: Array
    r: Array
    E: Array
    C: Array
    unit: Array
    normals: Array


class InverseAt(NamedTuple):
    """Inverse dynamics of a forest at one state.

    Attributes:
        terms: what does not depend on accelerations.
        loads: returns M qdd + h, (n_v,), of accelerations qdd.
        carrying: returns the `carrying_forces` of loads and wanted forces along the rows.
        nearest: returns the `smallest_accelerations` of given ones and a mask.
        motion: the forest's motion without torques; None by machine code.
    """

    terms: InverseTerms
    loads: Callable[[Array], Array]
    carrying: Callable[[Array, Array], CarryingForces]
    nearest: Callable[[Array, Array], Array]
    motion: ForestMotion | None = None

    def require(self, given: ForestArguments, qdd: Array) -> None:
        """Refuse a state that is not closed, and accelerations that do not agree with it.

        Raises:
            StateError: naming closures and couplings.
        """
        require_closed(given.motion({}) if self.motion is None else self.motion, given.q, given.qd)
        _require_possible(given.forest, self.terms, qdd)


InverseCode = Callable[[ForestArguments], InverseAt | None]  # None of a forest of which it has no machine code
inverse_code: ContextVar[InverseCode | None] = ContextVar("inverse_code", default=None)  # that of a run


def inverse_at(given: ForestArguments) -> InverseAt:
    """Return inverse dynamics at a state, of which the torques are not used."""
    find = inverse_code.get()
    if (found := find and find(given)) is not None:
        return found
    motion = given._replace(tau=0.0 * given.tau).motion({})
    terms = inverse_terms(motion)
    carrying, nearest = partial(carrying_forces, given.forest, terms), partial(smallest_accelerations, terms)
    return InverseAt(terms, partial(loads_for, motion), carrying, nearest, motion)


def inverse_terms(motion: ForestMotion) -> InverseTerms:
    """Return what does not depend on accelerations."""
    rows = forest_rows(motion)
    weighed, n = weighed_rows(motion, rows), motion.forest.velocity_count
    at_rest = concatenate([*_at_points(motion, np.zeros(n)), np.zeros(0)])
    K = concatenate([c.K.ravel() for c in motion.closures] + [np.zeros(0)]).reshape(-1, 6)
    C = block_diagonal(weighed.factors)
    normals = concatenate([c.contact.R[:, 2] for c in motion.closures] + [np.zeros(0)]).reshape(-1, 3)
    return InverseTerms(
        K, rows.G, rows.on_qd(motion), rows.r - rows.G @ at_rest, weighed.E, C, lever_lengths(motion), normals
    )


def loads_for(motion: ForestMotion, qdd: Array) -> Array:
    """Return M qdd + h, (n_v,), the derivative of the virtual power by the joint rates."""
    rates = _at_points(motion, qdd)
    none = ForestUnknowns(rates, [np.zeros(len(c.K)) for c in motion.closures], np.zeros(len(motion.coupled)))
    return residual(motion, none)[: len(qdd)]


def driving_torques(forest: Forest, at: InverseAt, qdd: Array, asked: Array) -> ForestTorques:
    """Return the torques of the drives, with the forces closest to wanted ones that carry all passive parts. O(n^3).

    Args:
        forest: the forest.
        at: its inverse dynamics at its state.
        qdd: (n_v,) accelerations.
        asked: (rows,) wanted forces along the rows.

    Raises:
        StateError: no forces can carry a passive part, or the numbers overflow.
    """
    terms, needed = at.terms, checks.finite(at.loads(qdd), "inverse dynamics")
    found = at.carrying(needed, asked)
    _require_carried(forest, needed, found.left)
    wrenches = wrenches_along(forest, terms, found.force[: len(terms.K)])
    return ForestTorques(np.where(driven(forest), found.left, 0.0), wrenches, found.force[len(terms.K) :])


class CarryingForces(NamedTuple):
    """Forces of closures and couplings that carry all passive parts.

    Attributes:
        force: (rows,) along the rows.
        left: (n_v,) the loads that they leave to the drives; those of passive parts are missing.
        missing: the largest of these, relative to the largest load, at least 1; no forces can carry more than
            `MISSING`.
    """

    force: Array
    left: Array
    missing: Scalar


def carrying_forces(forest: Forest, terms: InverseTerms, needed: Array, asked: Array) -> CarryingForces:
    """Return the forces closest to wanted ones that carry all passive parts.

    Args:
        forest: the forest.
        terms: at its state.
        needed: (n_v,) M qdd + h.
        asked: (rows,) wanted forces along the rows.
    """
    passive = np.flatnonzero(~driven(forest))
    load = _least(terms.E.T[passive], (needed - terms.G.T @ asked)[passive], terms.unit[passive])
    force = asked + back_substitution(terms.C, load)
    left = needed - terms.G.T @ force
    largest = reduce(maximum, [abs(x) for x in needed], 1.0)
    return CarryingForces(force, left, reduce(maximum, [abs(left[k]) for k in passive], 0.0) / largest)


def wrenches_along(forest: Forest, terms: InverseTerms, force: Array) -> Array:
    """Return the wrenches of forces along the rows of the closures, (closures, 6)."""
    rows = _closures_of_rows(forest)
    found = [terms.K[rows == i].T @ force[rows == i] for i in range(len(forest.closures))]
    return array(found).reshape(-1, 6)


def smallest_accelerations(terms: InverseTerms, given: Array, free: Array) -> Array:
    """Return accelerations whose free ones are nearest to those given, and agree with all else, (n_v,).

    If none agree, those that come closest are returned.

    Args:
        terms: at the forest's state.
        given: (n_v,) accelerations, wished ones of the free joints.
        free: (n_v,) mask of these joints.
    """
    found = given.copy()
    inverse = np.linalg.pinv(terms.on_qd[:, free], rcond=NULL_SINGULAR_VALUE)
    found[free] += inverse @ (terms.r - terms.on_qd @ given)
    return found


def nearest_accelerations(terms: InverseTerms, given: Array, free: Array) -> tuple[Array, Scalar]:
    """Return what `smallest_accelerations` does, traceable, and the part of the accelerations asked for that is left.

    Args:
        terms: at the forest's state.
        given: (n_v,) accelerations, wished ones of the free joints.
        free: (n_v,) 1 for these joints, 0 for the others.
    """
    missing = terms.r - terms.on_qd @ given
    change = free * shortest_solution(terms.on_qd * free, missing, NULL_SINGULAR_VALUE)
    left = [*(terms.on_qd @ change - missing)]
    sizes = reduce(maximum, [abs(x) for x in missing], 1.0)
    return given + change, reduce(maximum, [abs(x) for x in left], 0.0) / sizes


def _at_points(motion: ForestMotion, qdd: Array) -> list[Array]:
    """Return accelerations per body, of free bodies those of their mass centres."""
    rates = [qdd[part] for part in motion.forest.velocities]
    return [b.point_acceleration(x) if b.floats else x for b, x in zip(motion.bodies, rates, strict=True)]


def _closures_of_rows(forest: Forest) -> Array:
    """Return the closure of each of their rows."""
    return np.repeat(range(len(forest.closures)), [len(c.grasp.transmitted) for c in forest.closures]).astype(int)


def pushes(forest: Forest, terms: InverseTerms, sizes: Array) -> Array:
    """Return the parts along the rows of pushes along the normals, (rows,).

    Args:
        forest: the forest.
        terms: at its state.
        sizes: (closures,) pushes [N].
    """
    rows = _closures_of_rows(forest)
    along = (terms.K[:, 3:] * (sizes[:, None] * terms.normals)[rows]).sum(axis=1)
    return np.concatenate([along, np.zeros(len(forest.couplings))])


def wanted_forces(forest: Forest, terms: InverseTerms, near: Array) -> Array:
    """Return wanted wrenches along the rows of the closures, and zeros for couplings, (rows,).

    Raises:
        StateError: a closure does not transmit its wrench.
    """
    asked = along_rows(forest, terms, near)
    transmitted = wrenches_along(forest, terms, asked[: len(terms.K)])
    for closure, f, kept in zip(forest.closures, near, transmitted, strict=True):
        if not untransmitted(f, kept) <= TRANSMITTED:
            raise StateError(
                f"wrench of {_name(forest, closure)}: expected one that a {closure.grasp.kind} grasp transmits,"
                f" got {checks.place(f)}; try {checks.place(kept)}"
            )
    return asked


def along_rows(forest: Forest, terms: InverseTerms, near: Array) -> Array:
    """Return the parts of wrenches (closures, 6) along the rows of the closures, and zeros for couplings, (rows,)."""
    along = [k @ near[i] for k, i in zip(terms.K, _closures_of_rows(forest), strict=True)]
    return array([*along, *[0.0] * len(forest.couplings)])


def untransmitted(wrench: Array, kept: Array) -> Scalar:
    """Return the largest part of a wrench (6,) that is not kept, relative to the wrench, at least 1."""
    return reduce(maximum, abs(wrench - kept)) / reduce(maximum, abs(wrench), 1.0)


def _name(forest: Forest, closure: Closure) -> str:
    return closure.name or f"closure {forest.closures.index(closure)}"


def driven(forest: Forest) -> Array:
    """Return for every component of qd whether it has a drive, (n_v,)."""
    has = [body.joint.actuated and not body.joint.of_kind.floats for body in forest.bodies]
    return np.repeat(has, [body.joint.of_kind.freedoms for body in forest.bodies])


def _least(columns: Array, needed: Array, unit: Array) -> Array:
    """Return the smallest z with columns z = needed."""
    return shortest_solution(columns / unit[:, None], needed / unit, NULL_SINGULAR_VALUE)


def _require_possible(forest: Forest, terms: InverseTerms, qdd: Array) -> None:
    """Refuse accelerations that violate closures or couplings."""
    limit = VELOCITY_TOLERANCE * max(1.0, float(np.abs(qdd).max(initial=0.0)))
    gaps = np.abs(terms.on_qd @ qdd - terms.r)
    largest = np.zeros(len(forest.closures))
    np.maximum.at(largest, _closures_of_rows(forest), gaps[: len(terms.K)])
    apart = [
        f"{_name(forest, c)}: {gap:.3g}" for c, gap in zip(forest.closures, largest, strict=True) if not gap <= limit
    ]
    names = [coupling.name or f"coupling {i}" for i, coupling in enumerate(forest.couplings)]
    apart += [f"{name}: {x:.3g}" for name, x in zip(names, gaps[len(terms.K) :], strict=True) if not x <= limit]
    if apart:
        raise StateError(
            f"qdd: the accelerations do not satisfy the forest: {', '.join(apart)} (m/s^2, rad/s^2), expected <="
            f" {limit:.3g}; try those of forest_dynamics, or check=False"
        )


def _require_carried(forest: Forest, needed: Array, left: Array) -> None:
    """Refuse accelerations of passive parts for which there are no forces; traced loads are then NaN already."""
    if needed.dtype == object:
        return
    limit, passive = MISSING * max(1.0, float(np.abs(needed).max())), ~driven(forest)
    for k, (body, part) in enumerate(zip(forest.bodies, forest.velocities, strict=True)):
        if passive[part].any() and not np.abs(left[part]).max() <= limit:
            name = f"body {k}" + (f" '{body.link.name}'" if body.link.name else "")
            what = "about its mass centre (N m, N)" if body.joint.of_kind.floats else "at its joint (N m or N)"
            raise StateError(
                f"qdd: no wrench can carry {name}, which has no drive: {checks.place(left[part])} is missing {what}."
                " Try other accelerations, a drive (actuated=True), or another closure"
            )
