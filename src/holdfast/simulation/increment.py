"""The increment of the state in a Runge-Kutta step: (dq, dqd; u, dp, dV of each free body; work).

The free bodies are the object and, after it, a floating base. The rotation vector u gives the attitude R = exp(u) R_0
relative to the attitude R_0 at the start of the step (`runge_kutta`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from holdfast.dynamics.projection import turned_and_shifted
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.runge_kutta import rotation_vector_rate
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, concatenate
from holdfast.state import State

OF_BODY = 12  # entries for each free body
OF_WORK = 4


def increment_size(chain: ClosedChain) -> int:
    """Return the number of entries of a chain's increment."""
    return 2 * chain.joint_count + OF_BODY * (2 if chain.floats else 1) + OF_WORK


def body_parts(state: State) -> list[slice]:
    """Return the slice of an increment that holds u, dp and dV of each free body."""
    first = 2 * len(state.q)
    return [slice(first + OF_BODY * i, first + OF_BODY * (i + 1)) for i, _ in enumerate(twists(state))]


def twists(state: State) -> list[Array]:
    """Return the twists of the free bodies: of the object, and of a floating base."""
    return [state.object_twist, *([] if state.base_twist is None else [state.base_twist])]


def velocities_of(state: State) -> Array:
    """Return the joint rates and the twists of the free bodies, (n + 6,); a floating base adds six entries."""
    return concatenate([state.qd, *twists(state)])


def accelerations_of(state: State, slope: Array) -> Array:
    """Return the time derivatives of `velocities_of` in the rate of an increment."""
    n = len(state.q)
    return concatenate([slope[n : 2 * n], *(slope[part][6:] for part in body_parts(state))])


def work_of(y: Array) -> Array:
    """Return the work in an increment, (4,) [J]."""
    return y[len(y) - OF_WORK :]


def turns_of(state: State, y: Array) -> list[Array]:
    """Return the rotation vectors of the free bodies relative to the step's start, (3,) each [rad]."""
    return [y[part][:3] for part in body_parts(state)]


def no_turns(state: State) -> list[Array]:
    """Return the rotation vectors at the step's start, which are zero."""
    return [np.zeros(3) for _ in twists(state)]


def turns_between(before: State, after: State) -> list[Array]:
    """Return the rotation vectors of the free bodies from one state to another, (3,) each [rad]."""
    frames = zip(_attitudes(before), _attitudes(after), strict=True)
    return [rotation.log(there @ here.T) for here, there in frames]


def increment_rate(state: State, found: Any, power: Array, turns: Sequence[Array]) -> Array:
    """Return the time derivative of an increment, (2 n + 12 bodies + 4,).

    Args:
        state: positions and velocities.
        found: result of forward dynamics, with the accelerations `qdd` (n,), `object_acceleration` (6,) of C, and
            `base_acceleration` (6,) of a floating base or None without one.
        power: (4,) in the order of `balance.WORK_TERMS` [W].
        turns: rotation vectors of the free bodies relative to the step's start.
    """
    moving = [a for a in (found.object_acceleration, found.base_acceleration) if a is not None]
    bodies = [
        part
        for u, V, a in zip(turns, twists(state), moving, strict=True)
        for part in (rotation_vector_rate(u, V[:3]), V[3:], a)
    ]
    return concatenate([state.qd, found.qdd, *bodies, power])


def moving_at(state: State, z: Array, slope: Array, turns: Sequence[Array]) -> Array:
    """Return a slope with the rates of the positions replaced by the velocities of state + z.

    Args:
        state: the state.
        z: an increment; only its velocities are used.
        slope: time derivative of an increment; its accelerations and power are kept.
        turns: rotation vectors of the free bodies at which the slope was evaluated.
    """
    n = len(state.q)
    parts = [state.qd + z[n : 2 * n], slope[n : 2 * n]]
    for part, u, twist in zip(body_parts(state), turns, twists(state), strict=True):
        V = twist + z[part][6:]
        parts += [rotation_vector_rate(u, V[:3]), V[3:], slope[part][6:]]
    return concatenate([*parts, work_of(slope)])


def displaced(state: State, y: Array) -> State:
    """Return the state displaced by an increment."""
    n, bodies = len(state.q), []
    poses = [pose for pose in (state.object_pose, state.base_pose) if pose is not None]
    for part, pose, twist in zip(body_parts(state), poses, twists(state), strict=True):
        bodies += [turned_and_shifted(pose, y[part][:6]), twist + y[part][6:]]
    return State(state.q + y[:n], state.qd + y[n : 2 * n], *bodies)


def _attitudes(state: State) -> list[Array]:
    base = state.base_frame
    return [state.object_frame.R, *([] if base is None else [base.R])]
