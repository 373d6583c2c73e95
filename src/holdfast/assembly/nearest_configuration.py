"""The closed configuration nearest to a preferred one, by Newton's method along the self-motions.

    min 1/2 |D (q - q*)|^2   over closed states,   D = 1 / (1 rad, or the longest reach)

At the minimum D (q - q*) is orthogonal to every motion that keeps the chains closed: with N a
basis of the velocities (qd, V(C)) that the position rows C allow, N^T c = 0 for the gradient
c = [D (q - q*); 0]. The Hessian is N^T (D^2 + sum lambda_i d^2 c_i) N with the multipliers
C^T lambda = -c. Its second part, the curvature of the constraint, is computed from differences of C^T lambda.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import forward_kinematics, jacobian
from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.closing import close
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.contact_places import contact_places
from holdfast.dynamics.projection import moved
from holdfast.errors import ClosureError
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate, twist_shift
from holdfast.state import State

STATIONARY = 1e-11  # |N^T c| below which the iteration stops
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
        unstopped: (n + 6,) step along these motions, in scaled coordinates.
        to_limits: (n + 6,) step that moves stopped joints exactly to their limits.
    """

    slope: float
    unstopped: Array
    to_limits: Array

    @property
    def step(self) -> Array:
        """The whole step, (n + 6,)."""
        return self.unstopped + self.to_limits


def nearest_configuration(chain: ClosedChain, state: State, preferred: Array, *, hold_object: bool = False) -> State:
    """Return the closed state at rest whose joints are nearest to preferred positions.

    This is the local minimum that is found by self-motions from the given state. Joints stay within their limits.

    Args:
        chain: the chain.
        state: a closed state.
        preferred: (n,) joint positions [rad or m].
        hold_object: keep the pose of the object; otherwise it is optimised, too.
    """
    sizes = unit_sizes(chain, state)
    for _ in range(MOST_SEARCH_STEPS):
        newton = _newton(chain, state, preferred, sizes, hold_object)
        if max(newton.slope, float(np.linalg.norm(newton.to_limits))) <= STATIONARY:
            break
        better = _shortened(chain, state, preferred, sizes, hold_object, newton)
        if better is None:
            break  # rounding prevents further progress
        state = better
    return state


def distance(chain: ClosedChain, state: State, preferred: Array) -> float:
    """Return |D (q - q*)|, with joint angles in rad and strokes relative to the longest reach."""
    return float(np.linalg.norm((state.q - preferred) / unit_sizes(chain, state)[: chain.joint_count]))


def unit_sizes(chain: ClosedChain, state: State) -> Array:
    """Return the units of the joint coordinates and of the object's [turn; shift], (n + 6,)."""
    return coordinate_sizes(chain_at_rest(chain, state))


def position_rows(chain: ClosedChain, state: State) -> Array:
    """Return C, (rows, n + 6), where velocities with C (qd, V(C)) = 0 keep the grasps closed.

    These are the rows K [J, -A] without the spin of soft fingers, which has no position row.
    """
    blocks = []
    for name, (grasp, R, offset) in zip(chain.grasps, contact_places(chain, state), strict=True):
        arm, part, kind = chain.arms[name], chain.joints[name], grasp.of_kind
        kept = list(kind.position_rows)
        K = np.array([rotate(R, row) for row in kind.directions[kept]])
        rows = np.zeros((len(kept), chain.joint_count + 6))
        rows[:, part] = K @ jacobian(arm, forward_kinematics(arm, state.q[part]))
        rows[:, chain.joint_count :] = -K @ twist_shift(offset)
        blocks.append(rows)
    return np.concatenate(blocks) if blocks else np.zeros((0, chain.joint_count + 6))


def _newton(chain: ClosedChain, state: State, preferred: Array, sizes: Array, hold_object: bool) -> _Newton:
    """Return the Newton step within the limits; the first limit that it crosses is made active, repeatedly."""
    n = chain.joint_count
    room = (np.concatenate([arm.position_limits for arm in chain.arms.values()]).T - state.q) / sizes[:n]
    rows = position_rows(chain, state) * sizes
    slope = np.r_[(state.q - preferred) / sizes[:n], np.zeros(6)]
    ends = np.full(n + 6, np.nan)  # prescribed values of coordinates
    if hold_object:
        ends[n:] = 0.0
    while True:
        stopped = ~np.isnan(ends)
        whole = np.concatenate([rows, np.eye(n + 6)[stopped]])
        _, values, Vt = np.linalg.svd(whole)
        basis = Vt[int((values > DEPENDENT_ROWS * values.max(initial=0.0)).sum()) :].T
        to_limits = np.linalg.lstsq(whole, np.r_[np.zeros(len(rows)), ends[stopped]], rcond=DEPENDENT_ROWS)[0]
        unstopped = basis @ _descent(chain, state, sizes, rows, whole, basis, slope)
        step = (unstopped + to_limits)[:n]
        share = np.where(step > 0, room[1], -room[0]) / np.maximum(np.abs(step), 1e-300)  # part of the step to a limit
        share[stopped[:n] | (np.abs(step) <= SHORTEST_CROSSING)] = np.inf
        if not (share < 1).any():
            return _Newton(float(np.linalg.norm(basis.T @ slope)), unstopped, to_limits)
        first = int(np.argmin(share))
        ends[first] = room[1, first] if step[first] > 0 else room[0, first]


def _descent(
    chain: ClosedChain, state: State, sizes: Array, rows: Array, whole: Array, basis: Array, slope: Array
) -> Array:
    """Return the Newton step along the basis, reversed in directions of negative curvature, (d,)."""
    n = chain.joint_count
    multipliers = np.linalg.lstsq(whole.T, -slope, rcond=DEPENDENT_ROWS)[0][: len(rows)]

    def pull(direction: Array) -> Array:
        there = moved(state, sizes * direction)
        return (position_rows(chain, there) * sizes).T @ multipliers

    curvature = [(pull(DIFFERENCE_SIZE * v) - pull(-DIFFERENCE_SIZE * v)) / (2 * DIFFERENCE_SIZE) for v in basis.T]
    H = basis[:n].T @ basis[:n] + basis.T @ np.array(curvature).reshape(basis.shape[1], n + 6).T
    values, vectors = np.linalg.eigh(0.5 * (H + H.T))
    return -vectors @ (vectors.T @ (basis.T @ slope) / np.maximum(np.abs(values), FLATTEST))


def _shortened(
    chain: ClosedChain, state: State, preferred: Array, sizes: Array, hold_object: bool, newton: _Newton
) -> State | None:
    """Return the closed state after the longest part of the step that reduces the distance, or None.

    Far from the minimum, the distance must decrease. Near it, where rounding hides this decrease, the slope must.
    """
    n, step = chain.joint_count, newton.step
    apart = (state.q - preferred) / sizes[:n]
    before = 0.5 * float(apart @ apart)
    step = step * min(1.0, LONGEST_SEARCH_STEP / max(float(np.abs(step).max()), 1e-300))
    for _ in range(SHORTENINGS):
        try:
            trial = close(chain, moved(state, sizes * step), hold_object=hold_object)
        except ClosureError:
            step = step / 2
            continue
        after = 0.5 * float(np.sum(((trial.q - preferred) / sizes[:n]) ** 2))
        if after < before - 1e-4 * abs(float(step[:n] @ apart)):
            return trial
        if after <= before + 1e-10 * (1 + before):
            there = _newton(chain, trial, preferred, sizes, hold_object)
            if there.slope + np.linalg.norm(there.to_limits) < 0.5 * (newton.slope + np.linalg.norm(newton.to_limits)):
                return trial
        step = step / 2
    return None
