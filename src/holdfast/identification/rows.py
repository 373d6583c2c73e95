"""The equations of a machine in every sample, which are linear in bodies, drives and friction.

    A x + b - P (gain * y) = -P (gain * noise)

y are the measurements of the channels: torques or currents of the joints, or wrenches or forces of the wrists. x are
the ten inertial parameters of each unknown body (the object's about C), then the unknowns of the joints or sensors. b
is what the model is certain of. With N, a basis of the chain's motions, along which grasp forces do no work, drives
give as many rows as the chain has degrees of freedom,

    N_C^T (Y_C pi - w) + N_q^T (M qdd + C + armature qdd + damping qd + friction + ... - gain * y)

so that P = N_q^T; arms that hold nothing have one row for each joint. Wrists give the rows of the object's wrench about
C, and P takes their wrenches there. Joints have the torque

    armature qdd + damping qd + friction s + offset + asymmetry s^2,    s = qd / sqrt(qd^2 + 0.05^2)

beside that of the bodies, as in simulations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import groupby, pairwise

import numpy as np

from holdfast.dynamics.regressor import inertial_parameters
from holdfast.identification.completed import completed
from holdfast.identification.instants import Instants, at_wrists, instants
from holdfast.identification.recording import Recording
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.link import Link
from holdfast.model.trunk import TRUNK
from holdfast.simulation.joint_friction import friction_torque
from holdfast.spatial.scalar import Array

ON_DRIVES = ("tau", "current")  # measurements
ON_JOINTS = ("armature", "damping", "friction", "friction_offset", "friction_asymmetry")  # unknowns
NOT_NEGATIVE = ON_JOINTS[:3]
ON_WRISTS = ("sensor_offset", "sensor_drift")


@dataclass(frozen=True, eq=False)
class Terms:
    """Which terms of the equations are unknown, and the model's values of all.

    Attributes:
        by: what is measured.
        kinds: kinds of unknowns, in order.
        links: indices of the unknown links among all of trunk and arms.
        link_parameters: (links, 10) the model's parameters of all of these.
        model_joints: by kind, the model's values of the joints.
    """

    by: str
    kinds: tuple[str, ...]
    links: list[int]
    link_parameters: Array
    model_joints: dict[str, Array]

    def friction_columns(self) -> Array:
        """Return the columns of A that belong to the joints' dry friction."""
        on_joints, n = [kind for kind in self.kinds if kind in ON_JOINTS], len(self.model_joints["friction"])
        if "friction" not in on_joints:
            return np.zeros(0, int)
        first = 10 * (("payload" in self.kinds) + len(self.links)) + n * on_joints.index("friction")
        return np.arange(first, first + n)


def named_bodies(chain: ClosedChain) -> list[tuple[str, Link]]:
    """Return trunk bodies and links with their names 'arm/link', in the order of the regressor's columns."""
    of = {} if chain.trunk is None else {TRUNK: chain.trunk.bodies}
    of |= {name: arm.links for name, arm in chain.arms.items()}
    return [
        (f"{name}/{body.name or f'link{k + 1}'}", body) for name, bodies in of.items() for k, body in enumerate(bodies)
    ]


def terms_of(chain: ClosedChain, by: str, kinds: tuple[str, ...], links: Sequence[int] = ()) -> Terms:
    """Return the terms of a chain with unknowns of some kinds, and with some unknown links."""
    joints = {name: np.array([getattr(j, name) for j in chain.freedoms]) for name in NOT_NEGATIVE}
    joints |= {name: np.zeros(chain.joint_count) for name in ON_JOINTS[3:]}
    bodies = np.array([inertial_parameters(link) for _, link in named_bodies(chain)]).reshape(-1, 10)
    return Terms(by, kinds, list(links), bodies, joints)


