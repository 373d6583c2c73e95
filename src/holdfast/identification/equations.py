"""The equations that identification solves: rows that are linear in products of what is unknown.

With gravity known, features are [pi; b; 1], else [pi; g_x pi; g_y pi; g_z pi; b; 1; g]:

    rows @ features(x) = -maps @ noise,    x = [pi; b; tilt]

pi are the object's ten parameters about the mass centre that the model has, object axes, so that rows are well
conditioned; b offsets of the wrist sensors; tilt turns gravity. From wrists six rows a sample, about C,

    Y_C pi + sum X_i b_i - (sum X_i m_i + w) = -sum X_i noise_i,     X_i from the tip of arm i to C

and from torques as many as the chain has freedoms: N spans its motions, and no grasp force does work along them,

    N_C^T (Y_C pi - w) + N_q^T (M qdd + C + damping qd + ... - tau) = -N_q^T noise

and with a floating base also N_b^T times the wrench that its motion would need of a drive.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed.spring_wrenches import with_springs
from holdfast.dynamics.constraint import constraint_rows
from holdfast.dynamics.inverse import torques
from holdfast.dynamics.regressor import UNIT_BODIES, object_columns
from holdfast.dynamics.trunk.trunk_inverse import trunk_torques
from holdfast.identification.recording import Recording
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate, shift_wrench
from holdfast.state import Inputs, State


@dataclass(frozen=True)
class Settings:
    """What is to be found besides the payload.

    Attributes:
        source: "wrist_wrench" or "tau".
        sensor_bias: whether wrist sensors have offsets.
        gravity: whether gravity's direction is unknown.
    """

    source: str
    sensor_bias: bool
    gravity: bool


@dataclass(frozen=True, eq=False)
class Equations:
    """The rows of all samples.

    Attributes:
        rows: (samples, r, features).
        maps: (samples, r, channels) of the channels' noise to the rows.
        measured: (samples, channels) [N m, N].
        left_out: samples at singular configurations, which have other freedoms.
    """

    rows: Array
    maps: Array
    measured: Array
    left_out: int = 0


def equations(chain: ClosedChain, recordings: list[Recording], settings: Settings) -> Equations:
    """Return the rows of complete recordings. O(samples n), from torques O(samples n^3)."""
    of_sample = wrist_rows if settings.source == "wrist_wrench" else torque_rows
    found = [of_sample(chain, recording, k, settings) for recording in recordings for k in range(len(recording))]
    usual = Counter(len(rows) for rows, _, _ in found).most_common(1)[0][0]
    kept = [one for one in found if len(one[0]) == usual]
    rows, maps, measured = (np.array(part) for part in zip(*kept, strict=True))
    return Equations(rows, maps, measured, len(found) - len(kept))


def wrist_rows(chain: ClosedChain, recording: Recording, k: int, settings: Settings) -> tuple[Array, Array, Array]:
    """Return rows, maps and what was measured of a sample, from wrists."""
    assert recording.wrist_wrench is not None
    state, alpha, inputs = _sample(chain, recording, k)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    known = with_springs(chain, state, inputs).object_wrench
    assert known is not None
    places = [chain.names.index(name) for name in chain.grasps]
    measured = recording.wrist_wrench[k][places]
    X = np.hstack([
        np.array([shift_wrench(c.offset, rotate(arm.at.tip.R, unit)) for unit in np.eye(6)]).T
        for c, arm in zip(motion.contacts, motion.holding, strict=True)
    ])  # fmt: skip
    right = known + X @ measured.ravel()
    bias = X if settings.sensor_bias else np.zeros((6, 0))
    columns = _object_columns(chain, state, alpha, settings)
    last = [-right[:, None]] + ([np.zeros((6, 3))] if settings.gravity else [])
    return np.hstack([*columns, bias, *last]), X, measured.ravel()


def torque_rows(chain: ClosedChain, recording: Recording, k: int, settings: Settings) -> tuple[Array, Array, Array]:
    """Return rows, maps and what was measured of a sample, from joint torques."""
    assert recording.tau is not None and recording.qdd is not None
    state, alpha, inputs = _sample(chain, recording, k)
    qdd, tau, n = recording.qdd[k], recording.tau[k], chain.joint_count

    def moved(gravity: Array) -> ChainMotion:
        return chain_motion(replace(chain, gravity=gravity), state, np.zeros(n), inputs)

    base = None if recording.base_acceleration is None else recording.base_acceleration[k]

    def needed(motion: ChainMotion) -> Array:
        """Return what trunk and arms alone ask for: torques, and with a floating base its wrench."""
        none = np.zeros((len(chain.arms), 6))
        if motion.trunk is None:
            return torques(motion, qdd, none)
        found = trunk_torques(motion, qdd, none, base)
        return found.tau if base is None else np.concatenate([found.tau, found.base])

    motion = moved(np.zeros(3) if settings.gravity else chain.gravity)
    assert motion.object_case is not None
    N = constraint_rows(motion).motions
    joints, free = N[:n].T, N[n : n + 6].T
    moving = np.vstack([N[:n], N[n + 6 :]]).T  # of joints and floating base
    here = needed(motion)
    last = [(moving @ here - joints @ tau - free @ motion.object_case.wrench)[:, None]]
    if settings.gravity:
        last += [np.array([moving @ (needed(moved(axis)) - here) for axis in np.eye(3)]).T]
    columns = [free @ part for part in _object_columns(chain, state, alpha, settings)]
    return np.hstack([*columns, *last]), joints, tau


def _sample(chain: ClosedChain, recording: Recording, k: int) -> tuple[State, Array, Inputs]:
    """Return the state, the object's acceleration and shaped inputs of a sample."""
    assert recording.object_acceleration is not None
    return recording.state(k), recording.object_acceleration[k], (recording.inputs or Inputs()).shaped(chain)


def about_mass_centre(chain: ClosedChain) -> Array:
    """Return (10, 10): parameters about C of those about the mass centre that the model has."""
    return np.array([body.moved(np.eye(3), chain.held_object.com).parameters for body in UNIT_BODIES]).T


def _object_columns(chain: ClosedChain, state: State, alpha: Array, settings: Settings) -> list[Array]:
    """Return the columns that multiply pi, and g_x pi .. g_z pi where gravity is unknown."""
    frame, twist, to_C = state.object_frame, state.object_twist, about_mass_centre(chain)

    def columns(gravity: Array) -> Array:
        return object_columns(frame, twist, alpha - np.concatenate([np.zeros(3), gravity])) @ to_C

    if not settings.gravity:
        return [columns(chain.gravity)]
    without = columns(np.zeros(3))
    return [without, *(columns(axis) - without for axis in np.eye(3))]
