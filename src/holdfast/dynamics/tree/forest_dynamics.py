"""Forward dynamics of a forest, and its result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.tip_response import LEAST_INERTIA
from holdfast.dynamics.result import Status
from holdfast.dynamics.tree.elimination import contradictions, solved
from holdfast.dynamics.tree.forest_gaps import require_closed
from holdfast.dynamics.tree.forest_kkt import forest_kkt
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_rows import forest_rows, least_forces
from holdfast.dynamics.tree.outward import ForestSolution
from holdfast.dynamics.tree.plan import plan_of
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.errors import MethodNotApplicable, ModelError, SingularChainError, StateError
from holdfast.model import checks
from holdfast.model.forest import Forest
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar

CONTRADICTION = 1e-8  # relative violation of a closure's acceleration above which no accelerations satisfy it


@called
@dataclass(frozen=True, eq=False)
class ForestResult(Frozen):
    """Accelerations and forces of a forest. SI units, world axes.

    Attributes:
        forest: the forest it belongs to.
        qdd: (n_v,) time derivatives of qd, in the order of the bodies; of a free body, its true acceleration.
        acceleration: (bodies, 6) [omega_dot; v_dot] of the origins of all bodies' frames, true accelerations.
        closure_wrench: (closures, 6) [moment; force] of body a on body b about the contact point [N m, N].
        coupling_force: (couplings,) multipliers lambda; a coupling acts on each of its joints with c lambda.
        rank: number of independent rows of the constraint on qd.
        mobility: n_v minus the rank.
        status: whether the forces are unique; see `Status`.
        condition: dimensionless condition number of the constraint, the inverse of the smallest pivot; 1 by `kkt`,
            which does not determine it.
        method: name of the algorithm.
    """

    forest: Forest
    qdd: Array
    acceleration: Array
    closure_wrench: Array
    coupling_force: Array
    rank: int
    mobility: int
    status: Status
    condition: float
    method: str

    def __repr__(self) -> str:
        """Return the method, rank, condition and status, on one line."""
        if self.qdd.ndim > 1:
            return f"<{type(self).__name__} by {self.method}: {len(self.qdd)} systems>"
        head = f"{type(self).__name__} by {self.method}: rank {self.rank}, mobility {self.mobility}"
        return f"<{head}, condition {self.condition:.4g}; {self.status.value}>"


def by_plan(motion: ForestMotion) -> ForestSolution:
    """Return the solution by the elimination in the order of the forest's plan."""
    return solved(motion, plan_of(motion.forest.topology))


def finite_by_plan(motion: ForestMotion) -> ForestSolution:
    """Return the solution by the elimination after checking that it is finite, since no rank is read from NaN.

    Raises:
        ModelError: a joint has nothing beyond it that resists its acceleration.
        StateError: some numbers have overflowed float64.
    """
    found = by_plan(motion)
    numbers = np.concatenate([*found.qdd, *found.wrenches, found.multipliers, [found.weakest]])
    if not np.isfinite(numbers).all():
        _require_inertia(motion.forest, found)
        checks.finite(numbers, "forest")
    return found


FOREST_METHODS: dict[str, Callable[[ForestMotion], ForestSolution]] = {
    "sequential": by_plan,
    "kkt": forest_kkt,
}


@np.errstate(all="ignore")  # what overflows is refused below
def forest_dynamics(
    forest: Forest,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    wrenches: ArrayLike | None = None,
    *,
    method: str = "sequential",
    check: bool = True,
) -> ForestResult:
    """Return the accelerations of all bodies, the wrench of every closure and the force of every coupling.

    Solves M qdd + h = tau + G^T lambda with G qdd = r, the rows of closures and couplings. Where forces are not unique,
    the smallest are returned. The cost is O(n) as long as the number of loops that are open at a time is bounded, and
    O(n^3) by `kkt`.

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions, in the order of the bodies (`Forest`).
        qd: (n_v,) rates.
        tau: (n_v,) torques [N m or N]; for a free body, a wrench about its frame's origin.
        wrenches: (bodies, 6) external wrenches about the origins of the bodies' frames; zero by default.
        method: "sequential", the elimination in the order of the forest's plan, or "kkt", dense equations.
        check: if False, the residuals of closures and couplings are not checked.

    Raises:
        StateError: a shape is wrong, or the state violates a closure or a coupling.
        ModelError: a joint has nothing beyond it that resists its acceleration.
        SingularChainError: no accelerations satisfy the closures, in a singular posture.
        MethodNotApplicable: there is no such method.
    """
    if not isinstance(method, str) or method not in FOREST_METHODS:
        hint = checks.did_you_mean(str(method), FOREST_METHODS)
        raise MethodNotApplicable(f"no method {checks.short(method)} for a forest.{hint}")
    return solved_forest(forest_arguments(forest, q, qd, tau, wrenches), method, check)[2]


def forest_arguments(
    forest: Forest, q: ArrayLike, qd: Any = ..., tau: Any = ..., wrenches: ArrayLike | None = None
) -> ForestArguments:
    """Return the checked arguments of a question of a forest; rates and torques that are left out are zero."""
    checks.instance(forest, Forest, "forest")
    n, none = (forest.velocity_count,), np.zeros(forest.velocity_count)
    rates = none if qd is ... else checks.numbers(qd, n, "qd", StateError)
    torque = none if tau is ... else checks.numbers(tau, n, "tau", StateError)
    pushed = np.zeros((len(forest.bodies), 6)) if wrenches is None else wrenches
    pushed = checks.numbers(pushed, (len(forest.bodies), 6), "wrenches", StateError)
    return ForestArguments(forest, forest_positions(forest, q), rates, torque, pushed)


