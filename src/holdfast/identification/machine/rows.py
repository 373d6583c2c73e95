"""The equations of a machine in every sample, which are linear in bodies, drives and friction.

    A x + b - P (gain * y) = -P (gain * noise)

y are the measurements of the channels: torques or currents of the joints, or wrenches or forces of the wrists. x are
the ten inertial parameters of each unknown body (the object's about C), then the unknowns of the joints or sensors. b
is what the model is certain of. As in `equations`, P = N_q^T with a basis N of the chain's motions, along which grasp
forces do no work; arms that hold nothing have one row for each joint. With wrists, P takes their wrenches to C.

Joints have the torque  armature qdd + damping qd + friction s + offset + asymmetry s^2  beside that of the bodies, with
s = qd / sqrt(qd^2 + 0.05^2), as in simulations.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_motion, pseudo_gravity
from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.constraint import constraint_rows
from holdfast.dynamics.regressor import Regressor, inertial_parameters, object_columns, regressor
from holdfast.identification.machine.unknowns import ON_JOINTS, MachineUnknowns
from holdfast.identification.recording import Recording
from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.simulation.joint_friction import friction_torque
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate, shift_wrench
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class MachineRows:
    """The equations of all samples of all recordings.

    Attributes:
        A: (samples, r, p) coefficients of the linear unknowns.
        b: (samples, r) what is known.
        P: (samples, r, channels).
        y: (samples, channels) measurements.
        used: (samples, channels) which of these count.
        t: (samples,) times.
        parts: the samples of each recording.
        kept: by recording, which of its samples these are; the others are left out, as their configuration is singular.
    """

    A: Array
    b: Array
    P: Array
    y: Array
    used: Array
    t: Array
    parts: list[slice]
    kept: list[Array]

    @property
    def left_out(self) -> int:
        """The number of samples that are left out."""
        return sum(int((~one).sum()) for one in self.kept)


def machine_rows(chain: ClosedChain, recordings: list[Recording], unknowns: MachineUnknowns) -> MachineRows:
    """Return the equations of completed recordings. O(samples n^3)."""
    of_sample = torque_rows if unknowns.by in ("tau", "current") else wrist_rows
    found = [[of_sample(chain, one, k, unknowns) for k in range(len(one))] for one in recordings]
    counts = [len(b) for part in found for _, b, _ in part]
    usual = max(set(counts), key=counts.count)
    kept = [np.array([len(b) == usual for _, b, _ in part]) for part in found]
    keep = [np.flatnonzero(one).tolist() for one in kept]
    A, b, P = (np.array([part[k][i] for part, ks in zip(found, keep, strict=True) for k in ks]) for i in range(3))
    y = np.concatenate([channels(chain, one, unknowns.by)[ks] for one, ks in zip(recordings, keep, strict=True)])
    used = np.ones(y.shape, bool)
    if unknowns.by in ("tau", "current"):
        flags = [np.ones(one.q.shape) if one.used is None else one.used for one in recordings]
        used = np.concatenate([flag[ks] > 0.0 for flag, ks in zip(flags, keep, strict=True)])
    t = np.concatenate([one.t[ks] for one, ks in zip(recordings, keep, strict=True)])
    ends = np.cumsum([0, *map(len, keep)]).tolist()
    parts = [slice(*ends) for ends in pairwise(ends) if ends[1] > ends[0]]
    return MachineRows(A, b, P, y, used, t, parts, kept)


def errors_without_friction(chain: ClosedChain, recording: Recording, unknowns: MachineUnknowns, gain: Array) -> Array:
    """Return (samples, channels, features), rows [A, b - P gain y] without dry friction in place of measurements."""
    of_sample = torque_rows if unknowns.by in ("tau", "current") else wrist_rows
    measured, model, found = gain * channels(chain, recording, unknowns.by), unknowns.model_joints["friction"], []
    rubs = unknowns.where("friction")
    for k in range(len(recording)):
        A, b, P = of_sample(chain, recording, k, unknowns)
        if unknowns.by in ("tau", "current") and not len(rubs):
            assert recording.qd is not None
            b = b - P @ friction_torque(model, recording.qd[k])
        A[:, rubs] = 0.0
        found.append(np.linalg.pinv(P) @ np.column_stack([A, b - P @ measured[k]]))
    return np.array(found)


def friction_of_features(unknowns: MachineUnknowns, n: int) -> Array:
    """Return (n, features) by which the features [x, 1] give the sizes of the joints' dry friction."""
    found = np.zeros((n, unknowns.linear + 1))
    if unknowns.by not in ("tau", "current"):
        return found
    rubs = unknowns.where("friction")
    if len(rubs):
        found[np.arange(n), rubs] = 1.0
    else:
        found[:, -1] = unknowns.model_joints["friction"]
    return found


def channels(chain: ClosedChain, recording: Recording, by: str) -> Array:
    """Return the measurements of a recording, (samples, channels)."""
    measured = getattr(recording, by)
    if by in ("tau", "current"):
        return measured
    return measured[:, [chain.names.index(name) for name in chain.grasps]].reshape(len(recording), -1)


