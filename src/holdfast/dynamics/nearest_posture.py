"""The closed configuration whose joints cost least, by Newton's method along the self-motions.

    min 1/2 sum k_j (q_j - q*_j)^2   over closed states

At the minimum the gradient is orthogonal to every motion that keeps the chains closed: with N a basis of the
velocities (qd, V(C)) that the position rows C allow, in units of `coordinate_sizes` D, N^T c = 0 for the gradient
c = [D k (q - q*); 0]. The Hessian is N^T (D k D + sum lambda_i d^2 c_i) N with the multipliers
C^T lambda = -c. Its second part, the curvature of the constraint, is computed from differences of C^T lambda.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.closed_positions import ACCEPTED, brought_together, position_gap_at, position_rows
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.posture import PostureCost
from holdfast.dynamics.projection import moved
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import State

STATIONARY = 1e-11  # |N^T c|, with the largest k of about 1, below which the iteration stops
MOST_SEARCH_STEPS = 60
LONGEST_SEARCH_STEP = 0.3  # rad, or fraction of the arms' reach, in one iteration
SHORTENINGS = 12
DIFFERENCE_SIZE = 1e-5  # size of the finite differences
FLATTEST = 1e-6  # smallest curvature that is used
DEPENDENT_ROWS = 1e-10  # singular values below this, relative to the largest, count as zero
SHORTEST_CROSSING = 1e-13  # rad, or fraction of the reach: shorter steps do not count as crossing a limit


class _Newton(NamedTuple):
    """A Newton step along the allowed motions at a state, within the joint limits.

    Attributes:
        slope: |N^T c| for the motions that no limit stops.
        unstopped: (columns,) step along these motions, in scaled coordinates.
        to_limits: (columns,) step that moves stopped joints exactly to their limits.
    """

    slope: float
    unstopped: Array
    to_limits: Array

    @property
    def step(self) -> Array:
        """The whole step, (columns,)."""
        return self.unstopped + self.to_limits


@dataclass(frozen=True)
class _Search:
    """What stays the same during the search.

    Attributes:
        chain: the chain.
        cost: the cost, with stiffnesses of at most about 1 in units of the coordinates.
        sizes: units of the coordinates, as in `coordinate_sizes`.
        held: mask of the coordinates that do not move.
        low: (n,) lowest joint positions.
        high: (n,) highest joint positions.
    """

    chain: ClosedChain
    cost: PostureCost
    sizes: Array
    held: Array
    low: Array
    high: Array

    def rows(self, state: State) -> Array:
        """Return C for velocities in units of the coordinates, (rows, columns)."""
        return position_rows(chain_at_rest(self.chain, state)) * self.sizes

    def slope(self, state: State) -> Array:
        """Return the gradient of the cost, (columns,)."""
        slope, n = np.zeros(len(self.sizes)), self.chain.joint_count
        slope[:n] = self.cost.stiffness * (state.q - self.cost.wish) * self.sizes[:n]
        return slope


def nearest_posture(chain: ClosedChain, state: State, cost: PostureCost, held: Array, low: Array, high: Array) -> State:
    """Return the closed state at rest whose joints cost least.

    This is the local minimum that is found by self-motions from the given state.

    Args:
        chain: the chain.
        state: a closed state.
        cost: the cost of joint positions.
        held: mask of the columns of `ConstraintRows.matrix` that do not move.
        low: (n,) lowest joint positions [rad or m].
        high: (n,) highest joint positions [rad or m].
    """
    sizes = coordinate_sizes(chain_at_rest(chain, state))
    largest = float((cost.stiffness * sizes[: chain.joint_count] ** 2).max(initial=0.0))
    if largest == 0.0:
        return state.at_rest()
    search = _Search(chain, cost._replace(stiffness=cost.stiffness / largest), sizes, held, low, high)
    for _ in range(MOST_SEARCH_STEPS):
        newton = _newton(search, state)
        if max(newton.slope, float(np.linalg.norm(newton.to_limits))) <= STATIONARY:
            break
        better = _shortened(search, state, newton)
        if better is None:
            break  # rounding prevents further progress
        state = better
    return state.at_rest()


def _newton(search: _Search, state: State) -> _Newton:
    """Return the Newton step within the limits; the first limit that it crosses is made active, repeatedly."""
    n, columns = search.chain.joint_count, len(search.sizes)
    room = (np.array([search.low, search.high]) - state.q) / search.sizes[:n]
    rows, slope = search.rows(state), search.slope(state)
    ends = np.where(search.held, 0.0, np.nan)  # prescribed values of coordinates
    while True:
        stopped = ~np.isnan(ends)
        whole = np.concatenate([rows, np.eye(columns)[stopped]])
        _, values, Vt = np.linalg.svd(whole)
        basis = Vt[int((values > DEPENDENT_ROWS * values.max(initial=0.0)).sum()) :].T
        to_limits = np.linalg.lstsq(whole, np.r_[np.zeros(len(rows)), ends[stopped]], rcond=DEPENDENT_ROWS)[0]
        unstopped = basis @ _descent(search, state, rows, whole, basis, slope)
        step = (unstopped + to_limits)[:n]
        share = np.where(step > 0, room[1], -room[0]) / np.maximum(np.abs(step), 1e-300)  # part of the step to a limit
        share[stopped[:n] | (np.abs(step) <= SHORTEST_CROSSING)] = np.inf
        if not (share < 1).any():
            return _Newton(float(np.linalg.norm(basis.T @ slope)), unstopped, to_limits)
        first = int(np.argmin(share))
        ends[first] = room[1, first] if step[first] > 0 else room[0, first]


def _descent(search: _Search, state: State, rows: Array, whole: Array, basis: Array, slope: Array) -> Array:
    """Return the Newton step along the basis, reversed in directions of negative curvature, (d,).

    Args:
        search: the search.
        state: a closed state.
        rows: the rows of C.
        whole: these and the rows of stopped coordinates.
        basis: (columns, d) the motions that are left.
        slope: (columns,) gradient of the cost.
    """
    n = search.chain.joint_count
    multipliers = np.linalg.lstsq(whole.T, -slope, rcond=DEPENDENT_ROWS)[0][: len(rows)]

    def pull(direction: Array) -> Array:
        return search.rows(moved(state, search.sizes * direction)).T @ multipliers

    curvature = [(pull(DIFFERENCE_SIZE * v) - pull(-DIFFERENCE_SIZE * v)) / (2 * DIFFERENCE_SIZE) for v in basis.T]
    stiffness = search.cost.stiffness * search.sizes[:n] ** 2
    H = (basis[:n].T * stiffness) @ basis[:n] + basis.T @ np.array(curvature).reshape(basis.shape[1], len(basis)).T
    values, vectors = np.linalg.eigh(0.5 * (H + H.T))
    return -vectors @ (vectors.T @ (basis.T @ slope) / np.maximum(np.abs(values), FLATTEST))


def _shortened(search: _Search, state: State, newton: _Newton) -> State | None:
    """Return the closed state after the longest part of the step that reduces the cost, or None.

    Far from the minimum, the cost must decrease. Near it, where rounding hides this decrease, the slope must.
    """
    chain, cost, step = search.chain, search.cost, newton.step
    before, falling = cost.of(state.q), abs(float(step @ search.slope(state)))
    shorter = min(1.0, LONGEST_SEARCH_STEP / max(float(np.abs(step).max()), 1e-300))
    for _ in range(SHORTENINGS):
        trial = moved(state, np.where(search.held, 0.0, shorter * search.sizes * step))
        trial = replace(trial, q=np.clip(trial.q, search.low, search.high))
        trial = brought_together(chain, trial, search.low, search.high, search.held)
        if float(np.abs(position_gap_at(chain, trial)[1]).max(initial=0.0)) <= ACCEPTED:
            after = cost.of(trial.q)
            if after < before - 1e-4 * shorter * falling:
                return trial
            if after <= before + 1e-10 * (1 + before):
                there = _newton(search, trial)
                left = newton.slope + np.linalg.norm(newton.to_limits)
                if there.slope + np.linalg.norm(there.to_limits) < 0.5 * left:
                    return trial
        shorter /= 2
    return None