def solved_forest(
    given: ForestArguments, method: str = "sequential", check: bool = True
) -> tuple[ForestMotion, ForestSolution, ForestResult]:
    """Return the motion of a forest, its solution and what it means for users; see `forest_dynamics`."""
    motion = given.motion({})
    return motion, *solved_motion(motion, given.q, given.qd, method, check)


@np.errstate(all="ignore")
def solved_motion(
    motion: ForestMotion, q: Array, qd: Array, method: str, check: bool
) -> tuple[ForestSolution, ForestResult]:
    """Return the solution of a forest in motion, and what it means for users.

    Args:
        motion: its motion.
        q: (n_q,) its positions.
        qd: (n_v,) its rates.
        method: a key of `FOREST_METHODS`.
        check: whether closures and couplings must be satisfied.
    """
    forest = motion.forest
    if check:
        require_closed(motion, q, qd)
    found = FOREST_METHODS[method](motion)
    _require_inertia(forest, found)
    accelerations, qdd = true_accelerations(motion, found)
    if not np.isfinite(np.concatenate([*qdd, *found.wrenches, found.multipliers])).all():
        raise StateError("the accelerations overflow float64; check the sizes of lengths, masses, rates and torques")
    rank = int(found.rank)
    _require_satisfied(motion, found, rank)
    forces = found.wrenches, found.multipliers
    return found, forest_result(motion, qdd, accelerations, *forces, rank, 1.0 / float(found.weakest), method)


def forest_result(
    motion: ForestMotion,
    qdd: list[Array],
    accelerations: list[Array],
    wrenches: list[Array],
    multipliers: list[Scalar],
    rank: int,
    condition: float,
    method: str,
) -> ForestResult:
    """Return a result, with the smallest forces where they are not unique; for arguments see `ForestResult`."""
    forest = motion.forest
    unique = rank == forest.constraint_row_count
    if not unique:
        wrenches, multipliers = least_forces(motion, forest_rows(motion), wrenches, multipliers, rank)
        checks.finite(np.concatenate([*wrenches, multipliers]), "the smallest forces")
    return ForestResult(
        forest,
        np.concatenate(qdd),
        np.array(accelerations),
        np.array(wrenches).reshape(-1, 6),
        np.array(multipliers),
        rank,
        forest.velocity_count - rank,
        Status.OK if unique else Status.INDETERMINATE_FORCES,
        condition,
        method,
    )


def true_accelerations(motion: ForestMotion, found: ForestSolution) -> tuple[list[Array], list[Array]]:
    """Return per body the true acceleration of its frame's origin, (6,), and qdd, (m,)."""
    gravity = motion.forest.gravity
    accelerations = [b.true_acceleration(x, gravity) for b, x in zip(motion.bodies, found.beta, strict=True)]
    return accelerations, [
        a if b.floats else x for a, b, x in zip(accelerations, motion.bodies, found.qdd, strict=True)
    ]


def forest_positions(forest: Forest, q: ArrayLike) -> Array:
    """Return checked positions with unit quaternions.

    Raises:
        StateError: the shape is wrong, or a quaternion is not of unit length; those that are traced are not checked.
    """
    found = np.array(checks.numbers(q, (forest.position_count,), "q", StateError))
    for at, _ in forest.quaternions if found.dtype != object else ():
        length = float(np.linalg.norm(found[at]))
        if abs(length - 1.0) > checks.ROTATION_TOLERANCE:
            k = next(k for k, part in enumerate(forest.positions) if part.start == at.start < part.stop)
            link = forest.bodies[k].link
            name = f"{k} '{link.name}'" if link.name else str(k)
            raise StateError(
                f"q of body {name}: expected a unit quaternion (w, x, y, z) first, got length {length:.9g}"
            )
        found[at] /= length
    return found


def _require_inertia(forest: Forest, found: ForestSolution) -> None:
    """Refuse a joint beyond which nothing has inertia about it while the closures are open."""
    pivots = [p for p, body in zip(found.pivots, forest.bodies, strict=False) if not body.joint.of_kind.floats]
    largest = max((float(p.max()) for p in pivots), default=0.0)
    for k, (body, p) in enumerate(zip(forest.bodies, found.pivots, strict=False)):
        if not body.joint.of_kind.floats and not p.min() > LEAST_INERTIA * largest:
            name = f"body {k}" + (f" '{body.link.name}'" if body.link.name else "")
            raise ModelError(
                f"{name}: no inertia beyond its {body.joint.kind} joint while the closures are open; give it mass,"
                " inertia or armature, or close its loop at its other end"
            )


def _require_satisfied(motion: ForestMotion, found: ForestSolution, rank: int) -> None:
    """Refuse accelerations that violate closures, which happens only if some rows depend on others."""
    forest = motion.forest
    if rank == forest.constraint_row_count:
        return
    names = [closure.name or f"closure {i}" for i, closure in enumerate(forest.closures)]
    names += [coupling.name or f"coupling {i}" for i, coupling in enumerate(forest.couplings)]
    for name, left in zip(names, contradictions(motion, found.qdd, found.beta), strict=True):
        if left > CONTRADICTION:
            _refuse_singular(forest, rank, name)


def _refuse_singular(forest: Forest, rank: int, what: str) -> NoReturn:
    raise SingularChainError(
        f"the constraint has rank {rank} of {forest.constraint_row_count} here, and no accelerations satisfy {what}: a"
        " singular posture, or forces so large that rounding hides the closure. Try another posture"
    )