def torque_rows(
    chain: ClosedChain, recording: Recording, k: int, unknowns: MachineUnknowns
) -> tuple[Array, Array, Array]:
    """Return A, b and P of a sample, from what the joints' drives do."""
    assert recording.qd is not None and recording.qdd is not None
    n, qd, qdd = chain.joint_count, recording.qd[k], recording.qdd[k]
    inputs = (recording.inputs or Inputs()).shaped(chain)
    held = bool(chain.grasps)
    state, alpha = recording.on_base(k, State(recording.q[k], qd, np.r_[1.0, np.zeros(6)])), np.zeros(6)
    if held:
        assert recording.object_acceleration is not None
        state, alpha = recording.state(k), recording.object_acceleration[k]
    base = None if recording.base_acceleration is None else recording.base_acceleration[k]
    Y = regressor(chain, state, qdd, alpha, inputs=inputs, base_acceleration=base)
    joints, free, of_base = np.eye(n + len(_base_rows(chain))), np.zeros((n + len(_base_rows(chain)), 6)), None
    if held:
        N = constraint_rows(chain_motion(chain, state, np.zeros(n), inputs)).motions
        joints, free, of_base = N[:n].T, N[n : n + 6].T, N[n + 6 :].T
        joints = np.hstack([joints, of_base])
    bodies = link_columns(chain, Y)  # (n + base rows, bodies, 10)
    known = np.concatenate([Y.drives, Y.base_wrench[: len(_base_rows(chain))]])
    fixed = [i for i in range(bodies.shape[1]) if i not in unknowns.links]
    known = known + np.einsum("rkp,kp->r", bodies[:, fixed], unknowns.link_parameters[fixed])
    s = friction_torque(np.ones(n), qd)
    by_kind = {
        "armature": qdd,
        "damping": qd,
        "friction": s,
        "friction_offset": np.ones(n),
        "friction_asymmetry": s * s,
    }
    model = unknowns.model_joints
    known[:n] += model["friction"] * s
    columns = []
    for kind in unknowns.kinds:
        if kind in ON_JOINTS:
            known[:n] -= model[kind] * by_kind[kind]
            columns.append(joints[:, :n] * by_kind[kind])
    A = [joints @ bodies[:, unknowns.links].reshape(len(bodies), -1), *columns]
    b = joints @ known - free @ Y.object_wrench
    weights = free @ Y.object
    if "payload" in unknowns.kinds:
        A = [weights, *A]
    elif held:
        b = b + weights @ inertial_parameters(chain.held_object)
    if recording.added is not None:
        b = b + weights @ inertial_parameters(recording.added)
    return np.hstack(A), b, joints[:, :n]


def _base_rows(chain: ClosedChain) -> range:
    """Return the rows of the wrench on a floating base."""
    return range(6 if chain.floats else 0)


def link_columns(chain: ClosedChain, Y: Regressor) -> Array:
    """Return the torques, and the wrench on a floating base, per parameters of trunk and links, (rows, bodies, 10)."""
    n, found = chain.joint_count, []
    for name in ((TRUNK,) if TRUNK in Y.links else ()) + chain.names:
        own = Y.links[name]
        part = np.zeros((n + len(_base_rows(chain)), own.shape[1], 10))
        part[chain.joints[name]] = own
        if name in Y.under:
            part[chain.joints[TRUNK]] = Y.under[name]
        if name in Y.base:
            part[n:] = Y.base[name]
        found.append(part)
    return np.concatenate(found, axis=1)


def wrist_rows(
    chain: ClosedChain, recording: Recording, k: int, unknowns: MachineUnknowns
) -> tuple[Array, Array, Array]:
    """Return A, b and P of a sample, from wrenches or forces at the wrists; forces alone have rows of forces only."""
    assert recording.object_acceleration is not None
    state, inputs = recording.state(k), (recording.inputs or Inputs()).shaped(chain)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    known = with_force_elements(chain, state, inputs).object_wrench
    assert known is not None
    axes = np.eye(6) if unknowns.by == "wrist_wrench" else np.eye(6)[3:]
    rows = slice(0 if unknowns.by == "wrist_wrench" else 3, 6)
    X = np.hstack([
        np.array([shift_wrench(c.offset, rotate(arm.at.tip.R, unit)) for unit in axes]).T
        for c, arm in zip(motion.contacts, motion.holding, strict=True)
    ])[rows]  # fmt: skip
    alpha = recording.object_acceleration[k] - pseudo_gravity(chain)
    weights = object_columns(state.object_frame, state.object_twist, alpha)[rows]
    A, b = [], -known[rows]
    if "payload" in unknowns.kinds:
        A.append(weights)
    else:
        b = b + weights @ inertial_parameters(chain.held_object)
    if recording.added is not None:
        b = b + weights @ inertial_parameters(recording.added)
    since = float(recording.t[k] - recording.t[0])
    A += [
        X * (since if kind == "sensor_drift" else 1.0)
        for kind in unknowns.kinds
        if kind in ("sensor_offset", "sensor_drift")
    ]
    return np.hstack(A) if A else np.zeros((len(b), 0)), b, X
