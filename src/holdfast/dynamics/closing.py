"""Solve the grasp constraints for positions (`close`) and for velocities (`project_velocity`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest, chain_motion
from holdfast.dynamics.closed_positions import (
    ACCEPTED,
    arms_brought,
    brought_together,
    position_gap_at,
    position_gaps,
)
from holdfast.dynamics.consistency import residuals
from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE, constraint_rows, coordinate_sizes
from holdfast.dynamics.nearest_posture import nearest_posture
from holdfast.dynamics.posture import Posture
from holdfast.dynamics.projection import Change, quickened
from holdfast.dynamics.tree.mechanism import mechanism_close
from holdfast.errors import ClosureError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest, require_unused
from holdfast.model.tip_direction import advice_for
from holdfast.model.trunk import TRUNK
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit, shaped_inputs

# Relative singular value per unit of position residual. Off the constraint manifold, dependent rows can look
# independent; singular values below this bound are checked again at a closed state.
NULL_PER_GAP = 1e3
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
    posture: Posture | None = None,
    inputs: Inputs | None = None,
) -> State:
    """Return the consistent state nearest to a guess, or the one whose posture costs least.

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
        posture: wished joint positions with weights; the joints then move on, with the grasps closed, to where they
            cost least. None to stay near the guess.
        inputs: base motion, if the bases move.

    A chain with branches, loops, couplings or several objects is closed as its forest, in which everything may move
    that is not held; positions beyond a joint's limits are refused there.

    Raises:
        ClosureError: if some arms cannot reach their grasps; the message names them and their residuals.
    """
    if answered_as_forest(chain):
        for name, flag in (("hold_object", hold_object), ("hold_trunk", hold_trunk), ("hold_base", hold_base)):
            checks.flag(flag, name, StateError)
        given = shaped_inputs(chain, inputs)
        moves = np.any(given.base_twists) or (given.trunk_base_twist is not None and np.any(given.trunk_base_twist))
        require_unused(posture=posture is not None, inputs=bool(moves))
        held = {"hold_object": hold_object, "hold_trunk": hold_object and hold_trunk, "hold_base": hold_base}
        return mechanism_close(chain, guess, **held, limits=limits)
    require_fit(chain, guess)
    checks.instance(posture, (Posture, type(None)), "close: posture")
    low, high = chain.position_limits.T
    if not limits:
        low, high = np.full_like(low, -np.inf), np.full_like(high, np.inf)
    # only q is changed here: even a zero rotation of the object could change the last bit of its pose
    state = replace(guess, q=np.clip(guess.q, low, high))
    alone = hold_object and (hold_trunk or chain.trunk is None)
    held = _held_columns(chain, hold_object=hold_object, hold_trunk=alone, hold_base=hold_base)
    state = arms_brought(chain, state, low, high) if alone else brought_together(chain, state, low, high, held)
    _require_reached(chain, state)
    if posture is not None:
        found = nearest_posture(chain, state, posture.cost(chain, state), held, low, high)
        state = replace(state, q=found.q, object_pose=found.object_pose, base_pose=found.base_pose)
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
    position_gap = np.abs(position_gaps(motion, state)).max(initial=0.0)
    if rank > 0 and s[rank - 1] < NULL_PER_GAP * position_gap * s[0]:
        # Dependent rows look independent where the grasps are slightly open, and would wrongly stop the motion.
        # The rank is therefore taken at the nearest closed state.
        free = np.full(n, np.inf)
        none = np.zeros(chain.velocity_count, dtype=bool)
        closed = chain_at_rest(chain, brought_together(chain, state, -free, free, none))
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
    held[chain.joints.get(TRUNK, slice(0, 0))] = hold_trunk
    return held


def _velocity_rows(motion: ChainMotion, held: Array) -> Array:
    """Return K [J, -A] for unknowns in units of `coordinate_sizes`, with the columns of held coordinates zero."""
    return np.where(held, 0.0, constraint_rows(motion).matrix * coordinate_sizes(motion))


def _require_reached(chain: ClosedChain, state: State) -> None:
    motion, gap = position_gap_at(chain, state)
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