@dataclass(frozen=True, eq=False)
class RecordedRows:
    """The equations of all samples of all recordings.

    Attributes:
        A: (samples, r, p) coefficients of the linear terms.
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


def rows_of(
    chain: ClosedChain, recordings: Sequence[Recording], terms: Terms, gravity: Array | None = None
) -> RecordedRows:
    """Return the equations of recordings with rates and accelerations. O(samples n^3).

    Args:
        chain: the chain.
        recordings: the recordings.
        terms: the terms of the equations.
        gravity: (3,) gravity; the chain's by default.
    """
    found = _equations(chain, recordings, terms, gravity)
    values, often = np.unique(np.concatenate([ranks for *_, ranks in found]), return_counts=True)
    usual = int(values[np.argmax(often)])
    kept = [ranks == usual for *_, ranks in found]
    A, b, N, P = (
        np.concatenate([one[i][keep, :usual] for one, keep in zip(found, kept, strict=True)]) for i in range(4)
    )
    y = np.concatenate([channels(chain, one, terms.by)[ks] for one, ks in zip(recordings, kept, strict=True)])
    used = np.ones(y.shape, bool)
    if terms.by in ON_DRIVES:
        flags = [np.ones(one.q.shape) if one.used is None else one.used for one in recordings]
        used = np.concatenate([flag[ks] > 0.0 for flag, ks in zip(flags, kept, strict=True)])
    t = np.concatenate([one.t[ks] for one, ks in zip(recordings, kept, strict=True)])
    ends = np.cumsum([0, *(int(one.sum()) for one in kept)]).tolist()
    parts = [slice(*ends) for ends in pairwise(ends) if ends[1] > ends[0]]
    return RecordedRows(A, b, N, P, y, used, t, parts, kept)


def _equations(
    chain: ClosedChain, recordings: Sequence[Recording], terms: Terms, gravity: Array | None
) -> list[list[Array]]:
    """Return what `equations_at` returns, of each recording; those with the same inputs are evaluated together."""
    found = list[list[Array]]()
    for _, alike in groupby(recordings, _inputs_and_arrays):
        group = list(alike)
        whole, since = _joined(group), np.concatenate([one.t - one.t[0] for one in group])
        whole = completed(chain, whole) if chain.grasps else whole
        ends = np.cumsum([len(one) for one in group])[:-1]
        parts = [np.split(x, ends) for x in equations_at(chain, whole, terms, gravity, since)]
        found += [list(one) for one in zip(*parts, strict=True)]
    return found


def equations_at(
    chain: ClosedChain,
    recording: Recording,
    terms: Terms,
    gravity: Array | None = None,
    since: Array | None = None,
) -> tuple[Array, ...]:
    """Return A, b, N and P of all samples of a completed recording, and their numbers of rows; rows below are 0.

    Args:
        chain: the chain.
        recording: the recording.
        terms: the terms of the equations.
        gravity: (3,) gravity; the chain's by default.
        since: (samples,) times during which sensors have drifted; those of the recording, from its start, by default.
    """
    if terms.by not in ON_DRIVES:
        return wrist_rows(chain, recording, terms, gravity, recording.t - recording.t[0] if since is None else since)
    pieces = [torque_rows(one, terms) for one in instants(chain, recording, gravity)]
    most = max(b.shape[1] for _, b, *_ in pieces)
    A, b, N, P = (np.concatenate([_below(one[i], most) for one in pieces]) for i in range(4))
    return A, b, N, P, np.concatenate([ranks for *_, ranks in pieces])


def _below(x: Array, rows: int) -> Array:
    """Return arrays (samples, r, ...) with rows of zeros below, (samples, rows, ...)."""
    return np.concatenate([x, np.zeros((len(x), rows - x.shape[1], *x.shape[2:]))], axis=1)


def forces_without_friction(
    chain: ClosedChain,
    recordings: Sequence[Recording],
    terms: Terms,
    gain: Array | float = 1.0,
    gravity: Array | None = None,
) -> list[Array]:
    """Return (samples, freedoms, features), rows [A, b - P gain y] without dry friction as forces along all freedoms.

    Args:
        chain: the chain.
        recordings: recordings with rates and accelerations, of which an array is returned for each.
        terms: the terms of the equations.
        gain: (channels,) factors of the measurements.
        gravity: (3,) gravity; the chain's by default.
    """
    rubs, found = terms.friction_columns(), list[Array]()
    for one, (A, b, N, P, _) in zip(recordings, _equations(chain, recordings, terms, gravity), strict=True):
        if terms.by in ON_DRIVES and not len(rubs):
            assert one.qd is not None
            b = b - np.einsum("src,sc->sr", P, friction_torque(terms.model_joints["friction"], one.qd.T).T)
        A[:, :, rubs] = 0.0
        left = b - np.einsum("src,sc->sr", P, gain * channels(chain, one, terms.by))
        found.append(np.swapaxes(N, 1, 2) @ np.concatenate([A, left[:, :, None]], axis=2))
    return found


def _inputs_and_arrays(one: Recording) -> tuple[object, ...]:
    """Return what recordings have in common that are evaluated together."""
    names = [field.name for field in fields(Recording) if isinstance(getattr(one, field.name), np.ndarray)]
    return id(one.inputs), id(one.added), *names


def _joined(recordings: Sequence[Recording]) -> Recording:
    """Return all samples of recordings in one, whose times mean nothing, so that machine code runs them together."""
    first = recordings[0]
    names = [field.name for field in fields(Recording) if isinstance(getattr(first, field.name), np.ndarray)]
    arrays = {name: np.concatenate([getattr(one, name) for one in recordings]) for name in names}
    return replace(first, **(arrays | {"t": np.arange(float(len(arrays["t"])))}))


def channels(chain: ClosedChain, recording: Recording, by: str) -> Array:
    """Return the measurements of a recording, (samples, channels)."""
    measured = getattr(recording, by)
    if by in ON_DRIVES:
        return measured
    return measured[:, [chain.names.index(name) for name in chain.grasps]].reshape(len(recording), -1)


def torque_rows(at: Instants, terms: Terms) -> tuple[Array, ...]:
    """Return A, b, N and P of samples by what drives do, and their numbers of rows, below which rows are 0."""
    n, qd, qdd = at.qd.shape[1], at.qd, at.qdd
    N, ranks = at.motions()
    joints, free = N[:, :, :n], N[:, :, n:]
    fixed = [i for i in range(at.links.shape[2]) if i not in terms.links]
    known = at.drives + np.einsum("srkp,kp->sr", at.links[:, :, fixed], terms.link_parameters[fixed])
    s = friction_torque(np.ones(n), qd.T).T
    by_kind = {
        "armature": qdd,
        "damping": qd,
        "friction": s,
        "friction_offset": np.ones(qd.shape),
        "friction_asymmetry": s * s,
    }
    model = terms.model_joints
    known += model["friction"] * s
    columns = []
    for kind in terms.kinds:
        if kind in ON_JOINTS:
            known -= model[kind] * by_kind[kind]
            columns.append(joints * by_kind[kind][:, None, :])
    weights = free @ at.object
    of_links = joints @ at.links[:, :, terms.links].reshape(*known.shape, 10 * len(terms.links))
    A = [*([weights] if "payload" in terms.kinds else []), of_links, *columns]
    b = np.einsum("srj,sj->sr", joints, known) - np.einsum("sri,si->sr", free, at.object_wrench)
    if "payload" not in terms.kinds:
        b = b + weights @ at.held
    if at.added is not None:
        b = b + weights @ at.added
    return np.concatenate(A, axis=2), b, N, joints, ranks


def wrist_rows(
    chain: ClosedChain, recording: Recording, terms: Terms, gravity: Array | None, since: Array
) -> tuple[Array, ...]:
    """Return A, b, N and P of samples by wrenches or forces at wrists, and the numbers of rows; see `equations_at`.

    Forces alone have rows of forces only.
    """
    found = at_wrists(chain, recording, gravity)
    least = 0 if terms.by == "wrist_wrench" else 3
    P, weights, known = found["maps"][:, least:], found["object"][:, least:], found["object_wrench"][:, least:]
    count, r = known.shape
    P = P.reshape(count, r, -1, 6)[:, :, :, least:].reshape(count, r, -1)
    A, b = np.zeros((count, r, 0)), -known
    if "payload" in terms.kinds:
        A = weights
    else:
        b = b + weights @ inertial_parameters(chain.held_object)
    if recording.added is not None:
        b = b + weights @ inertial_parameters(recording.added)
    drifted = since[:, None, None]
    columns = [P * (drifted if kind == "sensor_drift" else 1.0) for kind in terms.kinds if kind in ON_WRISTS]
    N = np.broadcast_to(np.eye(r), (count, r, r))
    return np.concatenate([A, *columns], axis=2), b, N, P, np.full(count, r)
