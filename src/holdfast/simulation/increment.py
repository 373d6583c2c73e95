"""What a Runge-Kutta step adds up, (dq, dqd; turn, dp, dV of each free body; work): the object, then a floating base.

An attitude is written R = exp(u) R_0 about the attitude R_0 at the step's start (`runge_kutta`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.dynamics.projection import turned_and_shifted
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.runge_kutta import rotation_vector_rate
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, concatenate
from holdfast.state import State

OF_BODY = 12  # entries of a free body
OF_WORK = 4


def increment_size(chain: ClosedChain) -> int:
    """Return how many entries an increment of a chain has."""
    return 2 * chain.joint_count + OF_BODY * (2 if chain.floats else 1) + OF_WORK


def body_parts(state: State) -> list[slice]:
    """Return where each free body's turn, dp and dV lie."""
    first = 2 * len(state.q)
    return [slice(first + OF_BODY * i, first + OF_BODY * (i + 1)) for i, _ in enumerate(twists(state))]


def twists(state: State) -> list[Array]:
    """Return the twists of the bodies that no joint moves: the object's, and a floating base's."""
    return [state.object_twist, *([] if state.base_twist is None else [state.base_twist])]


def work_of(y: Array) -> Array:
    """Return the part of an increment that is work, (4,)."""
    return y[len(y) - OF_WORK :]


def turns_of(state: State, y: Array) -> list[Array]:
    """Return the rotation vectors of the free bodies since the step's start, (3,) each [rad]."""
    return [y[part][:3] for part in body_parts(state)]


def no_turns(state: State) -> list[Array]:
    """Return those at the step's start."""
    return [np.zeros(3) for _ in twists(state)]


def turns_between(before: State, after: State) -> list[Array]:
    """Return those that lead from one state to another."""
    frames = zip(_attitudes(before), _attitudes(after), strict=True)
    return [rotation.log(there @ here.T) for here, there in frames]


def increment_rate(
    state: State, qdd: Array, accelerations: Sequence[Array | None], power: Array, turns: Sequence[Array]
) -> Array:
    """Return d/dt of an increment, (2 n + 12 bodies + 4,).

    Args:
        state: positions and velocities.
        qdd: (n,) joint accelerations.
        accelerations: (6,) of C, and of a floating base; None without one.
        power: (4,) [W].
        turns: of the free bodies since the step's start.
    """
    moving = [a for a in accelerations if a is not None]
    bodies = [
        part
        for u, V, a in zip(turns, twists(state), moving, strict=True)
        for part in (rotation_vector_rate(u, V[:3]), V[3:], a)
    ]
    return concatenate([state.qd, qdd, *bodies, power])


def moving_at(state: State, z: Array, slope: Array, turns: Sequence[Array]) -> Array:
    """Return a slope whose positions change by other velocities: those of a state, moved by an increment.

    Args:
        state: the state.
        z: an increment, of which the velocities enter.
        slope: d/dt of an increment.
        turns: of the free bodies where the slope was found.
    """
    n = len(state.q)
    parts = [state.qd + z[n : 2 * n], slope[n : 2 * n]]
    for part, u, twist in zip(body_parts(state), turns, twists(state), strict=True):
        V = twist + z[part][6:]
        parts += [rotation_vector_rate(u, V[:3]), V[3:], slope[part][6:]]
    return concatenate([*parts, work_of(slope)])


def displaced(state: State, y: Array) -> State:
    """Return the state moved by an increment."""
    n, bodies = len(state.q), []
    poses = [pose for pose in (state.object_pose, state.base_pose) if pose is not None]
    for part, pose, twist in zip(body_parts(state), poses, twists(state), strict=True):
        bodies += [turned_and_shifted(pose, y[part][:6]), twist + y[part][6:]]
    return State(state.q + y[:n], state.qd + y[n : 2 * n], *bodies)


def _attitudes(state: State) -> list[Array]:
    base = state.base_frame
    return [state.object_frame.R, *([] if base is None else [base.R])]
