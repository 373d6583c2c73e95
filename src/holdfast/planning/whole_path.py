"""The cheapest joint path along given poses of the object, over the whole path at once.

    min  int_0^1 c(q) + 1/2 smoothing^4 sum_j (q_j'' / u_j)^2 ds   over q(s) that close the grasps at every s

with s = t / duration, so that the path in space does not depend on its speed. q(0) is given; q' is given at the start
and, for an object that comes to rest, at the end. The samples move along their self-motions, q_k + D N_k z_k, in
Newton steps with the Hessian of the cost on the tangents (Gauss-Newton in the constraint), and are closed again.
The smoothing couples neighbours only, so a step takes a sparse matrix of five diagonals of blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.closed_positions import ACCEPTED, brought_together, position_gap_at, position_rows
from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE, coordinate_sizes
from holdfast.model.closed_chain import ClosedChain
from holdfast.planning.configuration_cost import ConfigurationCost
from holdfast.spatial.scalar import Array
from holdfast.state import State

MOST_PATH_STEPS = 40
PATH_SHORTENINGS = 8
LEAST_GAIN = 1e-5  # gain foreseen by a step, relative to the cost, at which the iteration stops
LONGEST_PATH_STEP = 0.3  # rad, or fraction of the arms' reach, of a sample in one iteration
WEAKEST = 1e-9  # added to the curvature, whose unit is 1 / sizes^2


@dataclass(frozen=True)
class Smoothness:
    """The smoothing term 1/2 |(A q - b) / u|^2 of a path of m samples at equal distances.

    Attributes:
        A: (differences, m) sparse, weighted second differences with respect to s.
        b: (differences, n) their parts that do not depend on the path.
        units: (n,) units u of the joints.
    """

    A: Any
    b: Array
    units: Array

    @staticmethod
    def of(count: int, smoothing: float, units: Array, first: Array, last: Array | None) -> Smoothness:
        """Return the term.

        Args:
            count: number of samples m.
            smoothing: length over which the path is smooth, as a fraction of the path.
            units: (n,) units of the joints.
            first: (n,) dq/ds at the start.
            last: (n,) dq/ds at the end; None to leave it open.
        """
        from scipy.sparse import lil_array  # imported here because it takes half a second

        ds = 1 / (count - 1)
        A, b = lil_array((count, count)), np.zeros((count, len(units)))
        inner, end = smoothing**2 * ds**-1.5, smoothing**2 * 2**0.5 * ds**-1.5
        for k in range(1, count - 1):
            A[k, k - 1 : k + 2] = inner * np.array([1.0, -2.0, 1.0])
        A[0, 0], A[0, 1], b[0] = -end, end, end * ds * first
        if last is not None:
            A[-1, -1], A[-1, -2], b[-1] = -end, end, -end * ds * last
        return Smoothness(A.tocsr(), b, units)

    def residual(self, q: Array) -> Array:
        """Return (A q - b) / u, (differences, n), for a path (m, n)."""
        return (self.A @ q - self.b) / self.units


@dataclass(frozen=True)
class WholePath:
    """A path whose cost is reduced.

    Attributes:
        chain: the chain.
        cost: the cost of a configuration.
        smoothness: the smoothing term.
    """

    chain: ClosedChain
    cost: ConfigurationCost
    smoothness: Smoothness

    def cheapest(self, states: list[State]) -> list[State]:
        """Return the closed states that cost least, from closed states of the same object poses; the first stays."""
        total = self._total(states, [chain_at_rest(self.chain, state) for state in states])
        for _ in range(MOST_PATH_STEPS):
            steps, gain = self._step(states)
            if gain <= LEAST_GAIN * total:
                break
            found = self._shortened(states, steps, total, gain)
            if found is None:
                break
            states, total = found
        return states

    def _total(self, states: list[State], motions: list[ChainMotion]) -> float:
        """Return the cost of the path."""
        values = [self.cost.value(state.q, motion) for state, motion in zip(states, motions, strict=True)]
        smooth = self.smoothness.residual(np.array([state.q for state in states]))
        return float(np.trapezoid(values, dx=1 / (len(states) - 1))) + 0.5 * float((smooth**2).sum())

    def _step(self, states: list[State]) -> tuple[Array, float]:
        """Return the steps of all joints, (m, n), and the gain that they promise."""
        from scipy.sparse import block_diag, diags_array, eye_array, kron
        from scipy.sparse.linalg import spsolve

        count, n, q = len(states), self.chain.joint_count, np.array([state.q for state in states])
        tangents, slopes, curvatures = [np.zeros((n, 0))], [np.zeros(n)], [np.zeros((n, n))]
        for k, state in enumerate(states[1:], start=1):
            motion, share = chain_at_rest(self.chain, state), (0.5 if k == count - 1 else 1.0) / (count - 1)
            terms = self.cost.terms(state.q, motion)
            tangents.append(self_motions(motion))
            slopes.append(share * terms.slope)
            curvatures.append(share * terms.curvature)
        A, units = self.smoothness.A, self.smoothness.units
        slope = np.array(slopes) + A.T @ (self.smoothness.residual(q) / self.smoothness.units)
        if not any(N.size for N in tangents):
            return np.zeros_like(q), 0.0
        N: Any = block_diag(tangents, format="csr")
        H = N.T @ (block_diag(curvatures, format="csr") + kron(A.T @ A, diags_array(units**-2.0))) @ N
        downhill = -(N.T @ slope.ravel())
        z = spsolve((H + WEAKEST * eye_array(H.shape[0])).tocsc(), downhill)
        return (N @ z).reshape(count, n), float(downhill @ z)

    def _shortened(
        self, states: list[State], steps: Array, total: float, gain: float
    ) -> tuple[list[State], float] | None:
        """Return the path after the longest part of the steps that reduces the cost, and its cost, or None."""
        sizes = coordinate_sizes(chain_at_rest(self.chain, states[0]))[: self.chain.joint_count]
        part = min(1.0, LONGEST_PATH_STEP / max(float(np.abs(steps / sizes).max()), 1e-300))
        for _ in range(PATH_SHORTENINGS):
            trial = [states[0], *self._closed(states[1:], part * steps[1:])]
            motions, gaps = zip(*(position_gap_at(self.chain, state) for state in trial), strict=True)
            if max(float(np.abs(gap).max(initial=0.0)) for gap in gaps) <= ACCEPTED:
                after = self._total(trial, list(motions))
                if after < total - 1e-4 * part * gain:
                    return trial, after
            part /= 2
        return None

    def _closed(self, states: list[State], steps: Array) -> list[State]:
        """Return the states after steps of their joints, closed again with the object held."""
        free = np.full(self.chain.joint_count, np.inf)
        held = np.arange(self.chain.velocity_count) >= self.chain.joint_count
        moved = [replace(state, q=state.q + step) for state, step in zip(states, steps, strict=True)]
        return [brought_together(self.chain, state, -free, free, held) for state in moved]


def self_motions(motion: ChainMotion) -> Array:
    """Return a basis of the joint motions that keep the grasps closed while the object rests, (n, d).

    It is orthonormal in units of `coordinate_sizes`.
    """
    n, sizes = motion.chain.joint_count, coordinate_sizes(motion)
    rows = (position_rows(motion) * sizes)[:, :n]
    if not len(rows):
        return np.diag(sizes[:n])
    _, values, Vt = np.linalg.svd(rows)
    return sizes[:n, None] * Vt[int((values > NULL_SINGULAR_VALUE * values.max(initial=0.0)).sum()) :].T
