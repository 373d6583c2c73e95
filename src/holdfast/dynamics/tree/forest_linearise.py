"""Linearisation of a forest's dynamics about a state, in independent coordinates.

A change of state x = (dq, dqd) keeps closures and couplings satisfied if it lies in the span of

    T = [ N_p  0 ; -G_v^+ D N_p  N_v ],    N_p = null G_p,  N_v = null G_v,  D = d(G_v qd)/dq

with the rows G_p of positions and G_v of rates; A = T^+ F_x T and B = T^+ F_u (docs/theory/derivatives.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE
from holdfast.dynamics.tree.forest_derivatives import POSITIONS_RATES_TORQUES, jacobian_of
from holdfast.dynamics.tree.forest_dynamics import forest_arguments
from holdfast.dynamics.tree.forest_gaps import velocity_gaps
from holdfast.dynamics.tree.forest_rows import forest_rows
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.model.forest import Forest
from holdfast.names import called
from holdfast.spatial.differentiation import linearised
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, concatenate
from holdfast.spatial.vector import skew


@called
@dataclass(frozen=True, eq=False)
class ForestLinearisation(Frozen):
    """The linearisation dz/dt = A z + B (tau - tau_0) + rate about a state.

    Attributes:
        A: (m, m) derivative with respect to z.
        B: (m, n_v) derivative with respect to the torques.
        rate: (m,) dz/dt at the state itself; zero in equilibrium.
        basis: (2 n_v, m) T with the rows (dq, dqd), both in the coordinates of qd.
    """

    A: Array
    B: Array
    rate: Array
    basis: Array


@np.errstate(all="ignore")  # what overflows is refused
def forest_linearise(
    forest: Forest,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    wrenches: ArrayLike | None = None,
    *,
    check: bool = True,
) -> ForestLinearisation:
    """Return the linearisation of `forest_dynamics` along the motions that closures and couplings allow, O(n^3).

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions.
        qd: (n_v,) rates.
        tau: (n_v,) torques [N m or N].
        wrenches: (bodies, 6) external wrenches about the origins of the bodies' frames; zero by default.
        check: False skips the consistency check.

    Raises:
        StateError: a shape is wrong, or the state violates a closure or a coupling.
        SingularChainError: the posture is singular.
    """
    return linearised_forest(forest_arguments(forest, q, qd, tau, wrenches), check)


def linearised_forest(given: ForestArguments, check: bool) -> ForestLinearisation:
    """Return the linearisation at some arguments; see `forest_linearise`."""
    found, forest = jacobian_of(given, ("qdd",), POSITIONS_RATES_TORQUES, check), given.forest
    motion, n = given.motion({}), forest.velocity_count

    def gaps(dq: Array) -> tuple[Array]:
        apart = velocity_gaps(given.motion({"q": dq}), given.qd)
        return (concatenate([*apart.closures, [0.0 * x for x in apart.couplings]]),)

    in_position = motion._replace(closures=[c.in_position() for c in motion.closures])
    N_p, G = _null_space(forest_rows(in_position).on_qd(motion)), forest_rows(motion).on_qd(motion)
    (turned,) = linearised(gaps, np.zeros(n)).along(np.eye(n))
    N_v = _null_space(G)
    follows = -np.linalg.pinv(G, rcond=NULL_SINGULAR_VALUE) @ turned @ N_p
    T = np.block([[N_p, np.zeros((n, N_v.shape[1]))], [follows, N_v]])
    F_x, F_u = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n))
    F_x[:n, n:] = np.eye(n)
    for body, at in zip(forest.bodies, forest.velocities, strict=True):
        if body.joint.of_kind.pose:  # a small turn, from the left, is carried along by the angular velocity
            turn = slice(at.start, at.start + 3)
            F_x[turn, turn] = skew(given.qd[turn])
    F_x[n:, :n], F_x[n:, n:], F_u[n:] = found["qdd", "q"], found["qdd", "qd"], found["qdd", "tau"]
    inverse, rate = np.linalg.pinv(T), np.concatenate([given.qd, found.result.qdd])
    return ForestLinearisation(inverse @ F_x @ T, inverse @ F_u, inverse @ rate, T)


def _null_space(G: Array) -> Array:
    """Return an orthonormal basis of the null space, (n_v, k)."""
    if not len(G):
        return np.eye(G.shape[1])
    _, sizes, Vt = np.linalg.svd(G)
    return Vt[int((sizes > NULL_SINGULAR_VALUE * sizes[0]).sum()) :].T
