"""The positions that close the grasps: damped Gauss-Newton steps of least norm, with the joints within their limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.consistency import residuals
from holdfast.dynamics.constraint import constraint_rows, coordinate_sizes
from holdfast.dynamics.projection import moved, position_contact
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import State

CLOSED_RESIDUAL = 1e-13  # rad, and lengths relative to the arms' reach: the iteration stops below this residual
ACCEPTED = 1e-10  # same units: a state with a residual below this counts as closed
MAX_ITERATIONS = 200
LONGEST_NEWTON_STEP = 0.5  # largest step of one iteration: rad, or fraction of the arms' reach


def arms_brought(chain: ClosedChain, state: State, low: Array, high: Array) -> State:
    """Return the state with the grasps closed and the object held.

    Each arm is solved by itself, so that an arm that cannot reach does not keep the others from converging.
    """
    q, arms = np.array(state.q), chain_at_rest(chain, state).arms
    for name, grasp in chain.grasps.items():
        part = chain.joints[name]
        alone = ClosedChain({name: arms[name].arm}, chain.held_object, {name: grasp})
        start = State(q[part], state.qd[part], state.object_pose)
        held = np.arange(alone.velocity_count) >= alone.joint_count
        q[part] = brought_together(alone, start, low[part], high[part], held).q
    return replace(state, q=q)


def brought_together(chain: ClosedChain, state: State, low: Array, high: Array, held: Array) -> State:
    """Return the state with the grasps closed as far as possible; held coordinates do not change."""
    motion, gap = position_gap_at(chain, state)
    damping = 1e-6
    for _ in range(MAX_ITERATIONS):
        size = float(np.abs(gap).max(initial=0.0))
        if size <= CLOSED_RESIDUAL:
            break
        sizes = coordinate_sizes(motion)
        rows = np.where(held, 0.0, position_rows(motion) * sizes)
        step = np.where(held, 0.0, _inward_step(rows, gap, damping, state.q <= low, state.q >= high))
        step *= min(1.0, LONGEST_NEWTON_STEP / max(float(np.abs(step).max()), 1e-300))
        trial = _clipped(state, sizes * step, low, high)
        trial_motion, trial_gap = position_gap_at(chain, trial)
        if float(np.linalg.norm(trial_gap)) < float(np.linalg.norm(gap)):
            state, motion, gap = trial, trial_motion, trial_gap
            damping = max(damping / 10, 1e-9)
        elif size <= ACCEPTED or damping > 1e3:
            break  # rounding allows no smaller residual, or the iteration has stalled
        else:
            damping *= 10
    return state


def position_gap_at(chain: ClosedChain, state: State) -> tuple[ChainMotion, Array]:
    """Return the chain at rest and its position residuals, with lengths divided by the arms' reach."""
    motion = chain_at_rest(chain, state)
    return motion, position_gaps(motion, state)


def position_gaps(motion: ChainMotion, state: State) -> Array:
    """Return the position residuals of all grasps, with lengths divided by the arms' reach."""
    reach = coordinate_sizes(motion)[-1]
    parts = []
    for gap in residuals(motion, state).values():
        lengths = np.arange(len(gap.position)) >= len(gap.position) - 3
        parts.append(np.where(lengths, gap.position / reach, gap.position))
    return np.concatenate(parts) if parts else np.zeros(0)


def position_rows(motion: ChainMotion) -> Array:
    """Return d(residual)/d(q, object): those velocity rows that are time derivatives of position rows."""
    rows = constraint_rows(replace(motion, contacts=[position_contact(c) for c in motion.contacts]))
    matrix, reach = -rows.matrix, coordinate_sizes(motion)[-1]
    for part in rows.slices:
        matrix[max(part.start, part.stop - 3) : part.stop] /= reach
    return matrix


def _inward_step(rows: Array, gap: Array, damping: float, lowest: Array, highest: Array) -> Array:
    """Return the damped Gauss-Newton step; joints at a limit do not move if the step would push them beyond it.

    Args:
        rows: (rows, n + 6) Jacobian of the residuals.
        gap: (rows,) the residuals.
        damping: singular values below this are damped out.
        lowest: (n,) True where a joint is at its lower limit.
        highest: (n,) True where a joint is at its upper limit.
    """
    n, rows = len(lowest), rows.copy()
    checks.finite(np.append(rows, gap), "closing the grasps")
    while True:
        U, s, Vt = np.linalg.svd(rows, full_matrices=False)
        step = -Vt.T @ (s / (s**2 + damping**2) * (U.T @ gap))
        beyond = (lowest & (step[:n] < 0)) | (highest & (step[:n] > 0))
        beyond &= rows[:, :n].any(axis=0)  # columns that are already removed move by rounding only
        if not beyond.any():
            return step
        rows[:, :n][:, beyond] = 0.0


def _clipped(state: State, step: Array, low: Array, high: Array) -> State:
    """Return the state displaced by (dq, rotation vector, translation), with the joints kept within the limits."""
    there = moved(state, step)
    return replace(there, q=np.clip(there.q, low, high))
