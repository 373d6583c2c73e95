"""Closing the chains: positions that satisfy every grasp, and velocities that keep them so."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.consistency import residuals
from holdfast.dynamics.constraint import constraint_rows
from holdfast.dynamics.projection import moved
from holdfast.errors import ClosureError
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

CLOSED = 1e-13  # m and rad: where iterating on stops
ACCEPTED = 1e-10  # m and rad: what counts as closed
MAX_ITERATIONS = 200
LONGEST_STEP = 0.5  # rad or m in one iteration


def close(
    chain: ClosedChain,
    guess: State,
    *,
    hold_object: bool = False,
    limits: bool = True,
    inputs: Inputs | None = None,
) -> State:
    """Return the consistent state nearest to a guess.

    Positions by damped Gauss-Newton steps of least length on the position rows, joints
    kept within their limits; then velocities by `project_velocity`. O(l^3) a step.

    Args:
        chain: the chain.
        guess: positions and velocities to stay near.
        hold_object: keep the object's pose and twist; move the arms only.
        limits: keep joints within their position limits.
        inputs: base motion, if the bases move.

    Raises:
        ClosureError: naming the arms that cannot reach, and by how much.
    """
    guess.fits(chain)
    given = (inputs or Inputs()).shaped(chain)
    low, high = np.concatenate([arm.position_limits for arm in chain.arms.values()]).T
    if not limits:
        low, high = np.full_like(low, -np.inf), np.full_like(high, np.inf)
    state = _clipped(guess, np.zeros(chain.joint_count), np.zeros(6), low, high)
    motion, gap = _at(chain, state, given)
    damping = 1e-6
    for _ in range(MAX_ITERATIONS):
        size = float(np.abs(gap).max(initial=0.0))
        if size <= CLOSED:
            break
        rows = _position_rows(motion)
        n = chain.joint_count
        if hold_object:
            rows[:, n:] = 0.0
        blocked = _blocked(state.q, rows, gap, low, high)
        rows[:, :n][:, blocked] = 0.0
        U, sizes, Vt = np.linalg.svd(rows, full_matrices=False)
        step = -Vt.T @ (sizes / (sizes**2 + damping**2) * (U.T @ gap))
        step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
        trial = _clipped(state, step[:n], step[n:], low, high)
        trial_motion, trial_gap = _at(chain, trial, given)
        if float(np.linalg.norm(trial_gap)) < float(np.linalg.norm(gap)):
            state, motion, gap = trial, trial_motion, trial_gap
            damping = max(damping / 10, 1e-9)
        elif size <= ACCEPTED:
            break  # as closed as rounding allows
        else:
            damping *= 10
            if damping > 1e3:
                break
    _require_reached(motion, state)
    return project_velocity(chain, state, hold_object=hold_object, inputs=inputs)


def project_velocity(
    chain: ClosedChain, state: State, *, hold_object: bool = False, inputs: Inputs | None = None
) -> State:
    """Return the state with the nearest velocities that keep every grasp.

    Nearest in the plain norm of (qd, V(C)); the velocity rows K (A V(C) - J qd) vanish.
    """
    motion, _ = _at(chain, state, (inputs or Inputs()).shaped(chain))
    if not motion.contacts:
        return state
    rows = constraint_rows(motion)
    gap = np.concatenate([c.velocity_gap for c in motion.contacts])
    n = chain.joint_count
    matrix = np.hstack([rows.joints, 0.0 * rows.object if hold_object else rows.object])
    step = np.linalg.lstsq(matrix, gap, rcond=1e-12)[0]
    return State(state.q, state.qd + step[:n], state.object_pose, state.object_twist + step[n:])


def _at(chain: ClosedChain, state: State, given: Inputs) -> tuple[ChainMotion, Array]:
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), given)
    parts = [gap.position for gap in residuals(motion, state).values()]
    return motion, np.concatenate(parts) if parts else np.zeros(0)


def _position_rows(motion: ChainMotion) -> Array:
    """Return d(position residual)/d(q, object): the velocity rows, without a soft finger's spin."""
    rows = constraint_rows(motion)
    matrix = -np.hstack([rows.joints, rows.object])
    keep = np.ones(len(matrix), dtype=bool)
    for c, part in zip(motion.contacts, rows.slices, strict=True):
        if c.grasp.kind == "softfinger":
            keep[part.start] = False  # the row of the moment about the normal
    return matrix[keep]


def _blocked(q: Array, rows: Array, gap: Array, low: Array, high: Array) -> Array:
    """Return which joints stand at a limit and would be pushed beyond it."""
    downhill = -(rows.T @ gap)[: len(q)]
    return ((q <= low) & (downhill < 0)) | ((q >= high) & (downhill > 0))


def _clipped(state: State, dq: Array, dx: Array, low: Array, high: Array) -> State:
    """Return the state displaced, its joints kept within the limits."""
    there = moved(state, dq, dx)
    return State(np.clip(there.q, low, high), there.qd, there.object_pose, there.object_twist)


def _require_reached(motion: ChainMotion, state: State) -> None:
    missed = {
        name: float(np.abs(gap.position).max())
        for name, gap in residuals(motion, state).items()
        if np.abs(gap.position).max() > ACCEPTED
    }
    if missed:
        listed = ", ".join(f"arm '{name}' misses its grasp by {gap:.3g} (m or rad)" for name, gap in missed.items())
        raise ClosureError(
            f"cannot close the chains: {listed}. Try a nearer object pose, another guess for q, other base poses, or"
            " wider joint limits"
        )
