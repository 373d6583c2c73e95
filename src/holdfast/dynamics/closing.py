"""Solve the grasp constraints for positions (`close`) and for velocities (`project_velocity`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest, chain_motion
from holdfast.dynamics.consistency import residuals
from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE, constraint_rows, coordinate_sizes
from holdfast.dynamics.projection import Change, moved, position_contact, quickened
from holdfast.errors import ClosureError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.model.tip_direction import advice_for
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit, shaped_inputs

CLOSED_RESIDUAL = 1e-13  # rad, and lengths relative to the arms' reach: the iteration stops below this residual
ACCEPTED = 1e-10  # same units: a state with a residual below this counts as closed
MAX_ITERATIONS = 200
# Relative singular value per unit of position residual. Off the constraint manifold, dependent rows can look
# independent; singular values below this bound are checked again at a closed state.
NULL_PER_GAP = 1e3
LONGEST_NEWTON_STEP = 0.5  # largest step of one iteration: rad, or fraction of the arms' reach
WORTH_NAMING = 1e-2  # fraction of the largest residual below which an arm is not reported as unreachable
MOST_ARMS_NAMED = 4  # arms named in one message
MOST_ADVISED = 2  # hints in one message about tip frames that seem to point in the wrong direction


@np.errstate(all="ignore")  # what overflows is refused below
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

    Damped Gauss-Newton steps of least norm close the position rows (lengths in units of the arms' reach), with the
    joints kept within their limits. `project_velocity` then corrects the velocities. The cost of a step is O(l^3),
    or O(l) with `hold_object`.

    Args:
        chain: the chain.
        guess: positions and velocities to stay near.
        hold_object: keep the object's pose and twist, and those of a trunk, and move the arms only.
        hold_trunk: if False, a trunk may move even though `hold_object` is set.
        hold_base: keep the pose and twist of a floating base.
        limits: keep joints within their position limits.
        inputs: base motion, if the bases move.

    Raises:
        ClosureError: if some arms cannot reach their grasps; the message names them and their residuals.
    """
    require_fit(chain, guess)
    low, high = np.array([joint.position_limits for joint in chain.all_joints]).reshape(-1, 2).T
    if not limits:
        low, high = np.full_like(low, -np.inf), np.full_like(high, np.inf)
    # only q is changed here: even a zero rotation of the object could change the last bit of its pose
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


@np.errstate(all="ignore")  # what overflows is refused below
def project_velocity(
    chain: ClosedChain,
    state: State,
    *,
    hold_object: bool = False,
    hold_base: bool = False,
    inputs: Inputs | None = None,
) -> State:
    """Return the state with the nearest velocities that satisfy every grasp.

    The change of (qd, V(C)) has least norm, with lengths in units of the arms' reach, and makes the
    velocity rows K (A V(C) - J qd) vanish. O(n^3).

    Args:
        chain: the chain.
        state: positions that close the grasps, and velocities to stay near.
        hold_object: keep the object's twist and the velocities of a trunk, and change the arms' joint velocities only.
        hold_base: keep the twist of a floating base.
        inputs: base motion, if the bases move.

    Raises:
        StateError: a state or inputs of the wrong shape for the chain.
    """
    require_fit(chain, state)
    held = _held_columns(chain, hold_object=hold_object, hold_trunk=hold_object, hold_base=hold_base)
    return _with_velocities(chain, state, held, inputs)


def _with_velocities(chain: ClosedChain, state: State, hold: Array, inputs: Inputs | None) -> State:
    """Return `project_velocity` with some coordinates held; `hold` is a mask over the constraint's columns."""
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), shaped_inputs(chain, inputs))
    if not any(c.rows for c in motion.contacts):
        return state
    n, sizes = chain.joint_count, coordinate_sizes(motion)
    gap, rows = np.concatenate([c.velocity_gap for c in motion.contacts]), _velocity_rows(motion, hold)
    checks.finite(np.append(rows, gap), "the velocities of the grasps")
    U, s, Vt = np.linalg.svd(rows, full_matrices=False)
    rank = int((s > NULL_SINGULAR_VALUE * s[0]).sum())
    position_gap = np.abs(_position_gaps(motion, state)).max(initial=0.0)
    if rank > 0 and s[rank - 1] < NULL_PER_GAP * position_gap * s[0]:
        # Dependent rows look independent where the grasps are slightly open, and would wrongly stop the motion.
        # The rank is therefore taken at the nearest closed state.
        free = np.full(n, np.inf)
        none = np.zeros(chain.velocity_count, dtype=bool)
        closed = chain_at_rest(chain, _brought_together(chain, state, -free, free, none))
        there = np.linalg.svd(_velocity_rows(closed, hold), compute_uv=False)
        rank = min(rank, int((there > NULL_SINGULAR_VALUE * there[0]).sum()))
    step = sizes * (Vt[:rank].T @ ((U[:, :rank].T @ gap) / s[:rank]))
    return quickened(state, Change(step[:n], step[n : n + 6], step[n + 6 :] if chain.floats else None))


