"""The equations of the identification, which are linear in features: the unknowns and some of their products.

With known gravity the features are [pi; b; 1], otherwise [pi; g_x pi; g_y pi; g_z pi; b; 1; g]:

    rows @ features(x) = -maps @ noise,    x = [pi; b; tilt]

Here pi are the object's ten inertial parameters about the model's mass centre, object axes, so that the rows are well
conditioned; b are the offsets of the wrist sensors; tilt rotates gravity. Wrist wrenches give six rows per sample,
about C,

    Y_C pi + sum X_i b_i - (sum X_i m_i + w) = -sum X_i noise_i,     X_i from the tip of arm i to C

and torques give as many rows as the chain has degrees of freedom. With N, a basis of the chain's motions, along which
grasp forces do no work, these are

    N_C^T (Y_C pi - w) + N_q^T (M qdd + C + damping qd + friction + ... - tau) = -N_q^T noise

With a floating base, N_b^T times the wrench that would be needed to drive the base is added on the left.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.constraint import constraint_rows
from holdfast.dynamics.inverse import torques
from holdfast.dynamics.regressor import UNIT_BODIES, object_columns
from holdfast.dynamics.trunk.trunk_inverse import trunk_torques
from holdfast.identification.recording import Recording
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.joint_friction import friction_torque, joint_friction
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
        rows: (samples, r, features) coefficients of the features.
        maps: (samples, r, channels) from the noise of the channels to the rows.
        measured: (samples, channels) measurements [N m, N].
        kept: by recording, which samples these are. Others are left out because their configuration is singular, so
            that the number of degrees of freedom differs.
    """

    rows: Array
    maps: Array
    measured: Array
    kept: list[Array]

    @property
    def left_out(self) -> int:
        """The number of samples that are left out."""
        return sum(int((~one).sum()) for one in self.kept)


def equations(chain: ClosedChain, recordings: list[Recording], settings: Settings) -> Equations:
    """Return the equations of completed recordings. O(samples n), with torques O(samples n^3)."""
    found = [rows_of_samples(chain, recording, settings) for recording in recordings]
    usual = Counter(len(one[0]) for part in found for one in part).most_common(1)[0][0]
    kept = [np.array([len(one[0]) == usual for one in part]) for part in found]
    used = [one for part in found for one in part if len(one[0]) == usual]
    rows, maps, measured = (np.array(part) for part in zip(*used, strict=True))
    return Equations(rows, maps, measured, kept)


def rows_of_samples(chain: ClosedChain, recording: Recording, settings: Settings) -> list[tuple[Array, Array, Array]]:
    """Return rows, maps and measurements of each sample."""
    of_sample = wrist_rows if settings.source == "wrist_wrench" else torque_rows
    return [of_sample(chain, recording, k, settings) for k in range(len(recording))]


def wrist_rows(chain: ClosedChain, recording: Recording, k: int, settings: Settings) -> tuple[Array, Array, Array]:
    """Return rows, maps and measurements of a sample, from wrist wrenches."""
    assert recording.wrist_wrench is not None
    state, alpha, inputs = _sample(chain, recording, k)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    known = with_force_elements(chain, state, inputs).object_wrench
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
    """Return the rows of the equations that joint torques give at a sample, their maps and their measurements."""
    assert recording.tau is not None and recording.qd is not None and recording.qdd is not None
    state, alpha, inputs = _sample(chain, recording, k)
    qdd, tau, n = recording.qdd[k], recording.tau[k], chain.joint_count

    def moved(gravity: Array) -> ChainMotion:
        return chain_motion(replace(chain, gravity=gravity), state, np.zeros(n), inputs)

    base = None if recording.base_acceleration is None else recording.base_acceleration[k]

    def needed(motion: ChainMotion) -> Array:
        """Return the torques, and with a floating base the wrench, that trunk and arms need without the object."""
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
    tau = tau - friction_torque(joint_friction(chain), recording.qd[k])
    last = [(moving @ here - joints @ tau - free @ motion.object_case.wrench)[:, None]]
    if settings.gravity:
        last += [np.array([moving @ (needed(moved(axis)) - here) for axis in np.eye(3)]).T]
    columns = [free @ part for part in _object_columns(chain, state, alpha, settings)]
    return np.hstack([*columns, *last]), joints, recording.tau[k]


def _sample(chain: ClosedChain, recording: Recording, k: int) -> tuple[State, Array, Inputs]:
    """Return the state, the object's acceleration, and the inputs of a sample."""
    assert recording.object_acceleration is not None
    return recording.state(k), recording.object_acceleration[k], (recording.inputs or Inputs()).shaped(chain)


def about_mass_centre(chain: ClosedChain) -> Array:
    """Return (10, 10), which maps parameters about the model's mass centre to parameters about C."""
    return np.array([body.moved(np.eye(3), chain.held_object.com).parameters for body in UNIT_BODIES]).T


def _object_columns(chain: ClosedChain, state: State, alpha: Array, settings: Settings) -> list[Array]:
    """Return the columns that multiply pi and, if gravity is unknown, g_x pi .. g_z pi."""
    frame, twist, to_C = state.object_frame, state.object_twist, about_mass_centre(chain)

    def columns(gravity: Array) -> Array:
        return object_columns(frame, twist, alpha - np.concatenate([np.zeros(3), gravity])) @ to_C

    if not settings.gravity:
        return [columns(chain.gravity)]
    without = columns(np.zeros(3))
    return [without, *(columns(axis) - without for axis in np.eye(3))]
