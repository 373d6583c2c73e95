"""The equations of a chain's forest as dense matrices in the coordinates of qd.

M qdd + h = tau + G^T lambda,   G qdd = r

The rates of a free body are those of its frame's origin, so that its part of the first equation is a wrench about it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE
from holdfast.dynamics.tree.forest_gaps import require_closed
from holdfast.dynamics.tree.forest_inverse import driven
from holdfast.dynamics.tree.forest_kkt import mass_and_load
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_rows import ForestRows, forest_rows, lever_lengths, weighed_rows
from holdfast.dynamics.tree.mechanism_terms import mechanism_arguments
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import centripetal, shift_twist
from holdfast.state import Inputs, State

CENTRE_OF_MASS = "centre_of_mass"  # among the names of frames


class ForestEquations(NamedTuple):
    """The equations of a chain's forest at one instant, without torques of drives.

    Attributes:
        chain: the chain.
        motion: the motion of its forest.
        rows: the constraint, in which the rates of free bodies are those of their mass centres.
        to_points: (n_v, n_v) S and (n_v,) s of S qdd + s, the rates that belong to the points of the bodies.
        M: (n_v, n_v) mass matrix.
        h: (n_v,) torques and wrenches without accelerations.
        G: (rows, n_v) rows of closures in order, then of couplings.
        r: (rows,) their right-hand side.
        pushed: (n_v,) wrenches on free bodies about the origins of their frames; they are part of h.
        passive: (n_v,) whether a component has no drive.
    """

    chain: ClosedChain
    motion: ForestMotion
    rows: ForestRows
    to_points: tuple[Array, Array]
    M: Array
    h: Array
    G: Array
    r: Array
    pushed: Array
    passive: Array

    @property
    def size(self) -> int:
        """The number n_v of accelerations."""
        return len(self.h)

    def acceleration_of(self, name: str) -> tuple[Array, Array]:
        """Return J (6, n_v) and b (6,) of J qdd + b, the true acceleration of a frame's origin, world axes.

        That of the centre of mass of all bodies, `CENTRE_OF_MASS`, has three rows.

        Raises:
            ModelError: there is no such frame.
        """
        forest = self.chain.as_forest
        if name == CENTRE_OF_MASS and name not in forest.objects:
            links = [body.link for body in self.motion.forest.bodies]
            each = [self._of_point(k, link.com) for k, link in enumerate(links)]
            shares = np.array([link.mass for link in links]) / sum(link.mass for link in links)
            of_rates, of_rest = np.array([J[3:] for J, _ in each]), np.array([b[3:] for _, b in each])
            return np.tensordot(shares, of_rates, 1), shares @ of_rest
        k, pose = forest.frame(self.chain, name, f"acceleration of '{name}'")
        assert k is not None  # only None is the world
        return self._of_point(k, pose.p)

    def _of_point(self, k: int, p: Array) -> tuple[Array, Array]:
        """Return the same for a point p of a body, (3,), in the axes of its frame."""
        body, (S, s), J = self.motion.bodies[k], self.to_points, self.rows.jacobians[k]
        still = body.at.zeta + J @ s + np.concatenate([np.zeros(3), self.motion.forest.gravity])
        l = body.at.frame.R @ p - body.at.centre
        about = np.concatenate([np.zeros(3), centripetal(body.at.twist[:3], l)])
        return np.array([shift_twist(l, column) for column in (J @ S).T]).T, shift_twist(l, still) + about

    def unfelt_rows(self) -> Array:
        """Return rows that make the forces without effect zero, (k, rows), in the metric of `forest_dynamics`."""
        weighed = weighed_rows(self.motion, self.rows)
        U, s, _ = np.linalg.svd(weighed.E / lever_lengths(self.motion))
        none = U[:, int((s > NULL_SINGULAR_VALUE * s.max(initial=0.0)).sum()) :]
        ends = np.cumsum([0, *(len(factor) for factor in weighed.factors)]).tolist()
        parts = zip(weighed.factors, ends, strict=False)
        columns = [none[start : start + len(C)].T @ C.T for C, start in parts]
        return np.hstack([np.zeros((none.shape[1], 0)), *columns])


@np.errstate(all="ignore")  # what overflows is refused
def forest_equations(chain: ClosedChain, state: State, inputs: Inputs | None) -> ForestEquations:
    """Return the equations of a chain's forest. O(n^3).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: external wrenches and base motion; zero by default.

    Raises:
        StateError: a shape is wrong, or the state violates a grasp, a loop or a coupling.
    """
    given = mechanism_arguments(chain, state, inputs=inputs)
    motion = given.motion({})
    require_closed(motion, given.q, given.qd)
    forest, rows = motion.forest, forest_rows(motion)
    n = forest.velocity_count
    S, s, pushed = np.eye(n), np.zeros(n), np.zeros(n)
    M, load = mass_and_load(motion, rows)
    for body, part in zip(motion.bodies, forest.velocities, strict=True):
        if body.floats:
            S[part, part] = np.array([shift_twist(body.at.centre, unit) for unit in np.eye(6)]).T
            s[part], pushed[part] = body.point_acceleration(np.zeros(6)), body.wrench
    h, pushed, r = S.T @ (M @ s - load), S.T @ pushed, rows.r - rows.G @ s
    return ForestEquations(chain, motion, rows, (S, s), S.T @ M @ S, h, rows.G @ S, r, pushed, ~driven(forest))
