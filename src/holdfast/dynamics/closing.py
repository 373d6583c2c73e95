"""Closing the chains: positions that satisfy every grasp, and velocities that keep them so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest, chain_motion
from holdfast.dynamics.consistency import residuals
from holdfast.dynamics.constraint import constraint_rows, coordinate_sizes
from holdfast.dynamics.indeterminate import NULL_SINGULAR_VALUE
from holdfast.dynamics.projection import Change, moved, quickened
from holdfast.errors import ClosureError
from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.model.tip_direction import advice_for
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

CLOSED = 1e-13  # rad, and lengths over the arms' reach: where iterating on stops
ACCEPTED = 1e-10  # the same: what counts as closed
MAX_ITERATIONS = 200
# Of the largest singular value, per position gap: beside the constraint rows may seem independent that are not on it.
NULL_PER_GAP = 1e3
LONGEST_STEP = 0.5  # rad, or part of the arms' reach, in one iteration
WORTH_NAMING = 1e-2  # of the largest miss: a smaller one was only waiting for it
MOST_NAMED = 4  # arms in one message
MOST_ADVISED = 2  # pieces of advice, where tips seem to point another way than the hands


def close(
    chain: ClosedChain,
    guess: State,
    *,
    hold_object: bool = False,
    hold_trunk: bool = True,
    hold_base: bool = False,
    limits: bool = True,
    inputs: Inputs | None = None,
) -> State:
    """Return the consistent state nearest to a guess.

    Positions by damped Gauss-Newton steps of least length on the position rows (lengths in
    units of the arms' reach), joints kept within their limits; then velocities by
    `project_velocity`. O(l^3) a step; O(l) with the object held.

    Args:
        chain: the chain.
        guess: positions and velocities to stay near.
        hold_object: keep the object's pose and twist, and those of a trunk; move the arms only.
        hold_trunk: False: with the object held, a trunk may move as well.
        hold_base: keep pose and twist of a floating base.
        limits: keep joints within their position limits.
        inputs: base motion, if the bases move.

    Raises:
        ClosureError: naming the arms that cannot reach, and by how much.
    """
    guess.fits(chain)
    low, high = np.array([joint.position_limits for joint in chain.all_joints]).reshape(-1, 2).T
    if not limits:
        low, high = np.full_like(low, -np.inf), np.full_like(high, np.inf)
    # the object where it is: a turn by nothing may cost the last bit
    state = replace(guess, q=np.clip(guess.q, low, high))
    alone = hold_object and (hold_trunk or chain.trunk is None)
    if alone:
        state = _arms_brought(chain, state, low, high)
    else:
        held = _held_columns(chain, hold_object=hold_object, hold_trunk=False, hold_base=hold_base)
        state = _brought_together(chain, state, low, high, held)
    _require_reached(chain, state)
    held = _held_columns(chain, hold_object=hold_object, hold_trunk=alone, hold_base=hold_base)
    return _with_velocities(chain, state, held, inputs)


def project_velocity(
    chain: ClosedChain,
    state: State,
    *,
    hold_object: bool = False,
    hold_base: bool = False,
    inputs: Inputs | None = None,
) -> State:
    """Return the state with the nearest velocities that keep every grasp.

    Nearest in the norm of (qd, V(C)) with lengths in units of the arms' reach; the
    velocity rows K (A V(C) - J qd) vanish. O(n^3).

    Args:
        chain: the chain.
        state: positions that close the grasps, and velocities to stay near.
        hold_object: keep the object's twist, and that of a trunk; change the joint rates of the arms only.
        hold_base: keep the twist of a floating base.
        inputs: base motion, if the bases move.

    Raises:
        StateError: a state or inputs of the wrong shape for the chain.
    """
    state.fits(chain)
    held = _held_columns(chain, hold_object=hold_object, hold_trunk=hold_object, hold_base=hold_base)
    return _with_velocities(chain, state, held, inputs)


def _with_velocities(chain: ClosedChain, state: State, hold: Array, inputs: Inputs | None) -> State:
    """Return the state with the nearest velocities that keep every grasp, some coordinates held; see above."""
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), (inputs or Inputs()).shaped(chain))
    if not any(c.rows for c in motion.contacts):
        return state
    n, sizes = chain.joint_count, coordinate_sizes(motion)
    gap = np.concatenate([c.velocity_gap for c in motion.contacts])
    U, s, Vt = np.linalg.svd(_velocity_rows(motion, hold), full_matrices=False)
    rank = int((s > NULL_SINGULAR_VALUE * s[0]).sum())
    position_gap = np.abs(_position_gaps(motion, state)).max(initial=0.0)
    if rank > 0 and s[rank - 1] < NULL_PER_GAP * position_gap * s[0]:
        # a row that follows from others does so where the grasps are closed; beside it, it would stop the motion
        free = np.full(n, np.inf)
        none = np.zeros(chain.velocity_count, dtype=bool)
        closed = chain_at_rest(chain, _brought_together(chain, state, -free, free, none))
        there = np.linalg.svd(_velocity_rows(closed, hold), compute_uv=False)
        rank = min(rank, int((there > NULL_SINGULAR_VALUE * there[0]).sum()))
    step = sizes * (Vt[:rank].T @ ((U[:, :rank].T @ gap) / s[:rank]))
    return quickened(state, Change(step[:n], step[n : n + 6], step[n + 6 :] if chain.floats else None))


def _held_columns(chain: ClosedChain, *, hold_object: bool, hold_trunk: bool, hold_base: bool) -> Array:
    """Return which columns of `ConstraintRows.matrix` are kept from moving, (n + 6,) or (n + 12,) booleans."""
    n, held = chain.joint_count, np.zeros(chain.velocity_count, dtype=bool)
    held[n : n + 6] = hold_object
    held[n + 6 :] = hold_base or hold_trunk
    if chain.trunk is not None:
        held[chain.joints[TRUNK]] = hold_trunk
    return held


def _velocity_rows(motion: ChainMotion, held: Array) -> Array:
    """Return K [J, -A] for unknowns in units of `coordinate_sizes`, zero where they are held."""
    return np.where(held, 0.0, constraint_rows(motion).matrix * coordinate_sizes(motion))


def _arms_brought(chain: ClosedChain, state: State, low: Array, high: Array) -> State:
    """Return the state with the grasps closed, the object held: each arm is alone, none waits for one that cannot."""
    q, arms = np.array(state.q), chain_at_rest(chain, state).arms
    for name, grasp in chain.grasps.items():
        part = chain.joints[name]
        alone = ClosedChain({name: arms[name].arm}, chain.held_object, {name: grasp})
        start = State(q[part], state.qd[part], state.object_pose)
        held = np.arange(alone.velocity_count) >= alone.joint_count
        q[part] = _brought_together(alone, start, low[part], high[part], held).q
    return replace(state, q=q)


def _brought_together(chain: ClosedChain, state: State, low: Array, high: Array, held: Array) -> State:
    """Return the state with the grasps closed, as far as they can be; coordinates that are held stay."""
    motion, gap = _gap(chain, state)
    damping = 1e-6
    for _ in range(MAX_ITERATIONS):
        size = float(np.abs(gap).max(initial=0.0))
        if size <= CLOSED:
            break
        sizes = coordinate_sizes(motion)
        rows = np.where(held, 0.0, _position_rows(motion) * sizes)
        step = _inward_step(rows, gap, damping, state.q <= low, state.q >= high)
        step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
        trial = _clipped(state, sizes * step, low, high)
        trial_motion, trial_gap = _gap(chain, trial)
        if float(np.linalg.norm(trial_gap)) < float(np.linalg.norm(gap)):
            state, motion, gap = trial, trial_motion, trial_gap
            damping = max(damping / 10, 1e-9)
        elif size <= ACCEPTED or damping > 1e3:
            break  # as closed as rounding allows, or as near as it comes
        else:
            damping *= 10
    return state


def _gap(chain: ClosedChain, state: State) -> tuple[ChainMotion, Array]:
    """Return the motion and the position residuals, lengths over the arms' reach; velocities have no part in them."""
    motion = chain_at_rest(chain, state)
    return motion, _position_gaps(motion, state)


def _position_gaps(motion: ChainMotion, state: State) -> Array:
    """Return the position residuals of all grasps, lengths over the arms' reach."""
    reach = coordinate_sizes(motion)[-1]
    parts = []
    for gap in residuals(motion, state).values():
        lengths = np.arange(len(gap.position)) >= len(gap.position) - 3
        parts.append(np.where(lengths, gap.position / reach, gap.position))
    return np.concatenate(parts) if parts else np.zeros(0)


def _position_rows(motion: ChainMotion) -> Array:
    """Return d(gap)/d(q, object): the velocity rows that are rates of position rows."""
    rows = constraint_rows(motion)
    reach = coordinate_sizes(motion)[-1]
    matrix = -rows.matrix
    keep = np.ones(len(matrix), dtype=bool)
    for c, part in zip(motion.contacts, rows.slices, strict=True):
        matrix[part.stop - 3 : part.stop] /= reach
        keep[part] = [row in c.grasp.of_kind.position_rows for row in c.rows]
    return matrix[keep]


def _inward_step(rows: Array, gap: Array, damping: float, lowest: Array, highest: Array) -> Array:
    """Return the damped Gauss-Newton step; joints at a limit that it would push beyond stay where they are.

    Args:
        rows: (rows, n + 6) of d(gap).
        gap: (rows,).
        damping: smallest singular value that counts.
        lowest: (n,) whether a joint stands at its lowest position.
        highest: the same of the highest.
    """
    n, rows = len(lowest), rows.copy()
    while True:
        U, s, Vt = np.linalg.svd(rows, full_matrices=False)
        step = -Vt.T @ (s / (s**2 + damping**2) * (U.T @ gap))
        beyond = (lowest & (step[:n] < 0)) | (highest & (step[:n] > 0))
        beyond &= rows[:, :n].any(axis=0)  # those left out already take no step but rounding's
        if not beyond.any():
            return step
        rows[:, :n][:, beyond] = 0.0


def _clipped(state: State, step: Array, low: Array, high: Array) -> State:
    """Return the state displaced by (dq, turn, shift), its joints kept within the limits."""
    there = moved(state, step)
    return replace(there, q=np.clip(there.q, low, high))


def _require_reached(chain: ClosedChain, state: State) -> None:
    motion, gap = _gap(chain, state)
    if float(np.abs(gap).max(initial=0.0)) <= ACCEPTED:
        return
    missed = {name: float(np.abs(gap.position).max(initial=0.0)) for name, gap in residuals(motion, state).items()}
    worst = max(missed.values())
    named = [
        f"arm '{name}' misses its grasp by {gap:.3g} (m or rad)"
        for name, gap in missed.items()
        if gap > WORTH_NAMING * worst
    ]
    more = f", and {len(named) - MOST_NAMED} more" if len(named) > MOST_NAMED else ""
    raise ClosureError(
        f"cannot close the chains: {', '.join(named[:MOST_NAMED])}{more}. {_tips_advice(chain, missed, worst)}"
        "Try a closer object pose, another guess for q, other base poses, or wider joint limits"
    )


def _tips_advice(chain: ClosedChain, missed: dict[str, float], worst: float) -> str:
    """Return what to say of tips that seem to point another way than their hands, those of arms that are named."""
    advice: dict[str, list[str]] = {}
    for name, gap in missed.items():
        if gap > WORTH_NAMING * worst and (told := advice_for(chain.arms[name], chain.grasps[name])):
            advice.setdefault(told, []).append(f"'{name}'")
    return "".join(f"Of {', '.join(names[:MOST_NAMED])}: {told}. " for told, names in [*advice.items()][:MOST_ADVISED])
