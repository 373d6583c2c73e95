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

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_motion, pseudo_gravity
from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.regressor import inertial_parameters, object_columns
from holdfast.identification.machine.instants import Instants, instants
from holdfast.identification.machine.unknowns import ON_JOINTS, MachineUnknowns
from holdfast.identification.recording import Recording
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.joint_friction import friction_torque
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate, shift_wrench
from holdfast.state import Inputs


@dataclass(frozen=True, eq=False)
class MachineRows:
    """The equations of all samples of all recordings.

    Attributes:
        A: (samples, r, p) coefficients of the linear unknowns.
        b: (samples, r) what is known.
        N: (samples, r, freedoms) the motions along which the rows are, of joints and object; with wrists, axes at C.
        P: (samples, r, channels), the joints' columns of N; with wrists, from their wrenches to C.
        y: (samples, channels) measurements.
        used: (samples, channels) which of these count.
        t: (samples,) times.
        parts: the samples of each recording.
        kept: by recording, which of its samples these are; the others are left out, as their configuration is singular.
    """

    A: Array
    b: Array
    N: Array
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
    found = [equations_at(chain, one, unknowns) for one in recordings]
    values, often = np.unique(np.concatenate([ranks for *_, ranks in found]), return_counts=True)
    usual = int(values[np.argmax(often)])
    kept = [ranks == usual for *_, ranks in found]
    A, b, N, P = (
        np.concatenate([one[i][keep, :usual] for one, keep in zip(found, kept, strict=True)]) for i in range(4)
    )
    y = np.concatenate([channels(chain, one, unknowns.by)[ks] for one, ks in zip(recordings, kept, strict=True)])
    used = np.ones(y.shape, bool)
    if unknowns.by in ("tau", "current"):
        flags = [np.ones(one.q.shape) if one.used is None else one.used for one in recordings]
        used = np.concatenate([flag[ks] > 0.0 for flag, ks in zip(flags, kept, strict=True)])
    t = np.concatenate([one.t[ks] for one, ks in zip(recordings, kept, strict=True)])
    ends = np.cumsum([0, *(int(one.sum()) for one in kept)]).tolist()
    parts = [slice(*ends) for ends in pairwise(ends) if ends[1] > ends[0]]
    return MachineRows(A, b, N, P, y, used, t, parts, kept)


def equations_at(chain: ClosedChain, recording: Recording, unknowns: MachineUnknowns) -> tuple[Array, ...]:
    """Return A, b, N and P of all samples of a completed recording, and their numbers of rows; rows below are 0."""
    if unknowns.by not in ("tau", "current"):
        found = [wrist_rows(chain, recording, k, unknowns) for k in range(len(recording))]
        A, b, P = (np.array(one) for one in zip(*found, strict=True))
        count, r = b.shape
        return A, b, np.broadcast_to(np.eye(r), (count, r, r)), P, np.full(count, r)
    pieces = [torque_rows(one, unknowns) for one in instants(chain, recording)]
    most = max(b.shape[1] for _, b, *_ in pieces)
    A, b, N, P = (np.concatenate([_below(one[i], most) for one in pieces]) for i in range(4))
    return A, b, N, P, np.concatenate([ranks for *_, ranks in pieces])


def _below(x: Array, rows: int) -> Array:
    """Return arrays (samples, r, ...) with rows of zeros below, (samples, rows, ...)."""
    return np.concatenate([x, np.zeros((len(x), rows - x.shape[1], *x.shape[2:]))], axis=1)


def forces_without_friction(
    chain: ClosedChain, recordings: Sequence[Recording], unknowns: MachineUnknowns, gain: Array
) -> list[Array]:
    """Return (samples, freedoms, features), rows [A, b - P gain y] without dry friction as forces along all freedoms.

    Args:
        chain: the chain.
        recordings: completed recordings with the same inputs, of which an array is returned for each.
        unknowns: the unknowns.
        gain: (channels,) factors of the measurements.
    """
    if unknowns.by not in ("tau", "current"):
        return [_as_forces(chain, one, unknowns, gain) for one in recordings]
    ends = np.cumsum([len(one) for one in recordings])
    return np.split(_as_forces(chain, _joined(recordings), unknowns, gain), ends[:-1])


def _as_forces(chain: ClosedChain, recording: Recording, unknowns: MachineUnknowns, gain: Array) -> Array:
    """Return the forces of one recording; see `forces_without_friction`."""
    A, b, N, P, _ = equations_at(chain, recording, unknowns)
    rubs = unknowns.where("friction")
    if unknowns.by in ("tau", "current") and not len(rubs):
        assert recording.qd is not None
        b = b - np.einsum("src,sc->sr", P, friction_torque(unknowns.model_joints["friction"], recording.qd.T).T)
    A[:, :, rubs] = 0.0
    left = b - np.einsum("src,sc->sr", P, gain * channels(chain, recording, unknowns.by))
    return np.swapaxes(N, 1, 2) @ np.concatenate([A, left[:, :, None]], axis=2)


def _joined(recordings: Sequence[Recording]) -> Recording:
    """Return all samples of recordings in one, whose times mean nothing, so that machine code runs them together."""
    first = recordings[0]
    names = [field.name for field in fields(Recording) if isinstance(getattr(first, field.name), np.ndarray)]
    arrays = {name: np.concatenate([getattr(one, name) for one in recordings]) for name in names}
    return replace(first, **(arrays | {"t": np.arange(float(len(arrays["t"])))}))


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


def torque_rows(at: Instants, unknowns: MachineUnknowns) -> tuple[Array, ...]:
    """Return A, b, N and P of samples by what drives do, and their numbers of rows, below which rows are 0."""
    n, qd, qdd = at.qd.shape[1], at.qd, at.qdd
    N, ranks = at.motions()
    joints, free = N[:, :, :n], N[:, :, n:]
    fixed = [i for i in range(at.links.shape[2]) if i not in unknowns.links]
    known = at.drives + np.einsum("srkp,kp->sr", at.links[:, :, fixed], unknowns.link_parameters[fixed])
    s = friction_torque(np.ones(n), qd.T).T
    by_kind = {
        "armature": qdd,
        "damping": qd,
        "friction": s,
        "friction_offset": np.ones(qd.shape),
        "friction_asymmetry": s * s,
    }
    model = unknowns.model_joints
    known += model["friction"] * s
    columns = []
    for kind in unknowns.kinds:
        if kind in ON_JOINTS:
            known -= model[kind] * by_kind[kind]
            columns.append(joints * by_kind[kind][:, None, :])
    weights = free @ at.object
    of_links = joints @ at.links[:, :, unknowns.links].reshape(*known.shape, 10 * len(unknowns.links))
    A = [*([weights] if "payload" in unknowns.kinds else []), of_links, *columns]
    b = np.einsum("srj,sj->sr", joints, known) - np.einsum("sri,si->sr", free, at.object_wrench)
    if "payload" not in unknowns.kinds:
        b = b + weights @ at.held
    if at.added is not None:
        b = b + weights @ at.added
    return np.concatenate(A, axis=2), b, N, joints, ranks


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