def _held_columns(chain: ClosedChain, *, hold_object: bool, hold_trunk: bool, hold_base: bool) -> Array:
    """Return the mask of columns of `ConstraintRows.matrix` that must not move, (n + 6,) or (n + 12,) booleans."""
    for name, flag in (("hold_object", hold_object), ("hold_trunk", hold_trunk), ("hold_base", hold_base)):
        checks.flag(flag, name, StateError)
    n, held = chain.joint_count, np.zeros(chain.velocity_count, dtype=bool)
    held[n : n + 6] = hold_object
    held[n + 6 :] = hold_base or hold_trunk
    if chain.trunk is not None:
        held[chain.joints[TRUNK]] = hold_trunk
    return held


def _velocity_rows(motion: ChainMotion, held: Array) -> Array:
    """Return K [J, -A] for unknowns in units of `coordinate_sizes`, with the columns of held coordinates zero."""
    return np.where(held, 0.0, constraint_rows(motion).matrix * coordinate_sizes(motion))


def _arms_brought(chain: ClosedChain, state: State, low: Array, high: Array) -> State:
    """Return the state with the grasps closed and the object held.

    Each arm is solved by itself, so that an arm that cannot reach does not keep the others from converging.
    """
    q, arms = np.array(state.q), chain_at_rest(chain, state).arms
    for name, grasp in chain.grasps.items():
        part = chain.joints[name]
        alone = ClosedChain({name: arms[name].arm}, chain.held_object, {name: grasp})
        start = State(q[part], state.qd[part], state.object_pose)
        held = np.arange(alone.velocity_count) >= alone.joint_count
        q[part] = _brought_together(alone, start, low[part], high[part], held).q
    return replace(state, q=q)


def _brought_together(chain: ClosedChain, state: State, low: Array, high: Array, held: Array) -> State:
    """Return the state with the grasps closed as far as possible; held coordinates do not change."""
    motion, gap = _gap(chain, state)
    damping = 1e-6
    for _ in range(MAX_ITERATIONS):
        size = float(np.abs(gap).max(initial=0.0))
        if size <= CLOSED_RESIDUAL:
            break
        sizes = coordinate_sizes(motion)
        rows = np.where(held, 0.0, _position_rows(motion) * sizes)
        step = _inward_step(rows, gap, damping, state.q <= low, state.q >= high)
        step *= min(1.0, LONGEST_NEWTON_STEP / max(float(np.abs(step).max()), 1e-300))
        trial = _clipped(state, sizes * step, low, high)
        trial_motion, trial_gap = _gap(chain, trial)
        if float(np.linalg.norm(trial_gap)) < float(np.linalg.norm(gap)):
            state, motion, gap = trial, trial_motion, trial_gap
            damping = max(damping / 10, 1e-9)
        elif size <= ACCEPTED or damping > 1e3:
            break  # rounding allows no smaller residual, or the iteration has stalled
        else:
            damping *= 10
    return state


def _gap(chain: ClosedChain, state: State) -> tuple[ChainMotion, Array]:
    """Return the chain at rest and its position residuals, with lengths divided by the arms' reach."""
    motion = chain_at_rest(chain, state)
    return motion, _position_gaps(motion, state)


def _position_gaps(motion: ChainMotion, state: State) -> Array:
    """Return the position residuals of all grasps, with lengths divided by the arms' reach."""
    reach = coordinate_sizes(motion)[-1]
    parts = []
    for gap in residuals(motion, state).values():
        lengths = np.arange(len(gap.position)) >= len(gap.position) - 3
        parts.append(np.where(lengths, gap.position / reach, gap.position))
    return np.concatenate(parts) if parts else np.zeros(0)


def _position_rows(motion: ChainMotion) -> Array:
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
    more = f", and {len(named) - MOST_ARMS_NAMED} more" if len(named) > MOST_ARMS_NAMED else ""
    raise ClosureError(
        f"cannot close the chains: {', '.join(named[:MOST_ARMS_NAMED])}{more}. {_tips_advice(chain, missed, worst)}"
        "Try a closer object pose, another guess for q, other base poses, or wider joint limits"
    )


def _tips_advice(chain: ClosedChain, missed: dict[str, float], worst: float) -> str:
    """Return hints for the reported arms whose tip frames seem to point in another direction than their hands."""
    advice: dict[str, list[str]] = {}
    for name, gap in missed.items():
        if gap > WORTH_NAMING * worst and (told := advice_for(chain.arms[name], chain.grasps[name])):
            advice.setdefault(told, []).append(f"'{name}'")
    return "".join(
        f"Of {', '.join(names[:MOST_ARMS_NAMED])}: {told}. " for told, names in [*advice.items()][:MOST_ADVISED]
    )
